"""The report on a map: a page for people, made of a map directory alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps import filenames
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.compare import compare_maps, lines_of
from specmap_cli.pipelines.localizer import classifiers_of
from specmap_cli.recognition.features.sets import KeyframeFeatures, feature_names
from specmap_cli.recognition.learning.boosting import feature_shares
from specmap_cli.recognition.learning.classifiers import Recogniser
from specmap_cli.report.layers import Changes, Evidence, Learned, SplitTrial
from specmap_cli.report.page import render
from specmap_cli.segmentation.online import Occasion, OnlineSegmenter, SplitTest
from specmap_cli.topology.topological_map import starts_of


@one_blas_thread()
def report_map(
    map_: Map | Path | str,
    compare: Map | Path | str | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
) -> str:
    """The report on a map directory, or on one that was read, as the text of one HTML page.

    `compare` is an older map of the same building. The limits of `config` bound the files that
    are read. Raises MapError for a damaged map, NoResultError when the two maps cannot be aligned.
    """
    progress = progress or Silent()
    stored = opened_map(map_, "map_", config)
    if stored.note:
        progress.note(stored.note)
    changes = None
    if compare is not None:
        older = opened_map(compare, "compare", config)
        found = compare_maps(older, stored, progress=progress)
        called = found.old.path.resolve().name, found.new.path.resolve().name
        changes = Changes(
            old=found.old,
            record=found.record,
            lines=tuple(lines_of(found.record, called)),
            new_from_old=found.old_from_new.inverse(),
        )
    return render(stored, evidence_of(stored, progress), changes)


_ASKED = 60  # scans of a submap whose likeness to others is looked at: a share good to some percent
_NEAR_M, _NEAR_CELLS = 0.1, 1.5  # of a wall: a return that lies so near lies on it
_LEAST_SPREAD = 1e-9  # of votes that are always the same
_LEAST_SHARE = 0.01  # of the votes, or of the scans: less is not worth a word

Name = TypeVar("Name", str, int)


def evidence_of(stored: Map, progress: Progress) -> Evidence:
    """What a map's scans and classifiers tell, as far as it has them.

    Raises MapError for a file that is damaged.
    """
    recogniser, notes = None, []
    if (stored.path / filenames.CLASSIFIERS).exists():
        recogniser = classifiers_of(stored).raw
    else:
        notes.append("No classifiers: the map was not made of a recording.")
    if not (stored.path / filenames.KEYFRAMES).exists():
        features = {} if recogniser is None else _features_of(recogniser)
        learned = {id_: Learned(features=found) for id_, found in features.items()}
        notes.append(
            "The map keeps no scans: what its submaps look like to each other, how well scans fit "
            "its walls, and its split tests are not known."
        )
        return Evidence(learned=learned, notes=tuple(notes))
    with stored.scans() as store:
        progress.start("looking at scans", len(store))
        return Evidence(
            learned={} if recogniser is None else _learned(stored, recogniser, store),
            fit=_fit(stored, store),
            tests=_tests(stored, store, progress),
            threshold=stored.config.segmentation.split_eigenvalue,
            notes=tuple(notes),
        )


def _features_of(recogniser: Recogniser) -> dict[int, tuple[tuple[str, float], ...]]:
    """What each classifier looks at, what counts most first."""
    names = feature_names(recogniser.feature_set)
    boosters = recogniser.classifiers.boosters_
    return {id_: _ranked(names, feature_shares(booster)) for id_, booster in boosters.items()}


def _ranked(names: Sequence[Name], shares: FloatArray) -> tuple[tuple[Name, float], ...]:
    """Names with their shares, the largest first, without those that are not worth a word."""
    order = np.argsort(-shares, kind="stable").tolist()
    return tuple((names[k], float(shares[k])) for k in order if shares[k] >= _LEAST_SHARE)


def _learned(stored: Map, recogniser: Recogniser, store: KeyframeStore) -> dict[int, Learned]:
    """What each classifier looks at, and which submaps a submap's scans fit next best."""
    scans = KeyframeFeatures(store, recogniser.feature_set, most=0)
    features, submaps, ids = _features_of(recogniser), stored.labels.submaps, recogniser.ids
    asked = [evenly(np.flatnonzero(submaps == id_), _ASKED) for id_ in ids]
    owner = np.repeat(np.arange(len(asked)), [len(own) for own in asked])
    margins = recogniser.margins(scans.of(np.concatenate(asked).tolist()))
    relative = _relative_votes(margins, owner)
    learned = {}
    for column, id_ in enumerate(ids):
        own, count = owner == column, len(asked[column])
        found = Learned(features=features[id_])
        if count:
            right = float(np.mean(margins[own].argmax(axis=1) == column))
            found = replace(found, scans=count, right=right)
        if count and len(ids) > 1:
            nearest = np.bincount(relative[own].argmax(axis=1), minlength=len(ids))
            found = replace(found, alike=_ranked(ids, nearest / count))
        learned[id_] = found
    return learned


def _relative_votes(margins: FloatArray, owner: IntArray) -> FloatArray:
    """(n, m) `margins` less the mean of foreign scans, over their deviation; -inf for own scans."""
    relative = np.full(margins.shape, -np.inf)
    for column in range(margins.shape[1]):
        foreign = owner != column
        values = margins[foreign, column]
        if len(values):
            spread = max(float(values.std()), _LEAST_SPREAD)
            relative[foreign, column] = (values - values.mean()) / spread
    return relative


def _fit(stored: Map, store: KeyframeStore) -> FloatArray:
    """(n,) share of the returns of each keyframe that lie on walls of the map; NaN without any."""
    grid = stored.map_grid
    near = grid.obstacle_distance() <= max(_NEAR_M, _NEAR_CELLS * grid.resolution)
    fit = np.full(len(store), np.nan)
    for number, pose in enumerate(stored.labels.poses):
        cells = grid.cells_of(Pose2(*pose).apply(store.points(number)))
        inside = grid.inside(cells)
        if len(cells):
            fit[number] = np.count_nonzero(near[tuple(cells[inside].T)]) / len(cells)
    return fit


def _tests(stored: Map, store: KeyframeStore, progress: Progress) -> tuple[SplitTrial, ...]:
    """The tests that the way of the map led to, made again with its settings."""
    found: list[SplitTrial] = []

    def observe(test: SplitTest, split: bool, when: Occasion) -> None:
        """Its places in the map: it was made where registration had put the scans."""
        keyframe = when.latest
        map_from_registered = Pose2(*stored.labels.poses[keyframe]) @ store.pose(keyframe).inverse()
        strength = np.abs(test.eigenvector)
        share = strength / max(float(strength.max(initial=0.0)), 1e-12)
        found.append(
            SplitTrial(
                keyframe=keyframe,
                eigenvalues=test.eigenvalues,
                chosen=test.chosen,
                split=split,
                nodes=map_from_registered.apply(test.nodes),
                sides=np.where(test.near, share, -share),
            )
        )

    breaks = {*(each.keyframe for each in stored.record.graph.breaks), *starts_of(stored.logs)}
    config = stored.config
    segmenter = OnlineSegmenter(config.segmentation, config.grid, store, observe)
    for now in range(len(store)):
        if now in breaks:
            segmenter.flush()
        segmenter.add(now)
        progress.advance()
    return tuple(found)

"""Training the classifiers that localisation uses, and testing them on scans they did not see.

Single scans that are held out prove nothing: the scans just before and after them were learned. So
pieces of the way are held out. Of a piece of some metres the map knows no more than it knows of
another robot's way. For a recording that is added to a map no piece need be held out: its scans are
told by the classifiers that the map had before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, travelled
from specmap_cli.core.records import BoolArray, Labels
from specmap_cli.core.settings import Config, RecognitionConfig
from specmap_cli.grids.keyframes import DIRECTION_RAD
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.calibration import (
    HELD_OUT_REACH_M,
    MOST_VIEWS,
    Familiarity,
    HeldOutMargins,
)
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser
from specmap_cli.recognition.learning.sampling import Samples, views

_PIECE_M, _EVERY = 5.0, 4  # of the way a piece in four is held out; the first one never is
_UNCLAIMED = -1e3  # margin of a submap of which nothing was left to learn from
_CHORD = 2.0 * np.sin(0.5 * DIRECTION_RAD)  # of the unit circle
_EXEMPLARS = 80  # scans kept of a submap, to tell unknown ones by


def train_and_test(
    taken: Mapping[int, Samples],
    made: Mapping[int, Samples],
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
    revisits: Revisits | None = None,
    *,
    virtual: bool,
) -> tuple[Recogniser, HeldOutMargins]:
    """What tells the submaps apart by raw or virtual scans, and how well it tells held-out ones.

    It is learned from scans that were `taken` (`raw_samples`, `track_samples`) and from others that
    were `made` (`augmented_samples`, `cast_samples`). The former alone are tested, and of raw scans
    they alone show what the map looks like. With `revisits` these are scans of a recording, which
    the map before it tells.
    """
    feature_set = (config.localization if virtual else config.recognition).feature_set
    samples = {
        i: Samples(
            np.vstack([own.features, made[i].features]),
            np.concatenate([own.keyframes, made[i].keyframes]),
        )
        for i, own in sorted(taken.items())
    }
    classifiers = OneVsAll(feature_set, config.recognition).fit(
        {i: own.features for i, own in samples.items()}, rng
    )
    known = Familiarity(feature_set, config.localization.false_unknown, _EXEMPLARS)
    shown = {i: own.features for i, own in (samples if virtual else taken).items()}
    learned = Recogniser(classifiers, known.fit(shown) if known.can_fit(shown) else None)
    if revisits is not None:
        before = revisits.classifiers.virtual if virtual else revisits.classifiers.raw
        if before is not None:
            return learned, revisits.told(taken, before)
    held_out = in_pieces_held_out(poses)
    rest = {i: own.rows(~held_out[own.keyframes]) for i, own in samples.items()}
    tested = {i: known_places(own, held_out, poses) for i, own in taken.items()}
    return learned, held_out_margins(rest, tested, feature_set, config.recognition, rng)


def in_pieces_held_out(poses: FloatArray) -> BoolArray:
    """(n,) which keyframes at poses (n, 3) are held out: those of a piece of the way in four."""
    return np.asarray((travelled(poses) // _PIECE_M).astype(np.int64) % _EVERY == 1)


def known_places(samples: Samples, held_out: BoolArray, poses: FloatArray) -> Samples:
    """Those of a submap that are held out, of places that the rest of the submap shows, too."""
    rest = np.setdiff1d(samples.keyframes, np.flatnonzero(held_out))
    own = samples.rows(held_out[samples.keyframes])
    distance, _ = cKDTree(poses[rest, :2]).query(poses[own.keyframes, :2])
    return own.rows(np.asarray(distance < HELD_OUT_REACH_M))


def held_out_margins(
    learned: Mapping[int, Samples],
    tested: Mapping[int, Samples],
    feature_set: str,
    config: RecognitionConfig,
    rng: np.random.Generator,
) -> HeldOutMargins:
    """The margins of the samples `tested` by classifiers that learn from those `learned`.

    A submap that is not learned, since nothing is left of it, claims nothing. There are no margins
    where fewer than two submaps are left to tell apart.
    """
    ids = sorted(learned)
    rest = {i: samples.features for i, samples in learned.items() if len(samples.features)}
    asked = {i: samples for i, samples in tested.items() if i in rest and len(samples.features)}
    if len(rest) < 2 or not asked:
        return HeldOutMargins(np.zeros((0, len(ids))), np.zeros(0, dtype=np.intp))
    classifiers = OneVsAll(feature_set, config).fit(rest, rng)
    numbers = {i: k for k, i in enumerate(ids)}
    counts = [len(samples.features) for samples in asked.values()]
    margins = np.full((sum(counts), len(ids)), _UNCLAIMED)
    columns = [numbers[i] for i in classifiers.classes_]
    margins[:, columns] = classifiers.margins(np.vstack([s.features for s in asked.values()]))
    truth = np.repeat([numbers[i] for i in asked], counts).astype(np.intp)
    return HeldOutMargins(margins, truth)


@dataclass(frozen=True, slots=True)
class Revisits:
    """The `classifiers` of a map before the recording whose keyframes begin at number `first`.

    `labels` are the keyframes of both. A place is known that lies near one where the robot was in
    the submap, the nearer the more it faced another way, unless the laser looks all round.
    """

    classifiers: ClassifierSet
    first: int
    labels: Labels

    def told(self, samples: Mapping[int, Samples], by: Recogniser) -> HeldOutMargins:
        """The margins of samples of the recording; `by` is one of the classifiers before it."""
        column = {id_: k for k, id_ in enumerate(by.ids)}
        told_apart = 2 if self.classifiers.sensor.full_circle else 4  # it does not matter where to
        features, true = [], []
        for i in sorted(column.keys() & samples.keys()):
            before = np.flatnonzero(self.labels.submaps[: self.first] == i)
            own = samples[i].rows(samples[i].keyframes >= self.first)
            then, now = (
                views(self.labels.poses[keyframes], HELD_OUT_REACH_M, _CHORD)[:, :told_apart]
                for keyframes in (before, own.keyframes)
            )
            known = cKDTree(then).query(now)[0] < 1.0
            features.append(own.features[known])
            true += [column[i]] * len(features[-1])
        if not true:
            return HeldOutMargins(np.zeros((0, len(column))), np.zeros(0, dtype=np.intp))
        rows = evenly(np.arange(len(true)), MOST_VIEWS)
        margins = by.margins(np.vstack(features)[rows])
        return HeldOutMargins(margins, np.array(true, dtype=np.intp)[rows])

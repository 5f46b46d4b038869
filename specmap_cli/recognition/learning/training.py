"""Training the classifiers that localisation uses, from the keyframes and grids of a map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import NO_SUBMAP, PlanarScan
from specmap_cli.core.sampling import evenly
from specmap_cli.core.settings import Config, LocalizationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.sets import KeyframeFeatures, scans_features
from specmap_cli.recognition.features.virtual import RecentScans, cast_circles
from specmap_cli.recognition.learning.calibration import HeldOutMargins, calibrated
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser
from specmap_cli.recognition.learning.familiarity import Familiarity
from specmap_cli.recognition.learning.holding_out import Pieces, Samples, held_out_margins
from specmap_cli.recognition.learning.misfit import held_out_misfit
from specmap_cli.recognition.learning.one_vs_all import OneVsAll
from specmap_cli.recognition.learning.sensor import Sensor

# Of the window: 1, 2, 5 and 10 m by default, as it has to work while it fills.
_WINDOW_SHARES = (0.1, 0.2, 0.5, 1.0)
_DRAWS = 6  # free cells drawn for one that is wanted: most lie too far from the track
_ALIKE_SHARE = 0.5  # of the cast samples is dealt out evenly, the rest by area


def train_localizer(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    grids: Mapping[int, GridMap],
    config: Config,
    rng: np.random.Generator,
) -> ClassifierSet:
    """Classifiers of raw scans and, where wanted, of virtual ones.

    The two are independent: each may be trained apart, with one of `rng.spawn(2)`. `submaps` lists
    the keyframes of each submap, ascending; `poses` (n, 3) are those of all keyframes, map from
    base; `grids` are in the frame of each submap's first keyframe.
    """
    raw_rng, virtual_rng = rng.spawn(2)
    virtual, of_virtual, localization = None, None, config.localization
    if localization.virtual:
        along = track_samples(store, submaps, poses, localization)
        cast = cast_samples(submaps, poses, grids, localization, virtual_rng)
        virtual, of_virtual = train_virtual(along, cast, poses, config, virtual_rng)
    raw, of_raw = train_raw(store, submaps, poses, config, raw_rng)
    return ClassifierSet(
        sensor=sensor_of(store, submaps),
        raw=raw,
        virtual=virtual,
        misfit=held_out_misfit(store, submaps, poses, localization),
        calibration=calibrated(of_raw, of_virtual),
    )


def sensor_of(store: KeyframeStore, submaps: Mapping[int, Sequence[int]]) -> Sensor:
    """The laser of the first keyframe that is in a submap."""
    return Sensor.of(store.scan(min(numbers[0] for numbers in submaps.values())))


def train_raw(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
    features: KeyframeFeatures | None = None,
) -> tuple[Recogniser, HeldOutMargins]:
    """What tells the submaps apart by raw scans, and how well it tells those that are held out.

    `features` are those known so far. A submap that was seen often is learned from some of its
    scans, evenly spread; first of all from those whose features are known, which loop closure has
    chosen evenly, too.
    """
    feature_set, most = config.recognition.feature_set, config.recognition.positives
    features = features or KeyframeFeatures(store, feature_set)
    samples = {}
    for i, numbers in submaps.items():
        chosen = _chosen(numbers, features, most)
        samples[i] = Samples(features.of(chosen), np.array(chosen, dtype=np.intp))
    learned = train({i: own.features for i, own in samples.items()}, feature_set, config, rng)
    return learned, _tested(samples, samples, poses, feature_set, config, rng)


def _chosen(numbers: Sequence[int], features: KeyframeFeatures, most: int) -> list[int]:
    """At most `most` of a submap's keyframes, ascending: those with known features, then others."""
    known = evenly(np.array(features.known(numbers), dtype=np.intp), most)
    others = evenly(np.setdiff1d(numbers, known), most - len(known))
    return sorted([*known.tolist(), *others.tolist()])


def train_virtual(
    along: Mapping[int, Samples],
    cast: Mapping[int, Samples],
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
) -> tuple[Recogniser, HeldOutMargins]:
    """What tells the submaps apart by virtual scans, and how well it tells those held out.

    It is learned from `track_samples` and from `cast_samples`, and tested on the former.
    """
    feature_set = config.localization.feature_set
    samples = {i: _joined(along[i], cast[i]) for i in sorted(along)}
    learned = train({i: own.features for i, own in samples.items()}, feature_set, config, rng)
    return learned, _tested(samples, along, poses, feature_set, config, rng)


def _joined(along: Samples, cast: Samples) -> Samples:
    return Samples(
        np.vstack([along.features, cast.features]),
        np.concatenate([along.keyframes, cast.keyframes]),
    )


def _tested(
    samples: Mapping[int, Samples],
    asked: Mapping[int, Samples],
    poses: FloatArray,
    feature_set: str,
    config: Config,
    rng: np.random.Generator,
) -> HeldOutMargins:
    """How the samples `asked` that lie in held-out pieces are told by all other samples."""
    pieces = Pieces(poses, config.localization.held_out_reach_m)
    rest = {i: pieces.rest(own) for i, own in samples.items()}
    tested = {i: pieces.tested(own) for i, own in asked.items()}
    return held_out_margins(rest, tested, feature_set, config.recognition, rng)


def train(
    samples: Mapping[int, FloatArray],
    feature_set: str,
    config: Config,
    rng: np.random.Generator,
) -> Recogniser:
    """What tells submaps apart, from the features (n, F) of every submap's scans."""
    localization = config.localization
    classifiers = OneVsAll(feature_set, config.recognition).fit(samples, rng)
    known = Familiarity(feature_set, localization.false_unknown, localization.exemplars)
    return Recogniser(classifiers, known.fit(samples) if known.can_fit(samples) else None)


def track_samples(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    localization: LocalizationConfig,
) -> dict[int, Samples]:
    """Virtual scans of every submap, of what was seen of late along the track.

    They need no grids.
    """
    owner = _owners(submaps, len(poses))
    scans: dict[int, list[PlanarScan]] = {i: [] for i in sorted(submaps)}
    numbers: dict[int, list[int]] = {i: [] for i in scans}
    for keyframe, scan in _along_the_track(store, owner, poses, localization):
        scans[int(owner[keyframe])].append(scan)
        numbers[int(owner[keyframe])].append(keyframe)
    return {
        i: Samples(scans_features(own, localization.feature_set), np.array(numbers[i], np.intp))
        for i, own in scans.items()
    }


def cast_samples(
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    grids: Mapping[int, GridMap],
    localization: LocalizationConfig,
    rng: np.random.Generator,
) -> dict[int, Samples]:
    """Virtual scans of every submap, cast from free cells near its track."""
    owner = _owners(submaps, len(poses))
    samples = {}
    counts = _share_out(localization.augmentation, {i: g.free_area_m2 for i, g in grids.items()})
    tracked = np.flatnonzero(owner != NO_SUBMAP)
    tree = cKDTree(poses[tracked, :2])
    for i in sorted(submaps):
        drawn = _free_places(grids[i], localization.augmentation_clearance_m, counts[i], rng)
        map_from_submap = Pose2(*poses[submaps[i][0]].tolist())
        distance, nearest = tree.query(map_from_submap.apply(drawn))
        near = (distance < localization.augmentation_reach_m) & (owner[tracked][nearest] == i)
        beams, reach = localization.virtual_beams, localization.virtual_range_m
        scans = cast_circles(grids[i], drawn[near][: counts[i]], beams, reach)
        features = scans_features(scans, localization.feature_set)
        samples[i] = Samples(features, tracked[nearest[near][: counts[i]]])
    return samples


def _owners(submaps: Mapping[int, Sequence[int]], count: int) -> NDArray[np.intp]:
    """(count,) submap of every keyframe, NO_SUBMAP for none."""
    owner = np.full(count, NO_SUBMAP, dtype=np.intp)
    for i, numbers in submaps.items():
        owner[np.asarray(numbers, dtype=np.intp)] = i
    return owner


def _along_the_track(
    store: KeyframeStore,
    owner: NDArray[np.intp],
    poses: FloatArray,
    localization: LocalizationConfig,
) -> Iterator[tuple[int, PlanarScan]]:
    """Keyframes in turn with what the window showed there, of several lengths."""
    window = RecentScans(localization)
    numbers = np.flatnonzero(owner != NO_SUBMAP)
    sampled = set(evenly(numbers, localization.track_samples).tolist())
    turn = 0
    for number in numbers.tolist():
        pose, mounting = Pose2(*poses[number].tolist()), store.base_from_laser(number)
        if window.moves_on(pose):
            window.keep(store.scan(number).hits(localization.virtual_range_m), pose, mounting)
        if number in sampled:
            share = _WINDOW_SHARES[turn % len(_WINDOW_SHARES)]
            yield number, window.scan(0, pose @ mounting, share)
            turn += 1


def _share_out(total: int, areas: Mapping[int, float]) -> dict[int, int]:
    """How many of `total` samples each submap gets: half alike, half by its area."""
    whole = sum(areas.values())
    even = _ALIKE_SHARE / max(1, len(areas))
    by_area = 1.0 - _ALIKE_SHARE
    return {
        i: round(total * (even + (by_area * area / whole if whole > 0.0 else even)))
        for i, area in sorted(areas.items())
    }


def _free_places(
    grid: GridMap, clearance_m: float, count: int, rng: np.random.Generator
) -> FloatArray:
    """(n, 2) places drawn from the free cells that lie farther than this from all others."""
    cells = np.argwhere(grid.clearance() > clearance_m)
    if not len(cells) or not count:
        return np.zeros((0, 2))
    return grid.centres_of(cells[rng.integers(len(cells), size=_DRAWS * count)])

"""Training the classifiers that localisation uses, from the keyframes and grids of a map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.config import Config, LocalizationConfig
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.sampling import evenly
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.sets import KeyframeFeatures, scan_features, scans_features
from specmap_cli.recognition.features.virtual import RecentScans, cast_circles
from specmap_cli.recognition.learning.classifiers import ClassifierSet, OneVsAll, Sensor
from specmap_cli.recognition.learning.familiarity import Familiarity

_TRACK_REACH_M = 1.5
_WINDOW_SHARES = (0.1, 0.2, 0.5, 1.0)  # of the window: it has to work while it fills
_MOST_WINDOW_SAMPLES = 800


def train_localizer(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    grids: Mapping[int, GridMap],
    config: Config,
    rng: np.random.Generator,
    features: KeyframeFeatures | None = None,
) -> ClassifierSet:
    """Classifiers of raw scans and, where wanted, of virtual ones.

    The two are independent: `train_raw` and `train_virtual` may be called apart, each with one of
    `rng.spawn(2)`. `submaps` lists the keyframes of each submap, ascending; `poses` (n, 3) are
    those of all keyframes, map from base; `grids` are in the frame of each submap's first keyframe.
    `features` are those of the store's keyframes known so far.
    """
    raw_rng, virtual_rng = rng.spawn(2)
    trained = train_raw(store, submaps, config, raw_rng, features)
    virtual = train_virtual(store, submaps, poses, grids, config, virtual_rng)
    trained.virtual, trained.virtual_known = virtual
    return trained


def train_raw(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    config: Config,
    rng: np.random.Generator,
    features: KeyframeFeatures | None = None,
) -> ClassifierSet:
    """Classifiers of raw scans alone."""
    recognition = config.recognition
    features = features or KeyframeFeatures(store, recognition.feature_set)
    raw = {i: features.of(numbers) for i, numbers in submaps.items()}
    sensor = Sensor.of(store.scan(min(numbers[0] for numbers in submaps.values())))
    trained = ClassifierSet.train(raw, sensor, recognition, rng)
    false_unknown = config.localization.false_unknown
    trained.raw_known = Familiarity.of(recognition.feature_set, raw, false_unknown)
    return trained


def train_virtual(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    grids: Mapping[int, GridMap],
    config: Config,
    rng: np.random.Generator,
) -> tuple[OneVsAll | None, Familiarity | None]:
    """Classifiers of virtual scans, and which scans look like any place; None where not wanted."""
    localization = config.localization
    if not localization.virtual:
        return None, None
    samples = virtual_samples(store, submaps, poses, grids, localization, rng)
    model = OneVsAll(localization.feature_set, config.recognition).fit(samples, rng)
    known = Familiarity.of(localization.feature_set, samples, localization.false_unknown)
    return model, known


def virtual_samples(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    grids: Mapping[int, GridMap],
    localization: LocalizationConfig,
    rng: np.random.Generator,
) -> dict[int, FloatArray]:
    """Features (n, F) of virtual scans of every submap: along the track, and from free cells."""
    owner = _owners(submaps, len(poses))
    rows: dict[int, list[FloatArray]] = {i: [] for i in sorted(submaps)}
    for keyframe, features in _along_the_track(store, owner, poses, localization):
        rows[int(owner[keyframe])].append(features)
    samples = {}
    counts = _share_out(localization.augmentation, {i: g.free_area_m2 for i, g in grids.items()})
    tracked = np.flatnonzero(owner >= 0)
    tree = cKDTree(poses[tracked, :2])
    for i in sorted(submaps):
        map_from_submap = Pose2(*poses[submaps[i][0]].tolist())
        origins = _free_origins(
            grids[i], map_from_submap, tree, owner[tracked] == i, counts[i], rng
        )
        scans = cast_circles(
            grids[i], origins, localization.virtual_beams, localization.virtual_range_m
        )
        cast = scans_features(scans, localization.feature_set)
        samples[i] = np.vstack([*(row[None] for row in rows[i]), cast])
    return samples


def _owners(submaps: Mapping[int, Sequence[int]], count: int) -> NDArray[np.intp]:
    """(count,) submap of every keyframe, -1 for none."""
    owner = np.full(count, -1, dtype=np.intp)
    for i, numbers in submaps.items():
        owner[np.asarray(numbers, dtype=np.intp)] = i
    return owner


def _along_the_track(
    store: KeyframeStore,
    owner: NDArray[np.intp],
    poses: FloatArray,
    localization: LocalizationConfig,
) -> Iterator[tuple[int, FloatArray]]:
    """Keyframes in turn with the features of what the window showed there, of several lengths."""
    windows = [
        RecentScans(
            share * localization.window_m, localization.virtual_beams, localization.virtual_range_m
        )
        for share in _WINDOW_SHARES
    ]
    numbers = np.flatnonzero(owner >= 0)
    sampled = set(evenly(numbers, _MOST_WINDOW_SAMPLES).tolist())
    turn = 0
    for number in numbers.tolist():
        pose, mounting = Pose2(*poses[number].tolist()), store.base_from_laser(number)
        points = store.scan(number).hits(localization.virtual_range_m)
        for window in windows:
            window.add_points(points, pose, mounting)
        if number in sampled:
            scan = windows[turn % len(windows)].scan(0, pose @ mounting)
            turn += 1
            yield number, scan_features(scan, localization.feature_set)


def _share_out(total: int, areas: Mapping[int, float]) -> dict[int, int]:
    """How many of `total` samples each submap gets: half alike, half by its area."""
    whole = sum(areas.values())
    even = 0.5 / max(1, len(areas))
    return {
        i: round(total * (even + (0.5 * area / whole if whole > 0.0 else even)))
        for i, area in sorted(areas.items())
    }


def _free_origins(
    grid: GridMap,
    map_from_submap: Pose2,
    tree: cKDTree,
    own: NDArray[np.bool_],
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, 2) places in free cells near the track and nearer to this submap's than to others'.

    `tree` holds the keyframes' places in the map, `own` (k,) which of them are this submap's.
    """
    cells = np.argwhere(grid.clearance() > 0.25)
    if not len(cells) or not count:
        return np.zeros((0, 2))
    drawn = grid.centres_of(cells[rng.integers(len(cells), size=6 * count)])
    distance, nearest = tree.query(map_from_submap.apply(drawn))
    return np.asarray(drawn[(distance < _TRACK_REACH_M) & own[nearest]][:count])

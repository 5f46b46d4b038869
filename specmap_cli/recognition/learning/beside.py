"""Raw scans as the laser would have taken them just beside its way, for classifiers to learn from.

A robot that turns quickly leaves few keyframes, and a small submap has few of them. What the laser
would have seen a step aside, or turned a little, is known from the keyframes around.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import NO_SUBMAP, PlanarScan
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.lines_seen import outline, seen_from
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.learning.holding_out import Samples
from specmap_cli.recognition.learning.lessons import NO_SAMPLES, of_keyframes, together
from specmap_cli.recognition.learning.sampling import owners_of

_ASIDE_M, _TURNED_RAD = 0.1, math.radians(15.0)  # standard deviation; at most
_NEAR = 4  # keyframes whose outlines are looked at: what one did not see another one did
_PLACE_M, _CHORD = 0.5, 0.5  # keyframes so far apart, or so much turned, are as unlike each other
_OUTLINES_KEPT = 256  # a few megabytes


def beside_samples(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
    known: Samples = NO_SAMPLES,
) -> dict[int, Samples]:
    """Scans of every submap, seen from beside its keyframes, with the nearest of these.

    A submap gets as many as it lacks of `recognition.augmentation` scans, or fewer: what comes to
    lie in another submap is left out. Those that are `known` are not made again.
    """
    wanted = config.recognition.augmentation
    owner = owners_of(submaps, len(poses))
    around = _Around(store, poses, np.flatnonzero(owner != NO_SUBMAP))
    samples = {}
    for i in sorted(submaps):
        lacking = max(0, wanted - len(submaps[i]))
        kept = of_keyframes(known, submaps[i])
        kept = kept.rows(evenly(np.arange(len(kept.keyframes)), lacking))
        lacking -= len(kept.keyframes)
        sources = _repeated(np.asarray(submaps[i], dtype=np.intp), lacking)
        placed = poses[sources] + _steps(len(sources), rng)
        nearest = around.nearest(placed)
        own = owner[nearest] == i
        scans = around.scans(sources[own], placed[own])
        features = scans_features(scans, config.recognition.feature_set)
        made = Samples(features, nearest[own])
        samples[i] = together({0: kept, 1: made}) if len(kept.keyframes) else made
    return samples


def _repeated(items: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """So many of the items, evenly spread, some of them several times if need be."""
    return items[np.linspace(0, len(items) - 1, count).astype(np.intp)]


def _steps(count: int, rng: np.random.Generator) -> FloatArray:
    """(count, 3) small random motions."""
    aside = rng.normal(0.0, _ASIDE_M, (count, 2))
    return np.column_stack([aside, rng.uniform(-_TURNED_RAD, _TURNED_RAD, count)])


class _Around:
    """The keyframes `numbers`, at `poses` (n, 3) of all keyframes, and what they saw."""

    def __init__(self, store: KeyframeStore, poses: FloatArray, numbers: NDArray[np.intp]) -> None:
        self.store, self.poses, self.numbers = store, poses, numbers
        self._places = cKDTree(poses[numbers, :2])
        self._views = cKDTree(_views(poses[numbers]))
        self._outline = lru_cache(_OUTLINES_KEPT)(self._found_outline)

    def nearest(self, poses: FloatArray) -> NDArray[np.intp]:
        """(k,) the keyframe nearest to each of some poses (k, 3)."""
        _, row = self._places.query(poses[:, :2])
        return np.asarray(self.numbers[row], dtype=np.intp)

    def scans(self, sources: NDArray[np.intp], poses: FloatArray) -> Iterator[PlanarScan]:
        """What the lasers of keyframes `sources` (k,) would have seen from poses (k, 3)."""
        near = min(_NEAR, len(self.numbers))
        _, rows = self._views.query(_views(poses), near)
        around = self.numbers[rows.reshape(len(poses), near)]
        for source, pose, keyframes in zip(sources.tolist(), poses, around.tolist(), strict=True):
            lines = np.vstack([self._outline(keyframe) for keyframe in keyframes])
            scan = self.store.scan(source)
            laser = Pose2(*pose.tolist()) @ self.store.base_from_laser(source)
            ranges = seen_from(lines, laser, scan.bearings, scan.range_max)
            yield replace(scan, ranges=ranges)

    def _found_outline(self, keyframe: int) -> FloatArray:
        scan, pose = self.store.scan(keyframe), Pose2(*self.poses[keyframe].tolist())
        return outline(scan, pose @ self.store.base_from_laser(keyframe), scan.range_max)


def _views(poses: FloatArray) -> FloatArray:
    """(n, 4) where poses (n, 3) look from, and where to."""
    x, y, heading = poses.T
    facing = np.column_stack([np.cos(heading), np.sin(heading)]) / _CHORD
    return np.hstack([np.column_stack([x, y]) / _PLACE_M, facing])

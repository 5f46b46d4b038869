"""Which scans the classifiers of a map learn from, and their features by keyframe.

Single scans; scans as the laser would have taken them just beside its way; and virtual ones of full
circle. A robot that turns quickly leaves few keyframes, and a small submap has few of them: what
the laser would have seen a step aside, or turned a little, is known from the keyframes around.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels, PlanarScan
from specmap_cli.core.settings import Config, LocalizationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.sets import KeyframeFeatures, scans_features
from specmap_cli.recognition.features.virtual import (
    VIRTUAL_BEAMS,
    VIRTUAL_RANGE_M,
    RecentScans,
    cast_circles,
    outline,
    seen_from,
)


@dataclass(frozen=True)  # without slots: the owners are found once
class Track:
    """The keyframes of a map at `poses` (n, 3), and those of each submap, ascending.

    Recordings after the first one begin with the keyframes `starts`.
    """

    store: KeyframeStore
    poses: FloatArray
    submaps: Mapping[int, Sequence[int]]
    starts: Sequence[int] = ()

    @classmethod
    def of(cls, store: KeyframeStore, labels: Labels, starts: Sequence[int] = ()) -> Track:
        """The keyframes that a store holds, as they are labelled."""
        own = {int(i): np.flatnonzero(labels.submaps == i) for i in np.unique(labels.submaps)}
        return cls(store, labels.poses, {i: numbers.tolist() for i, numbers in own.items()}, starts)

    @cached_property
    def owner(self) -> NDArray[np.intp]:
        """(n,) submap of every keyframe, NO_SUBMAP for none."""
        owner = np.full(len(self.poses), NO_SUBMAP, dtype=np.intp)
        for i, numbers in self.submaps.items():
            owner[np.asarray(numbers, dtype=np.intp)] = i
        return owner

    def by_recording(self, numbers: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        """Keyframes (n,), ascending, by recording."""
        return np.split(numbers, np.searchsorted(numbers, np.array(self.starts, dtype=np.intp)))


@dataclass(frozen=True, slots=True)
class Samples:
    """Features (n, F) of scans of a submap, and the keyframes (n,) where they were taken.

    Of scans cast in a grid the keyframes are the nearest ones.
    """

    features: NDArray[Any]
    keyframes: NDArray[np.intp]

    def rows(self, chosen: NDArray[Any]) -> Samples:
        """Some of the samples."""
        return Samples(self.features[chosen], self.keyframes[chosen])


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Samples of all submaps: `raw` scans, from `beside` the way, virtual ones, and those `cast`.

    Virtual scans are `along` the track. Of scans cast in a grid, and of those from beside the way,
    the keyframes are the nearest ones. Without virtual scans there are none of the last two.
    """

    raw: Samples
    beside: Samples
    along: Samples
    cast: Samples

    @classmethod
    def of(cls, *kinds: Mapping[int, Samples]) -> TrainingData:
        """Those of every submap, a kind after the other."""
        return cls(*(together(kind[i] for i in sorted(kind)) for kind in kinds))

    @property
    def kinds(self) -> tuple[Samples, ...]:
        """The samples of one kind after the other."""
        return self.raw, self.beside, self.along, self.cast

    def left(self, numbers: IntArray, first: int = 0) -> TrainingData:
        """Those of the keyframes `numbers` (k,), ascending, which are numbered from `first` on."""
        left = (own.rows(np.isin(own.keyframes, numbers)) for own in self.kinds)
        return TrainingData(
            *(
                Samples(own.features, first + np.searchsorted(numbers, own.keyframes))
                for own in left
            )
        )

    @classmethod
    def joined(cls, parts: Sequence[TrainingData]) -> TrainingData:
        """Those of several maps in one."""
        of_kinds = zip(*(part.kinds for part in parts), strict=True)
        return cls(*(together(of_kind) for of_kind in of_kinds))


NO_SAMPLES = Samples(np.zeros((0, 0), dtype=np.float32), np.zeros(0, dtype=np.intp))
NO_TRAINING_DATA = TrainingData(NO_SAMPLES, NO_SAMPLES, NO_SAMPLES, NO_SAMPLES)


def together(samples: Iterable[Samples]) -> Samples:
    """Samples of several kinds or submaps, one after the other."""
    some = [own for own in samples if len(own.keyframes)]
    if not some:
        return NO_SAMPLES
    return Samples(
        np.vstack([own.features for own in some]), np.concatenate([own.keyframes for own in some])
    )


def of_keyframes(samples: Samples, keyframes: Collection[int]) -> Samples:
    """The samples of some keyframes."""
    return samples.rows(np.isin(samples.keyframes, np.fromiter(keyframes, dtype=np.intp)))


# Free cells taken lie this near the track: farther, much was never seen.
_AUGMENTATION_REACH_M = 1.5
_AUGMENTATION_CLEARANCE_M = 0.25  # free cells taken lie this far from walls, as a robot does

# Of the window: 1, 2, 5 and 10 m by default, as it has to work while it fills.
_WINDOW_SHARES = (0.1, 0.2, 0.5, 1.0)
_DRAWS = 6  # free cells drawn for one that is wanted: most lie too far from the track
_ALIKE_SHARE = 0.5  # of the cast samples is dealt out evenly, the rest by area
_ASIDE_M, _TURNED_RAD = 0.1, math.radians(15.0)  # standard deviation; at most
_NEAR = 4  # keyframes whose outlines are looked at: what one did not see another one did
_PLACE_M, _CHORD = 0.5, 0.5  # keyframes so far apart, or so much turned, are as unlike each other
_OUTLINES_KEPT = 256  # a few megabytes


def raw_samples(track: Track, config: Config, features: KeyframeFeatures) -> dict[int, Samples]:
    """The raw scans of every submap that are learned from, evenly spread over the recordings.

    Scans whose `features` are known come first.
    """
    samples = {}
    for i, numbers in track.submaps.items():
        own = np.asarray(numbers, dtype=np.intp)
        wanted = track.by_recording(evenly(own, config.recognition.positives))
        chosen: list[int] = []
        for recorded, share in zip(track.by_recording(own), wanted, strict=True):
            known = evenly(np.array(features.known(recorded.tolist()), dtype=np.intp), len(share))
            others = evenly(np.setdiff1d(recorded, known), len(share) - len(known))
            chosen += sorted([*known.tolist(), *others.tolist()])
        samples[i] = Samples(features.of(chosen), np.array(chosen, dtype=np.intp))
    return samples


def track_samples(
    track: Track, localization: LocalizationConfig, known: Samples = NO_SAMPLES
) -> dict[int, Samples]:
    """Virtual scans of every submap, of what was seen of late along the track.

    They need no grids. Recordings of which some are `known` are not looked at again.
    """
    numbers = np.flatnonzero(track.owner != NO_SUBMAP)
    wanted = track.by_recording(evenly(numbers, localization.track_samples))
    found: list[Samples] = []
    for own, share in zip(track.by_recording(numbers), wanted, strict=True):
        before = of_keyframes(known, own.tolist())
        if len(before.keyframes):
            # not every other one, as these are of equal windows
            order = np.random.default_rng(len(before.keyframes)).permutation(len(before.keyframes))
            found.append(before.rows(np.sort(order[: len(share)])))
        elif len(share):
            scans = _in_windows(track, own, set(share.tolist()))
            found.append(Samples(scans_features(scans, localization.feature_set), share))
    every = together(found)
    return {i: every.rows(track.owner[every.keyframes] == i) for i in sorted(track.submaps)}


def cast_samples(
    track: Track,
    grids: Mapping[int, GridMap],
    localization: LocalizationConfig,
    rng: np.random.Generator,
    known: Samples = NO_SAMPLES,
) -> dict[int, Samples]:
    """Virtual scans of every submap, cast from free cells near its track.

    Half are dealt out evenly, half by area; none in submaps of which some are `known`.
    """
    owner, samples = track.owner, {}
    whole = sum(grid.free_area_m2 for grid in grids.values())
    even = _ALIKE_SHARE / len(grids)
    tracked = np.flatnonzero(owner != NO_SUBMAP)
    tree = cKDTree(track.poses[tracked, :2])
    for i in sorted(track.submaps):
        by_area = (1.0 - _ALIKE_SHARE) * grids[i].free_area_m2 / whole if whole > 0.0 else even
        count = round(localization.augmentation * (even + by_area))
        before = known.rows(owner[known.keyframes] == i)
        if len(before.keyframes):
            samples[i] = before.rows(np.arange(min(count, len(before.keyframes))))
            continue
        cells = np.flatnonzero(grids[i].clearance() > _AUGMENTATION_CLEARANCE_M)
        drawn = np.zeros((0, 2))
        if len(cells) and count:
            chosen = cells[rng.integers(len(cells), size=_DRAWS * count)]
            drawn = grids[i].centres_of(np.column_stack(divmod(chosen, grids[i].cells.shape[1])))
        map_from_submap = Pose2(*track.poses[track.submaps[i][0]].tolist())
        distance, nearest = tree.query(map_from_submap.apply(drawn))
        near = (distance < _AUGMENTATION_REACH_M) & (owner[tracked][nearest] == i)
        origins = drawn[near][:count]
        scans = cast_circles(grids[i], origins, VIRTUAL_BEAMS, VIRTUAL_RANGE_M)
        features = scans_features(scans, localization.feature_set)
        samples[i] = Samples(features, tracked[nearest[near][:count]])
    return samples


def _in_windows(
    track: Track, numbers: NDArray[np.intp], sampled: Collection[int]
) -> Iterator[PlanarScan]:
    """What the window, moved over keyframes `numbers`, showed at those `sampled`."""
    window = RecentScans()
    turn = 0
    for number in numbers.tolist():
        pose = Pose2(*track.poses[number].tolist())
        mounting = track.store.base_from_laser(number)
        window.add(pose, mounting, partial(track.store.scan, number))
        if number in sampled:
            share = _WINDOW_SHARES[turn % len(_WINDOW_SHARES)]
            yield window.scan(0, pose @ mounting, share)
            turn += 1


def augmented_samples(
    track: Track, config: Config, rng: np.random.Generator, known: Samples = NO_SAMPLES
) -> dict[int, Samples]:
    """Scans of every submap, seen from beside its keyframes, with the nearest of these.

    A submap gets as many as it lacks of `recognition.augmentation` scans, or fewer: what comes to
    lie in another submap is left out. Those that are `known` are not made again.
    """
    poses, owner = track.poses, track.owner
    numbers = np.flatnonzero(owner != NO_SUBMAP)
    kept, sources, moved = {}, [], []
    for i, keyframes in sorted(track.submaps.items()):
        own = np.asarray(keyframes, dtype=np.intp)
        lacking = max(0, config.recognition.augmentation - len(own))
        before = of_keyframes(known, keyframes)
        kept[i] = before.rows(evenly(np.arange(len(before.keyframes)), lacking))
        lacking -= len(kept[i].keyframes)
        evenly_spread = np.linspace(0, len(own) - 1, lacking).astype(np.intp)
        sources.append(own[evenly_spread])  # some of them several times if need be
        aside = rng.normal(0.0, _ASIDE_M, (lacking, 2))
        turned = rng.uniform(-_TURNED_RAD, _TURNED_RAD, lacking)
        moved.append(np.column_stack([aside, turned]))
    source = np.concatenate(sources)
    placed = poses[source] + np.vstack(moved)
    nearest = numbers[cKDTree(poses[numbers, :2]).query(placed[:, :2])[1]]
    inside = owner[nearest] == owner[source]
    scans = _seen_from(track, numbers, source[inside], placed[inside])
    made = Samples(scans_features(scans, config.recognition.feature_set), nearest[inside])
    samples = {}
    for i, before in kept.items():
        beside = made.rows(owner[made.keyframes] == i)
        samples[i] = together([before, beside]) if len(before.keyframes) else beside
    return samples


def _seen_from(
    track: Track, numbers: NDArray[np.intp], sources: NDArray[np.intp], placed: FloatArray
) -> Iterator[PlanarScan]:
    """What lasers of `sources` (k,) would see from `placed` (k, 3), by what `numbers` saw."""

    store, poses = track.store, track.poses

    @lru_cache(_OUTLINES_KEPT)
    def outline_of(keyframe: int) -> FloatArray:
        scan, pose = store.scan(keyframe), Pose2(*poses[keyframe].tolist())
        return outline(scan, pose @ store.base_from_laser(keyframe), scan.range_max)

    near = min(_NEAR, len(numbers))
    tree = cKDTree(views(poses[numbers], _PLACE_M, _CHORD))
    _, rows = tree.query(views(placed, _PLACE_M, _CHORD), near)
    around = numbers[rows.reshape(len(placed), near)]
    for source, pose, keyframes in zip(sources.tolist(), placed, around.tolist(), strict=True):
        lines = np.vstack([outline_of(keyframe) for keyframe in keyframes])
        scan = store.scan(source)
        laser = Pose2(*pose.tolist()) @ store.base_from_laser(source)
        yield replace(scan, ranges=seen_from(lines, laser, scan.bearings, scan.range_max))


def views(poses: FloatArray, place_m: float, chord: float) -> FloatArray:
    """(n, 4) where poses (n, 3) look from, and where to.

    Those that are `place_m` apart, or turned by a `chord` of the unit circle, are one apart.
    """
    x, y, heading = poses.T
    facing = np.column_stack([np.cos(heading), np.sin(heading)]) / chord
    return np.hstack([np.column_stack([x, y]) / place_m, facing])

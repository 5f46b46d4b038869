"""A stretch of the way whose length was guessed: what a map would be if it were longer or shorter.

Along a bare corridor without odometry a map may be wrong by metres, and says so. Two maps of it
then differ in length: no rigid motion lays one on the other. So a new one that fits nowhere as it
is is tried with other lengths, and where one of them is right, it is given that of the old map.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import (
    BentMotion,
    FloatArray,
    LocalMotion,
    Pose2,
    compose,
    invert,
    travelled,
)
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.layout.result import propagated, rows_of
from specmap_cli.maps.filenames import KEYFRAMES
from specmap_cli.maps.store import Map
from specmap_cli.pipelines.map_in_making import LaidOut, quality_of_stored, submaps_of
from specmap_cli.quality.findings import UNMEASURED
from specmap_cli.recognition.closure.alignment import Alignment, MapToAlign, align

_STEP_M = 0.5  # between lengths that are tried: submaps that lie off by half of it still match
_TOLD = 2.0  # times what both maps tell: four standard deviations
_MOST_STEPS = 8  # longer, and shorter: the search takes that many times as long
_AROUND_M = 1.0  # way to either side of its middle: its direction, and where it is lengthened


@dataclass(frozen=True, slots=True)
class GuessedStretch:
    """The stretch of a map that may be off most, two standard deviations `off_m`.

    `keyframe` lies in its middle; those after it lie beyond.
    """

    keyframe: int
    off_m: float

    def heading(self, poses: FloatArray) -> float:
        """The direction of the stretch by the poses (n, 3) of all keyframes, radians."""
        way = travelled(poses)
        ends = way[self.keyframe] + np.array([-_AROUND_M, _AROUND_M])
        first, last = np.searchsorted(way, ends).clip(0, len(way) - 1).tolist()
        x, y = (poses[last, :2] - poses[first, :2]).tolist()
        return float(np.arctan2(y, x))

    def longer(self, poses: FloatArray, longer_m: float) -> FloatArray:
        """The poses (n, 3) of all keyframes with a stretch that is longer."""
        way, heading = travelled(poses), self.heading(poses)
        share = (way - way[self.keyframe] + _AROUND_M) / (2.0 * _AROUND_M)
        along = np.array([np.cos(heading), np.sin(heading), 0.0])
        return np.asarray(poses + longer_m * share.clip(0.0, 1.0)[:, None] * along)

    def motion(self, bent: BentMotion, poses: FloatArray, longer_m: float) -> BentMotion:
        """The motion of a map with that stretch, `bent`, as one of the map as it is.

        `poses` (n, 3) are those of all keyframes of the map as it is.
        """
        there = self.longer(poses, longer_m)
        number = np.unique(np.floor(travelled(poses) / _AROUND_M), return_index=True)[1]
        local = []
        for own, place in zip(poses[number, :2], there[number, :2], strict=True):
            x, y = (place - own).tolist()
            local.append(LocalMotion(own, bent.near(place) @ Pose2(x, y, 0.0), 1.0))
        return BentMotion(bent.rigid, tuple(local))


def stretch_of(findings: Sequence[Finding], stamps_ns: IntArray) -> GuessedStretch | None:
    """The stretch of a recording that its findings say may be off most; None where none is.

    `stamps_ns` (n,) are those of its keyframes.
    """
    told = [
        (one.value, one.where.stamp_ns)
        for one in findings
        if one.code == UNMEASURED and one.where is not None
    ]
    found = [(off_m, stamp) for off_m, stamp in told if off_m is not None and stamp is not None]
    if not found:
        return None
    off_m, stamp_ns = max(found)
    return GuessedStretch(int(np.abs(stamps_ns - stamp_ns).argmin()), off_m)


def stretch_of_stored(stored: Map) -> GuessedStretch | None:
    """The same of a stored map of one recording: of several nobody knows what lies beyond.

    None of a map without its scans, too: it cannot be drawn with another length.
    """
    if len(stored.logs) != 1 or not (stored.path / KEYFRAMES).exists():
        return None
    return stretch_of(quality_of_stored(stored).findings, stored.labels.stamps_ns)


def told_m(findings: Sequence[Finding]) -> float:
    """By how much the length of a stretch may be off, the most that findings tell; 0 for none."""
    return max((one.value or 0.0 for one in findings if one.code == UNMEASURED), default=0.0)


def aligned(old: MapToAlign, new: MapToAlign, bent: Iterable[MapToAlign]) -> Alignment:
    """Where one map lies in another: with its other lengths, `bent`, if it fits nowhere as is."""
    found = align(old, new)
    return align(old, new, bent) if found.old_from_new is None and bent else found


def with_other_lengths(
    stretch: GuessedStretch,
    old_off_m: float,
    store: KeyframeStore,
    poses: FloatArray,
    submaps: IntArray,
    config: Config,
) -> Iterator[MapToAlign]:
    """A map as the alignment takes it, with its stretch longer and shorter.

    By as much as both maps may be off; `old_off_m` is what the other one tells. `poses` (n, 3) and
    `submaps` (n,) are those of the keyframes of the store.
    """
    steps = min(_MOST_STEPS, int(_TOLD * (stretch.off_m + old_off_m) / _STEP_M))
    for step in (*range(-steps, 0), *range(1, steps + 1)):
        longer_m = step * _STEP_M
        bent = stretch.longer(poses, longer_m)
        grids, frames = {}, {}
        for id_, own in submaps_of(submaps).items():
            track = compose(invert(bent[own[0]]), bent[own])
            grids[id_] = integrate_keyframes(store, own, track, config.grid).snapshot()
            frames[id_] = Pose2(*bent[own[0]].tolist())
        whole = integrate_keyframes(store, range(len(bent)), bent, config.grid).snapshot()
        yield MapToAlign(
            whole=whole,
            grids=grids,
            frames=frames,
            longer_m=longer_m,
            heading=stretch.heading(poses),
        )


def lengthened(laid: LaidOut, stretch: GuessedStretch, longer_m: float) -> LaidOut:
    """A recording that was laid out by itself, with a longer stretch; it is still to be drawn."""
    poses = stretch.longer(laid.layout.poses, longer_m)
    way = laid.trajectory
    rows = rows_of(way, laid.labels.stamps_ns.tolist(), laid.labels.poses)
    return replace(
        laid,
        layout=replace(laid.layout, poses=poses),
        labels=replace(laid.labels, poses=poses),
        trajectory=replace(way, poses=propagated(way.poses, rows, poses)),
    )

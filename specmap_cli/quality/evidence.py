"""What the verdict on a map rests on, and the holes in its recording.

While no scans are recorded a robot may be carried elsewhere or drive on. Afterwards it may be taken
to stand in a room that only looks like the right one. Three things speak for the map: odometry that
moved, and moved as the map says; walls around a robot that stood still, which lie where they lay
before; and places further on that the robot knew from before the hole.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import runs
from specmap_cli.core.findings import Severity, Where
from specmap_cli.core.geometry import (
    IDENTITY,
    FloatArray,
    Pose2,
    compose,
    invert,
    moved,
    path_length,
    step_lengths,
)
from specmap_cli.core.records import BoolArray, IntArray, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.pose_graph import LinkArrays, spread_between
from specmap_cli.layout.result import Layout

MOVED_M = 1.0  # a piece that the layout moved farther is told of
MOVED_VOTES = 3  # a piece that was moved is doubtful when fewer matches say so
SAME_PLACE_M = 5.0  # disagreements, and matches, this near are of one place
ODOMETRY_SHARE = 0.3  # share of the way by which map and odometry may differ: wheels err less
ODOMETRY_WINDOW_M = 5.0  # way over which odometry is compared with the map
# Share of the way in a single place, where wheels slip, before it is noted.
ODOMETRY_SLIP_SHARE = 0.5
HOLE_S = 5.0  # a hole without scans: in less nobody carries a robot to another room
# In less a robot may drive on unseen, past a room that looks like the next: where no odometry tells
# the same motion as the map, a pause is a hole that is longer than this, and in which it comes
# farther than this, as before.
_SHORT_S, _UNSEEN_M = 1.0, 1.0
_HOLE_INTERVALS = 5.0  # a hole has so many usual intervals: robots that stand may record little
_HOLE_WALLS_M = 0.15  # walls this near to those seen before a hole are the same
STILL_M = 0.15  # motion over a hole of a robot that stood: noise, and a first step
STILL_RAD = 0.1  # turn over a hole of a robot that stood
_USUAL_PERCENTILE = 95.0  # of the intervals of a log: a few scans are late in most
_GUESSED = 0.01  # of a motion that may be off: more than walls leave open where they fix it
_OFF_M = 0.1  # by which a stretch may be off before anybody asks
_JUMP = 0.5  # share of a drive in one step that makes it a jump
_BEFORE = 10  # keyframes before a hole that tell which walls stood around: one sees not all
_RANGE_M = 12.0  # of walls that are compared: farther ones show every error of the heading

HoleKind = Literal["missing", "lost", "rest"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Hole:
    """A hole in what is known, `seconds` long, before row `row` of the trajectory.

    Scans were `missing` meanwhile, or `lost`, or the map had the robot at `rest` while odometry
    drove on. `keyframe` is the first one after it. `measured` is the motion of the base by
    odometry, None where nothing measured it. `apart` is the motion by odometry seen from that of
    the map, or without odometry that of a robot that stood or went on. `alike` is the share of the
    walls seen from the keyframe that lie where walls were seen before the hole.
    """

    row: int
    keyframe: int
    seconds: float
    measured: Pose2 | None
    apart: Pose2
    alike: float
    kind: HoleKind = "missing"


@dataclass(frozen=True, slots=True)
class Rival:
    """Another place, `away_m` away, that the walls of the piece from a keyframe on fit as well."""

    keyframe: int
    away_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A piece of the way, `way_m` long, that walls did not fix: how far it led was guessed.

    Its end, seen from its start, may be off by `off_m`, two standard deviations; closures and
    passes count. `keyframe` lies in its middle.
    """

    keyframe: int
    way_m: float
    off_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What is known of a map besides the map.

    `trajectory` is that of all scans in the finished layout, `keyframes_ns` the stamps of the
    keyframes, `breaks` the numbers of those at which tracking started afresh. `beyond` of them did
    not fit into the largest grid allowed. `warnings` are of reading and registration, `holes` those
    of the recording, `stretches` what of its way was guessed. Of pieces after ways that nothing
    measured `fitting` are the first keyframes of those that fit here alone, `rivals` other places
    of others. Recordings after the first one begin with the keyframes `starts`. `mounting` is the
    place of the laser on the base by the log.
    """

    trajectory: Trajectory
    keyframes_ns: IntArray
    breaks: tuple[int, ...]
    layout: Layout
    beyond: int
    warnings: tuple[str, ...]
    holes: tuple[Hole, ...] = ()
    stretches: tuple[Stretch, ...] = ()
    fitting: Collection[int] = ()
    rivals: tuple[Rival, ...] = ()
    starts: tuple[int, ...] = ()
    mounting: Pose2 = IDENTITY

    def at_keyframe(self, number: int) -> Where:
        """When a keyframe was seen, and where it lies in the map."""
        x, y, _ = self.layout.poses[number].tolist()
        return Where(int(self.keyframes_ns[number]), x, y)

    def at_scan(self, row: int) -> Where:
        """When a scan was seen, and where it lies in the map."""
        x, y, _ = self.trajectory.poses[row].tolist()
        return Where(int(self.trajectory.stamps_ns[row]), x, y)

    @property
    def measured(self) -> BoolArray:
        """(n,) which scans of the trajectory have odometry."""
        odometry = self.trajectory.odometry
        if odometry is None:
            return np.zeros(len(self.trajectory.poses), dtype=np.bool_)
        return np.asarray(np.isfinite(odometry[:, 0]))


def told(where: Where) -> str:
    """The stamp of a finding in words."""
    return f"{(where.stamp_ns or 0) * 1e-9:.3f} s"


def graded(value: float, doubtful: float, poor: float) -> tuple[Severity, float]:
    """How grave a value is by the limits that it passes, and the limit that counts."""
    if value > poor:
        return "poor", poor
    return ("doubtful" if value > doubtful else "note"), doubtful


def stretches_of(guessed_m: FloatArray, layout: Layout) -> tuple[Stretch, ...]:
    """The stretches of a way that were guessed, up to each keyframe by `guessed_m` (n, 2)."""
    nodes = layout.nodes if len(layout.nodes) else np.arange(len(layout.poses))
    poses, rows = layout.poses[nodes], {number: row for row, number in enumerate(nodes.tolist())}
    sizes = step_lengths(np.pad(guessed_m[nodes], ((0, 0), (0, 1))))
    edges = LinkArrays.of([*layout.odometry, *layout.kept], rows, {})
    found = []
    for start, end in runs(sizes > _GUESSED * step_lengths(poses)):
        off_m = 2.0 * float(sizes[start:end].sum())
        if off_m < _OFF_M:
            continue
        if layout.kept:
            (spread,) = spread_between(poses, edges, np.array([start]), np.array([end]))
            away = poses[end] - poses[start]
            x, y, _ = compose(invert(poses[end] * (0.0, 0.0, 1.0)), away).tolist()
            way = np.array([x, y]) / max(math.hypot(x, y), _OFF_M)
            off_m = min(off_m, 2.0 * math.sqrt(float(way @ spread[:2, :2] @ way)))
        way_m = path_length(poses[start : end + 1])
        middle = int(nodes[(start + end) // 2])
        found.append(Stretch(keyframe=middle, way_m=way_m, off_m=off_m))
    return tuple(found)


def holes_of(
    store: KeyframeStore,
    rows: IntArray,
    trajectory: Trajectory,
    layout: Layout,
    breaks: Collection[int],
) -> tuple[Hole, ...]:
    """The holes of a log, in their order, and what is known of the motion over each.

    `rows` (n,) of the trajectory are the keyframes of the store. `breaks` are those at which
    tracking started afresh: where odometry measured the motion meanwhile they count as holes, too.
    A robot that stood by its wheels may have been carried with its laser on.
    """
    found: list[Hole] = []
    for before, after, kind in sorted(_spans(trajectory, rows, breaks)):
        keyframe = int(np.searchsorted(rows, after))
        if not 0 < keyframe < len(rows):  # the map has nothing on one of the two sides
            continue
        # map and odometry are compared from the last scan that was registered to the next one
        start, end = _registered(trajectory, before, -1), _registered(trajectory, after, 1)
        around = _measured(trajectory, start, end)
        by_map = _motion(trajectory.poses, start, end)
        hole = Hole(
            row=after,
            keyframe=keyframe,
            seconds=float(trajectory.stamps_ns[after] - trajectory.stamps_ns[before]) * 1e-9,
            measured=None if around is None else _measured(trajectory, before, after),
            apart=by_map.inverse() @ (around or _expected(trajectory, start, end)),
            alike=_alike(store, layout.poses, keyframe),
            kind=kind,
        )
        found.append(hole)
    return tuple(found)


def _spans(
    trajectory: Trajectory, rows: IntArray, breaks: Collection[int]
) -> Iterator[tuple[int, int, HoleKind]]:
    """The rows between which holes lie, and what kind of hole each is."""
    intervals_s = np.diff(trajectory.stamps_ns) * 1e-9
    usual_s = 0.0
    if len(intervals_s):
        usual_s = float(np.percentile(intervals_s, _USUAL_PERCENTILE, method="lower"))
    missing = np.flatnonzero(intervals_s > max(_SHORT_S, _HOLE_INTERVALS * usual_s))
    drives_on = [
        intervals_s[before] > HOLE_S
        or (
            not _confirmed(trajectory, before, before + 1)
            and _went_on(trajectory, before, before + 1).distance > _UNSEEN_M
        )
        for before in missing.tolist()
    ]
    missing = missing[np.array(drives_on, dtype=np.bool_)]
    yield from ((before, before + 1, "missing") for before in missing.tolist())
    told = set(np.searchsorted(rows, missing + 1).tolist())
    for keyframe in sorted(set(breaks) - told):
        if 0 < keyframe < len(rows):
            after = int(rows[keyframe])
            before = _registered(trajectory, after - 1, -1)
            if _measured(trajectory, before, after) is not None:
                yield before, after, "lost"
    odometry = trajectory.odometry
    if odometry is None:
        return
    # the map has the robot at rest though odometry drives on: so a laser that hangs looks like
    rest, start = Pose2(*trajectory.poses[0].tolist()), 0
    way_m = ODOMETRY_SLIP_SHARE * ODOMETRY_WINDOW_M  # less may be wheels that slip
    for row in range(1, len(trajectory.poses)):
        here = Pose2(*trajectory.poses[row].tolist())
        if not moved(rest, here, STILL_M, STILL_RAD):
            continue
        driven = _measured(trajectory, start, row - 1)
        if driven is not None and driven.distance > way_m:
            steps = step_lengths(odometry[start:row])
            drives = np.nanmax(steps) < _JUMP * driven.distance  # it does not just jump there
            if drives and not ((start <= missing) & (missing < row)).any():
                yield start, row, "rest"
        rest, start = here, row


def _registered(trajectory: Trajectory, row: int, step: int) -> int:
    """The first row from `row` on that was not lost, `step` by step; the last one if all were."""
    lost, last = trajectory.lost, len(trajectory.poses) - 1
    while lost is not None and lost[row] and 0 < row < last:
        row += step
    return row


def _measured(trajectory: Trajectory, before: int, after: int) -> Pose2 | None:
    """The motion between two rows by odometry, None where it is not known."""
    odometry = trajectory.odometry
    if odometry is None or not np.isfinite(odometry[[before, after]]).all():
        return None
    return _motion(odometry, before, after)


def _confirmed(trajectory: Trajectory, before: int, after: int) -> bool:
    """Whether odometry moved between two rows as the map did: one that starts afresh does not."""
    measured = _measured(trajectory, before, after)
    by_map = _motion(trajectory.poses, before, after)
    return measured is not None and agree(measured, by_map.inverse() @ measured)


def _expected(trajectory: Trajectory, before: int, after: int) -> Pose2:
    """The motion of a robot that went on, or stood: as the map's. It does not stop for a moment."""
    by_map, went_on = _motion(trajectory.poses, before, after), _went_on(trajectory, before, after)
    short = trajectory.stamps_ns[after] - trajectory.stamps_ns[before] <= HOLE_S * 1e9
    choices = (went_on,) if short else (IDENTITY, went_on)
    return min(choices, key=lambda motion: (by_map.inverse() @ motion).distance)


def _went_on(trajectory: Trajectory, before: int, after: int) -> Pose2:
    """The motion of a robot that went on between two rows as in as long a time before."""
    stamps_ns = trajectory.stamps_ns
    earlier = int(np.searchsorted(stamps_ns, 2 * stamps_ns[before] - stamps_ns[after]))
    return _motion(trajectory.poses, earlier, before)


def _motion(poses: FloatArray, before: int, after: int) -> Pose2:
    return Pose2(*poses[before].tolist()).inverse() @ Pose2(*poses[after].tolist())


def _alike(store: KeyframeStore, poses: FloatArray, keyframe: int) -> float:
    """The share of the walls seen from a keyframe that lie where earlier keyframes saw some."""
    *before, seen = (
        Pose2(*poses[number].tolist()).apply(store.points(number, _RANGE_M))
        for number in range(max(0, keyframe - _BEFORE), keyframe + 1)
    )
    walls = np.concatenate(before)
    if not len(walls) or not len(seen):
        return 0.0
    away, _ = cKDTree(walls).query(seen)
    return float((away <= _HOLE_WALLS_M).mean())


def agree(measured: Pose2, apart: Pose2) -> bool:
    """Whether odometry that measured a motion, `apart` from the map's, tells the same motion."""
    slack_m = STILL_M + ODOMETRY_SHARE * measured.distance
    slack_rad = STILL_RAD + ODOMETRY_SHARE * abs(measured.theta)
    return apart.distance <= slack_m and abs(apart.theta) <= slack_rad


def is_still(motion: Pose2) -> bool:
    """Whether a robot with this motion over a hole stood."""
    return motion.distance <= STILL_M and abs(motion.theta) <= STILL_RAD

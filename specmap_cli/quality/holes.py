"""Holes in a recording: was the robot afterwards where the map has it?

While no scans are recorded a robot may be carried elsewhere or drive on. Afterwards it may be taken
to stand in a room that only looks like the right one. Three things speak for the map: odometry that
moved, and moved as the map says; walls around a robot that stood still, which lie where they lay
before; and places further on that the robot knew from before the hole.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from specmap_cli.core.findings import Finding, Where
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, moved, step_lengths, travelled
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.relaxation import Layout
from specmap_cli.quality.evidence import Evidence, Hole, HoleKind, place_at
from specmap_cli.quality.measured import ODOMETRY_SHARE, ODOMETRY_SLIP_SHARE, ODOMETRY_WINDOW_M
from specmap_cli.quality.placed import MOVED_VOTES, SAME_PLACE_M

_HOLE_S = 5.0  # a hole without scans: in less nobody carries a robot to another room
_HOLE_INTERVALS = 5.0  # a hole has so many usual intervals: robots that stand may record little
_HOLE_WALLS_M = 0.15  # walls this near to those seen before a hole are the same
_HOLE_WALLS_SHARE = 0.6  # share of the walls around a robot that stood; the rest moved or is new
_STILL_M = 0.15  # motion over a hole of a robot that stood: noise, and a first step
STILL_RAD = 0.1  # turn over a hole of a robot that stood
_TIE_M = 10.0  # way after a hole from which on matches confirm it: out of a room
HOLE = "hole-in-log"
_USUAL_PERCENTILE = 95.0  # of the intervals of a log: a few scans are late in most
_JUMP = 0.5  # share of a drive in one step that makes it a jump
_WHAT: dict[HoleKind, str] = {
    "missing": "there are no scans",
    "lost": "no scan could be registered",
    "rest": "the scans show the robot at rest",
}
_DRIVE_ON = "drive on through places seen before"
_ADVICE: dict[HoleKind, str] = {
    "missing": f"record without holes, or {_DRIVE_ON}",
    "lost": f"record nothing while the robot is carried, or {_DRIVE_ON}",
    "rest": "does the laser hang, or do the wheels spin?",
}
_BEFORE = 10  # keyframes before a hole that tell which walls stood around: one sees not all
_RANGE_M = 12.0  # of walls that are compared: farther ones show every error of the heading


def holes_of(
    store: KeyframeStore,
    rows: IntArray,
    trajectory: Trajectory,
    layout: Layout,
    breaks: Collection[int],
) -> tuple[Hole, ...]:
    """The holes of a log, in their order, and what is known of the motion over each.

    `rows` (n,) of the trajectory are the keyframes of the store. `breaks` are those at which
    tracking started afresh. Where odometry says that the robot stood still meanwhile, they count as
    holes, too: it may have been carried with its laser on.
    """
    found: list[Hole] = []
    for before, after, kind in sorted(_spans(trajectory, rows, breaks)):
        keyframe = int(np.searchsorted(rows, after))
        if 0 < keyframe < len(rows):  # else the map has nothing on one of the two sides
            alike = _alike(store, layout.poses, keyframe, _HOLE_WALLS_M)
            found.append(_hole(trajectory, before, after, kind, keyframe, alike))
    return tuple(found)


def _spans(
    trajectory: Trajectory, rows: IntArray, breaks: Collection[int]
) -> Iterator[tuple[int, int, HoleKind]]:
    """The rows between which holes lie, and what kind of hole each is."""
    missing = _missing(trajectory.stamps_ns)
    yield from ((before, before + 1, "missing") for before in missing.tolist())
    told = set(np.searchsorted(rows, missing + 1).tolist())
    for keyframe in sorted(set(breaks) - told):
        if 0 < keyframe < len(rows):
            after = int(rows[keyframe])
            before = _registered(trajectory, after - 1, -1)
            measured = _measured(trajectory, before, after)
            if measured is not None and _is_still(measured):
                yield before, after, "lost"
    for start, end in _rests(trajectory):
        if not ((start <= missing) & (missing < end)).any():
            yield start, end, "rest"


def _rests(trajectory: Trajectory) -> Iterator[tuple[int, int]]:
    """Rows between which the map has the robot at rest though odometry drives on.

    That is what a laser that hangs looks like.
    """
    if trajectory.odometry is None:
        return
    places, start = [Pose2(*pose) for pose in trajectory.poses.tolist()], 0
    way_m = ODOMETRY_SLIP_SHARE * ODOMETRY_WINDOW_M  # less may be wheels that slip
    for row in range(1, len(places)):
        if moved(places[start], places[row], _STILL_M, STILL_RAD):
            if _drives_on(trajectory, start, row - 1, way_m):
                yield start, row
            start = row


def _drives_on(trajectory: Trajectory, first: int, last: int, way_m: float) -> bool:
    """Whether odometry leads so far away between two rows, and does not just jump there."""
    driven = _measured(trajectory, first, last)
    if trajectory.odometry is None or driven is None or driven.distance <= way_m:
        return False
    steps = step_lengths(trajectory.odometry[first : last + 1])
    return bool(np.nanmax(steps) < _JUMP * driven.distance)


def _missing(stamps_ns: IntArray) -> IntArray:
    """The rows after which scans are missing: much longer than what is usual in this log."""
    intervals_s = np.diff(stamps_ns) * 1e-9
    if not len(intervals_s):
        return np.zeros(0, dtype=np.int64)
    usual_s = float(np.percentile(intervals_s, _USUAL_PERCENTILE, method="lower"))
    longest_s = max(_HOLE_S, _HOLE_INTERVALS * usual_s)
    return np.flatnonzero(intervals_s > longest_s)


def _hole(
    trajectory: Trajectory, before: int, after: int, kind: HoleKind, keyframe: int, alike: float
) -> Hole:
    """The hole between two rows of a trajectory, ahead of a keyframe.

    Map and odometry are compared from the last scan that was registered to the next one.
    """
    start, end = _registered(trajectory, before, -1), _registered(trajectory, after, 1)
    measured, around = (_measured(trajectory, a, b) for a, b in ((before, after), (start, end)))
    by_map = _motion(trajectory.poses, start, end)
    return Hole(
        row=after,
        keyframe=keyframe,
        seconds=float(trajectory.stamps_ns[after] - trajectory.stamps_ns[before]) * 1e-9,
        measured=None if around is None else measured,
        apart=by_map.inverse() @ (IDENTITY if around is None else around),
        alike=alike,
        kind=kind,
    )


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


def _motion(poses: FloatArray, before: int, after: int) -> Pose2:
    return Pose2(*poses[before].tolist()).inverse() @ Pose2(*poses[after].tolist())


def _alike(store: KeyframeStore, poses: FloatArray, keyframe: int, near_m: float) -> float:
    """The share of the walls seen from a keyframe that lie where earlier keyframes saw some."""
    before = range(max(0, keyframe - _BEFORE), keyframe)
    walls = np.concatenate([_walls(store, poses, number) for number in before])
    seen = _walls(store, poses, keyframe)
    if not len(walls) or not len(seen):
        return 0.0
    away, _ = cKDTree(walls).query(seen)
    return float((away <= near_m).mean())


def _walls(store: KeyframeStore, poses: FloatArray, number: int) -> FloatArray:
    return Pose2(*poses[number].tolist()).apply(store.points(number, _RANGE_M))


def unwatched(evidence: Evidence) -> Iterator[Finding]:
    """Holes after which nothing shows that the robot was where the map has it."""
    open_ = [hole for hole in evidence.holes if not _is_bridged(hole)]
    starts = np.unique(np.array([hole.keyframe for hole in open_], dtype=np.int64))
    joined = _joined(evidence.layout, starts)
    for hole in open_:
        number = int(np.searchsorted(starts, hole.keyframe))
        if joined[number + 1] in joined[: number + 1] and not _is_contradicted(hole):
            continue
        stamp_ns = int(evidence.trajectory.stamps_ns[hole.row])
        yield Finding(
            code=HOLE,
            severity="doubtful",
            message=f"{_WHAT[hole.kind]} for {hole.seconds:.0f} s before {stamp_ns * 1e-9:.3f} s, "
            f"and {_reason(hole)}: where the robot was afterwards is a guess",
            advice=_ADVICE[hole.kind],
            value=hole.seconds,
            limit=_HOLE_S if hole.kind == "missing" else None,
            where=Where.of(stamp_ns, place_at(evidence.trajectory, hole.row)),
        )


def _is_bridged(hole: Hole) -> bool:
    """Whether odometry moved as the map did, or the robot stood among the same walls.

    A robot that was carried elsewhere is not put down to a decimetre where it would have stood.
    """
    measured, apart = hole.measured, hole.apart
    if measured is None or _is_still(measured):
        return _is_still(apart) and hole.alike >= _HOLE_WALLS_SHARE
    slack_m = _STILL_M + ODOMETRY_SHARE * measured.distance
    slack_rad = STILL_RAD + ODOMETRY_SHARE * abs(measured.theta)
    return apart.distance <= slack_m and abs(apart.theta) <= slack_rad


def _is_contradicted(hole: Hole) -> bool:
    """Whether odometry and walls both say that the robot did not stay where the map has it.

    Matches do not count against that: in corridors there are many of a wrong map, too.
    """
    return hole.kind == "rest" and hole.alike < _HOLE_WALLS_SHARE


def _is_still(motion: Pose2) -> bool:
    return motion.distance <= _STILL_M and abs(motion.theta) <= STILL_RAD


def _joined(layout: Layout, starts: IntArray) -> IntArray:
    """To which group each of the pieces between holes belongs (holes + 1,).

    `starts` are the keyframes that follow the holes. Pieces are in one group when matches tie them
    in several places well after the hole: what was seen right behind it is what led to the belief.
    """
    way = travelled(layout.poses)
    ties: set[tuple[int, int, int]] = set()
    for link in layout.kept:
        older, newer = sorted((link.source, link.target))
        a, b = np.searchsorted(starts, (older, newer), side="right").tolist()
        if a == b:
            continue
        since_m = float(way[newer] - way[starts[b - 1]])
        if since_m >= _TIE_M:
            ties.add((a, b, int(since_m // SAME_PLACE_M)))
    return _groups(len(starts) + 1, sorted(ties), MOVED_VOTES)


def _groups(count: int, ties: Sequence[tuple[int, int, int]], votes: int) -> IntArray:
    """Pieces 0 to `count` that are tied in at least so many places."""
    a, b = np.array([tie[:2] for tie in ties], dtype=np.int64).reshape(-1, 2).T
    tied = coo_array((np.ones(len(a)), (a, b)), shape=(count, count)).tocsr()
    _, groups = connected_components(tied >= votes, directed=False)
    return np.asarray(groups, dtype=np.int64)


def _reason(hole: Hole) -> str:
    """Why the motion over a hole is not known."""
    measured, apart = hole.measured, hole.apart
    if measured is None:
        return "no odometry tells of it"
    if not _is_still(measured):
        return "odometry tells another motion than the map"
    if _is_still(apart):
        return "the walls changed though the wheels did not turn"
    return (
        f"the wheels did not turn though the map has the robot {apart.distance:.1f} m and "
        f"{math.degrees(abs(apart.theta)):.0f} degrees away"
    )

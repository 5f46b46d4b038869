"""Holes in a recording: whether anything shows that the robot was where the map has it afterwards.

Scans were missing, or could not be registered, or show the robot at rest while its wheels turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import travelled
from specmap_cli.core.records import IntArray
from specmap_cli.layout.result import Layout
from specmap_cli.quality.evidence import (
    HOLE_S,
    MOVED_VOTES,
    SAME_PLACE_M,
    Evidence,
    Hole,
    HoleKind,
    agree,
    is_still,
    told,
)

HOLE = "hole-in-log"
_HOLE_WALLS_SHARE = 0.6  # share of the walls around a robot that stood; the rest moved or is new
_TIE_M = 10.0  # way after a hole from which on matches confirm it: out of a room
_SESSION_S = 3600.0  # a longer hole without scans parts two sessions
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


def unwatched(evidence: Evidence) -> Iterator[Finding]:
    """Holes after which nothing shows that the robot was where the map has it."""
    doubts = [
        (hole, doubt)
        for hole in evidence.holes
        if hole.keyframe not in evidence.fitting and (doubt := doubt_of(hole))
    ]
    starts = np.unique(np.array([hole.keyframe for hole, _ in doubts], dtype=np.int64))
    joined = _joined(evidence.layout, starts)
    for hole, doubt in doubts:
        number = int(np.searchsorted(starts, hole.keyframe))
        # matches do not outvote odometry and walls: in corridors there are many of a wrong map, too
        denied = hole.kind == "rest" and hole.alike < _HOLE_WALLS_SHARE
        if joined[number + 1] in joined[: number + 1] and not denied:
            continue
        where = evidence.at_scan(hole.row)
        yield Finding(
            code=HOLE,
            severity="doubtful",
            message=f"{_WHAT[hole.kind]} for {hole.seconds:.0f} s before {told(where)}, "
            f"and {doubt}: where the robot was afterwards is a guess",
            advice=_ADVICE[hole.kind],
            value=hole.seconds,
            limit=HOLE_S if hole.kind == "missing" and hole.seconds > HOLE_S else None,
            where=where,
        )


def noted(evidence: Evidence) -> Iterator[Finding]:
    """Times without scans that are no doubt, but worth knowing.

    After hours it is another session. Where nothing but the walls around it says that the robot
    stood meanwhile, it may have been carried to a twin of the place.
    """
    for hole in evidence.holes:
        driven = hole.measured is not None and not is_still(hole.measured)
        where, advice, limit = evidence.at_scan(hole.row), "", HOLE_S
        if hole.kind != "missing" or hole.seconds <= HOLE_S:
            continue
        if hole.seconds > _SESSION_S:
            limit = _SESSION_S
            message = (
                f"no scan for {hole.seconds / 3600.0:.1f} h before {told(where)}: that is another "
                "session, and is mapped as one drive"
            )
            advice = "build a map of the first one, and add the others with `specmap update`"
        elif driven or doubt_of(hole):
            continue
        else:
            message = (
                f"{_WHAT[hole.kind]} for {hole.seconds:.0f} s before {told(where)}: the walls "
                "alone show where the robot was afterwards, and another place may look the same"
            )
        yield Finding(
            code=HOLE,
            severity="note",
            message=message,
            advice=advice,
            value=hole.seconds,
            limit=limit,
            where=where,
        )


def doubt_of(hole: Hole) -> str:
    """Why the motion over a hole is not known; nothing where it is.

    It is where odometry moved as the map did, or the robot stood among the same walls: one that was
    carried elsewhere is not put down to a decimetre where it would have stood.
    """
    measured, apart = hole.measured, hole.apart
    if measured is not None and not is_still(measured):
        return "" if agree(measured, apart) else "odometry tells another motion than the map"
    if is_still(apart) and hole.alike >= _HOLE_WALLS_SHARE:
        return ""
    if measured is None:
        return "no odometry tells of it"
    if is_still(apart):
        return "the walls changed though the wheels did not turn"
    return (
        f"the wheels did not turn though the map has the robot {apart.distance:.1f} m and "
        f"{math.degrees(abs(apart.theta)):.0f} degrees away"
    )


def _joined(layout: Layout, starts: IntArray) -> IntArray:
    """The group, joined by matches well after holes, of each piece between these (holes + 1,)."""
    way = travelled(layout.poses)
    ties: set[tuple[int, int, int]] = set()
    for link in layout.kept:
        older, newer = sorted((link.source, link.target))
        before, after = np.searchsorted(starts, (older, newer), side="right").tolist()
        if before == after:
            continue
        since_m = float(way[newer] - way[starts[after - 1]])
        if since_m >= _TIE_M:
            ties.add((before, after, int(since_m // SAME_PLACE_M)))
    count = len(starts) + 1
    a, b = np.array([tie[:2] for tie in sorted(ties)], dtype=np.int64).reshape(-1, 2).T
    places = coo_array((np.ones(len(a)), (a, b)), shape=(count, count)).tocsr()
    _, groups = connected_components(places >= MOVED_VOTES, directed=False)
    return np.asarray(groups, dtype=np.int64)

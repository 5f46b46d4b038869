"""Findings: of a recording, such as lost scans and holes, and of the layout of its map.

Every finding has a code that stays the same from version to version; docs/quality.md lists them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.arrays import runs
from specmap_cli.core.findings import INPUT, Finding
from specmap_cli.core.geometry import FloatArray, compose, invert, step_lengths, travelled
from specmap_cli.core.records import IntArray
from specmap_cli.core.text import counted
from specmap_cli.layout.audit import DOUBTFUL
from specmap_cli.layout.path_graph import Ends
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.result import Layout
from specmap_cli.quality.evidence import (
    HOLE_S,
    MOVED_M,
    MOVED_VOTES,
    ODOMETRY_SLIP_SHARE,
    ODOMETRY_WINDOW_M,
    SAME_PLACE_M,
    STILL_M,
    STILL_RAD,
    Evidence,
    Hole,
    HoleKind,
    graded,
    is_still,
    told,
)

LOST, BREAK, HOLE = "lost-scans", "tracking-break", "hole-in-log"
UNMEASURED, ODOMETRY = "unmeasured-way", "odometry-disagrees"

_LOST_SHARE = 0.02  # share of lost scans above which a map is doubtful
_LOST_SHARE_POOR = 0.2  # share of lost scans above which a map is poor
# Metres by which a way may be longer or shorter: more than what a right map is off, and a room.
_OFF_M, _OFF_M_POOR = 0.3, 1.0
ODOMETRY_SHARE = 0.3  # share of the way by which both may differ in the median: wheels err less
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


def lost_scans(evidence: Evidence) -> Iterator[Finding]:
    """Scans that could not be registered: their share, and where most of them are in a row."""
    lost = evidence.trajectory.lost
    if lost is None or not lost.any():
        return
    share = float(lost.mean())
    stretches = [(start, end) for start, end in runs(lost) if lost[start]]
    start, end = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    severity, limit = graded(share, _LOST_SHARE, _LOST_SHARE_POOR)
    where = evidence.at_scan(start)
    advice = "record odometry, or more scans a second"
    if evidence.measured.any():
        advice = (
            "has the laser returns all the time, and is the odometry of this robot and this "
            "clock? See `specmap info --check`"
        )
    yield Finding(
        code=LOST,
        severity=severity,
        message=f"{counted(int(lost.sum()), 'scan')} of {len(lost):,} ({share:.1%}) could not be "
        f"registered, {end - start:,} in a row from {told(where)} on",
        advice="" if severity == "note" else advice,
        value=share,
        limit=limit,
        where=where,
    )


def breaks(evidence: Evidence) -> Iterator[Finding]:
    """Where tracking started afresh; what is not tied to the rest is told of by `loose`."""
    bridge = "odometry" if evidence.measured.any() else "the motion before"
    for keyframe in evidence.breaks:
        if keyframe >= len(evidence.keyframes_ns):
            continue
        where = evidence.at_keyframe(keyframe)
        yield Finding(
            code=BREAK,
            severity="note",
            message=f"registration lost the robot before {told(where)} and started afresh, where "
            f"{bridge} led",
            where=where,
        )


def unmeasured_way(evidence: Evidence) -> Iterator[Finding]:
    """Stretches that may be longer or shorter, since walls did not show how far the robot came.

    The gravest ones first. Where odometry measured the way it counts, as well as odometry does.
    """
    for stretch in sorted(evidence.stretches, key=lambda one: -one.off_m):
        severity, limit = graded(stretch.off_m, _OFF_M, _OFF_M_POOR)
        if severity == "note":
            continue
        where = evidence.at_keyframe(stretch.keyframe)
        yield Finding(
            code=UNMEASURED,
            severity=severity,
            message=f"the way at {told(where)}, {stretch.way_m:.0f} m, may be "
            f"{stretch.off_m:.1f} m longer or shorter: walls do not show how far the robot came",
            advice="record odometry, or drive there a second time from another side",
            value=stretch.off_m,
            limit=limit,
            where=where,
        )


def odometry_disagrees(evidence: Evidence) -> Iterator[Finding]:
    """Odometry that tells another way than the map: everywhere, or in single places.

    Everywhere that wheels turn: it is of another robot or clock, or the laser is not where the log
    says. In a single place wheels slip, or the robot is carried, which is no fault of the map.
    """
    poses, odometry = evidence.trajectory.poses, evidence.trajectory.odometry
    if odometry is None or not evidence.measured.any():
        return
    way = travelled(poses)
    starts = np.searchsorted(
        way, np.arange(0.0, way[-1] - ODOMETRY_WINDOW_M, 0.5 * ODOMETRY_WINDOW_M)
    )
    ends = np.searchsorted(way, way[starts] + ODOMETRY_WINDOW_M)
    known = ends < len(way)
    known[known] &= np.isfinite(odometry[starts[known], 0] + odometry[ends[known], 0])
    starts, ends = starts[known], ends[known]
    if not len(starts):
        return
    by_map, by_odometry = (compose(invert(p[starts]), p[ends]) for p in (poses, odometry))
    off = compose(invert(by_map), by_odometry)
    apart = np.hypot(off[:, 0], off[:, 1]) / ODOMETRY_WINDOW_M
    # wheels that stand while the map moves tell of a robot that is carried, unless they mostly do
    turned = np.nancumsum(step_lengths(odometry))
    driven = turned[ends - 1] - turned[starts] > ODOMETRY_SHARE * ODOMETRY_WINDOW_M
    usual = float(np.median(apart[driven] if driven.mean() > ODOMETRY_SHARE else apart))
    worst = int(apart.argmax())
    everywhere = usual > ODOMETRY_SHARE
    share = usual if everywhere else float(apart[worst])
    limit = ODOMETRY_SHARE if everywhere else ODOMETRY_SLIP_SHARE
    if share <= limit:
        return
    where = evidence.at_scan(int(starts[worst]))
    place = "nearly everywhere" if everywhere else f"at {told(where)}, elsewhere by {usual:.0%}"
    advice = "is the odometry of this robot and this clock, is the laser where the log says?"
    yield Finding(
        code=ODOMETRY,
        severity="doubtful" if everywhere else "note",
        message=f"odometry and the map disagree by {share:.0%} of the way {place}",
        advice=advice if everywhere else "",
        value=share,
        limit=limit,
        where=where,
    )


def unwatched(evidence: Evidence) -> Iterator[Finding]:
    """Holes after which nothing shows that the robot was where the map has it."""
    doubts = [(hole, doubt) for hole in evidence.holes if (doubt := _doubt(hole))]
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
            limit=HOLE_S if hole.kind == "missing" else None,
            where=where,
        )


def sessions(evidence: Evidence) -> Iterator[Finding]:
    """Holes of hours: recordings of several sessions that are read as one drive."""
    for hole in evidence.holes:
        if hole.kind != "missing" or hole.seconds <= _SESSION_S:
            continue
        where = evidence.at_scan(hole.row)
        yield Finding(
            code=HOLE,
            severity="note",
            message=f"no scan for {hole.seconds / 3600.0:.1f} h before {told(where)}: that is "
            "another session, and is mapped as one drive",
            advice="build a map of the first one, and add the others with `specmap update`",
            value=hole.seconds,
            limit=_SESSION_S,
            where=where,
        )


def _doubt(hole: Hole) -> str:
    """Why the motion over a hole is not known; nothing where it is.

    It is where odometry moved as the map did, or the robot stood among the same walls: one that was
    carried elsewhere is not put down to a decimetre where it would have stood.
    """
    measured, apart = hole.measured, hole.apart
    if measured is not None and not is_still(measured):
        slack_m = STILL_M + ODOMETRY_SHARE * measured.distance
        slack_rad = STILL_RAD + ODOMETRY_SHARE * abs(measured.theta)
        same = apart.distance <= slack_m and abs(apart.theta) <= slack_rad
        return "" if same else "odometry tells another motion than the map"
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


def of_recording(evidence: Evidence) -> list[Finding]:
    """What is to be said of a recording, wherever its map is laid into another one."""
    checks = (lost_scans, breaks, unwatched, sessions, unmeasured_way, odometry_disagrees)
    inputs = [Finding(code=INPUT, severity="note", message=text) for text in evidence.warnings]
    return [finding for check in checks for finding in check(evidence)] + inputs


LOOSE, MOVED, RIVAL, LAYOUT = "loose-part", "part-moved", "rival-place", "layout-refused"
WALLS, REFUTED, BEYOND = "walls-disagree", "closures-refuted", "beyond-grid"
LAYOUT_CODES = frozenset({LOOSE, MOVED, RIVAL, LAYOUT, WALLS, REFUTED, BEYOND})

_LOOSE_SHARE_POOR = 0.1  # share of the way that a guess places, above which a map is poor
_CONTRADICTED_POOR = 0.1  # share of the walls that two passes saw
_LEAST = 2  # that agree to a metre and a few degrees: of wrong ones no two do by chance


def loose_parts(evidence: Evidence) -> Iterator[Finding]:
    """Pieces of the way after a break that nothing ties to the others."""
    layout = evidence.layout
    steps = step_lengths(layout.poses)
    total_m = float(steps.sum())
    ends = [*sorted({*evidence.breaks, len(layout.poses)})]
    for start in layout.loose:
        end = next((number for number in ends if number > start), len(layout.poses))
        way_m = float(steps[start : end - 1].sum())
        share = way_m / total_m if total_m else 1.0
        severity, limit = graded(share, 0.0, _LOOSE_SHARE_POOR)
        where = evidence.at_keyframe(start)
        message = (
            f"a guess alone places the {way_m:.0f} m that follow {told(where)}: nothing there was "
            "recognised"
        )
        advice = "drive through a place seen before, or record odometry"
        if start in evidence.starts:  # each part is as good as it was by itself
            severity, limit = "doubtful", 0.0
            message = (
                f"nothing ties the {way_m:.0f} m recorded from {told(where)} on to the other "
                "recordings: where they lie beside these is arbitrary"
            )
            advice = "record a drive through places of both, and add it"
        yield Finding(
            code=LOOSE,
            severity="doubtful" if severity == "note" else severity,
            message=message,
            advice=advice,
            value=share,
            limit=limit,
            where=where,
        )


def walls(evidence: Evidence) -> Iterator[Finding]:
    """Places where passes of the robot disagree about the walls, a finding a place."""
    agreement, told_at = evidence.layout.agreement, list[tuple[float, float]]()
    if not agreement.is_doubtful:
        return
    severity, limit = graded(agreement.share, DOUBTFUL, _CONTRADICTED_POOR)
    for row in agreement.worst:
        number = int(evidence.layout.nodes[row])
        where, (x, y) = evidence.at_keyframe(number), evidence.layout.poses[number, :2].tolist()
        if any(np.hypot(x - a, y - b) <= SAME_PLACE_M for a, b in told_at):
            continue
        told_at.append((x, y))
        yield Finding(
            code=WALLS,
            severity=severity,
            message=f"walls seen around {told(where)} contradict what was seen when the robot was "
            f"there before ({agreement.share:.1%} of what was seen twice in the map)",
            advice="the map is bent or folded there, or the building changed",
            value=agreement.share,
            limit=limit,
            where=where,
        )


def moved_parts(evidence: Evidence) -> Iterator[Finding]:
    """Pieces after a break that the layout moved far, and by how many closures and passes."""
    for part in evidence.layout.parts:
        if part.moved_m <= MOVED_M or not part.votes:
            continue
        where = evidence.at_keyframe(part.first)
        yield Finding(
            code=MOVED,
            severity="doubtful" if part.votes < MOVED_VOTES else "note",
            message=f"the layout moved what follows {told(where)} by "
            f"{part.moved_m:.1f} m, to where closures and passes ({part.votes}) put it",
            value=part.moved_m,
            limit=MOVED_M,
            where=where,
        )


def refused_layout(evidence: Evidence) -> Iterator[Finding]:
    """A layout under which more walls contradict each other is not taken."""
    if evidence.layout.choice == "tracked" and len(evidence.layout.nodes):
        yield Finding(
            code=LAYOUT,
            severity="doubtful",
            message="with the matches found, more walls contradict each other than without: the "
            "poses are those of the tracking",
            advice="its drift is in the map",
        )


def left_out(evidence: Evidence) -> Iterator[Finding]:
    """Closures that contradict the layout, as some always do where rooms look alike; keyframes that
    did not fit into the largest grid allowed.
    """
    count = sum(link.kind == "closure" for link in evidence.layout.dropped)
    if count:
        verb = "contradicts" if count == 1 else "contradict"
        yield Finding(
            code=REFUTED,
            severity="note",
            message=f"{counted(count, 'loop closure')} {verb} the rest: left out",
            value=float(count),
        )
    if evidence.beyond:
        yield Finding(
            code=BEYOND,
            severity="doubtful",
            message=f"{counted(evidence.beyond, 'keyframe')} beyond the largest grid allowed, left "
            "out of the map",
            advice="raise grid.max_extent_m or grid.max_area_m2",
            value=float(evidence.beyond),
            limit=0.0,
        )


def rival_places(evidence: Evidence) -> Iterator[Finding]:
    """Pieces after an unmeasured hole or break that several refuted closures put elsewhere.

    Where nothing measured the way, closures and passes alone say where the robot was afterwards. In
    a building whose wings look alike many of them may agree and be wrong. Then the few that lead to
    the right place were refuted; but they agree, too, which chance hardly makes.
    """
    poses = evidence.layout.poses
    starts = {hole.keyframe for hole in evidence.holes if hole.measured is None}
    if not evidence.measured.any():
        starts |= set(evidence.breaks)
    for start in sorted(start for start in starts if start < len(evidence.keyframes_ns)):
        across = [
            link
            for link in evidence.layout.dropped
            if link.kind == "closure" and (link.source < start) != (link.target < start)
        ]
        votes, motion = _most_agreed(across, poses)
        if votes < _LEAST:
            continue
        away = compose(invert(poses[start]), compose(motion, poses[start]))
        away_m = float(np.hypot(away[0], away[1]))
        where = evidence.at_keyframe(start)
        yield Finding(
            code=RIVAL,
            severity="doubtful",
            message=f"{counted(votes, 'refuted loop closure')} agree that what follows "
            f"{told(where)} lies {away_m:.1f} m elsewhere, and nothing measured the way "
            "there: parts of the building look alike",
            advice="record odometry, and without holes",
            value=float(votes),
            limit=float(_LEAST),
            where=where,
        )


def _most_agreed(links: Sequence[Link], poses: FloatArray) -> tuple[int, FloatArray]:
    """How many links agree on one motion (3,) of the newer piece in the map, and that motion.

    What moves it no farther than `MOVED_M` is no other place. Links of one keyframe count once.
    """
    ends = Ends.of(range(len(poses)), links)
    newer, claimed = poses[ends.j], compose(poses[ends.i], ends.z)
    motions = compose(claimed, invert(newer))
    away = compose(invert(newer), claimed)
    best, motion = 0, np.zeros(3)
    for k in np.flatnonzero(np.hypot(away[:, 0], away[:, 1]) > MOVED_M).tolist():
        apart = compose(invert(compose(motions[k], newer)), claimed)
        agree = (np.hypot(apart[:, 0], apart[:, 1]) <= MOVED_M) & (abs(apart[:, 2]) <= STILL_RAD)
        votes = min(len(set(numbers[agree].tolist())) for numbers in (ends.i, ends.j))
        if votes > best:
            best, motion = votes, motions[k]
    return best, motion


def of_layout(evidence: Evidence) -> list[Finding]:
    """What is to be said of a layout, of one recording or of several."""
    checks = (loose_parts, moved_parts, rival_places, refused_layout, walls, left_out)
    return [finding for check in checks for finding in check(evidence)]

"""Findings: of a recording, such as lost scans and holes, and of the layout of its map.

Every finding has a code that stays the same from version to version; docs/quality.md lists them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import compress

import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.findings import INPUT, Finding
from specmap_cli.core.geometry import (
    FloatArray,
    compose,
    inverse3,
    invert,
    step_lengths,
)
from specmap_cli.core.text import counted
from specmap_cli.layout.audit import DOUBTFUL
from specmap_cli.layout.consistency import MEND_SIGMAS
from specmap_cli.layout.path_graph import Ends
from specmap_cli.layout.pose_graph import Link, LinkArrays, errors, spread_between
from specmap_cli.quality.evidence import (
    MOVED_M,
    MOVED_VOTES,
    SAME_PLACE_M,
    STILL_M,
    STILL_RAD,
    Evidence,
    graded,
    told,
)
from specmap_cli.quality.holes import noted, unwatched
from specmap_cli.quality.odometry import laser_misplaced, odometry_disagrees

LOST, BREAK = "lost-scans", "tracking-break"
UNMEASURED = "unmeasured-way"

_LOST_SHARE = 0.02  # share of lost scans above which a map is doubtful
_LOST_SHARE_POOR = 0.2  # share of lost scans above which a map is poor
# Metres by which a way may be longer or shorter: more than what a right map is off, and a room.
_OFF_M, _OFF_M_POOR = 0.3, 1.0


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


def unmoved(evidence: Evidence) -> Iterator[Finding]:
    """A robot that stood all the time: no place of its map was seen from another one."""
    places = evidence.layout.poses[:, :2]
    if np.hypot(*(places - places[0]).T).max() <= STILL_M:
        yield Finding(
            code=INPUT,
            severity="note",
            message="the robot did not leave its place: nothing confirms what it saw from there",
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


def of_recording(evidence: Evidence) -> list[Finding]:
    """What is to be said of a recording, wherever its map is laid into another one."""
    checks = (
        lost_scans,
        unmoved,
        breaks,
        unwatched,
        rival_places,
        noted,
        unmeasured_way,
        laser_misplaced,
        odometry_disagrees,
    )
    inputs = [Finding(code=INPUT, severity="note", message=text) for text in evidence.warnings]
    return [finding for check in checks for finding in check(evidence)] + inputs


LOOSE, MOVED, RIVAL, LAYOUT = "loose-part", "part-moved", "rival-place", "layout-refused"
WALLS, REFUTED, BEYOND = "walls-disagree", "closures-refuted", "beyond-grid"
NARROW = "too-narrow"
LAYOUT_CODES = frozenset({LOOSE, MOVED, RIVAL, LAYOUT, WALLS, REFUTED, BEYOND, NARROW})

_LOOSE_SHARE_POOR = 0.1  # share of the way that a guess places, above which a map is poor
_CONTRADICTED_POOR = 0.1  # share of the walls that two passes saw
_NARROW_SHARE = 0.5  # of the links that the robot drove along: it cannot be so wide
_TOLD = 5  # links with their ids
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
    """Pieces after ways that nothing measured, whose walls fit elsewhere, too.

    In a building whose wings look alike many closures may agree on the wrong one.
    """
    for rival in evidence.rivals:
        where = evidence.at_keyframe(rival.keyframe)
        yield Finding(
            code=RIVAL,
            severity="doubtful",
            message=f"the walls of what follows {told(where)} fit {rival.away_m:.1f} m elsewhere, "
            "too, and nothing measured the way there: parts of the building look alike",
            advice="record odometry, and without holes",
            value=rival.away_m,
            where=where,
        )


def maybe_back(evidence: Evidence) -> Iterator[Finding]:
    """Walls found where the robot was before, too few times to move the map to there.

    What the finished layout rules out only looks alike, as bays of shelves do.
    """
    layout = evidence.layout
    passes = [link for link in layout.dropped if link.kind == "nearby"]
    alone = [link for link in passes if layout.why.get((link.source, link.target)) == "alone"]
    if not alone:
        return
    nodes = {number: row for row, number in enumerate(layout.nodes.tolist())}
    poses, ends = layout.poses[layout.nodes], Ends.of(nodes, alone)
    edges = LinkArrays.of([*layout.odometry, *layout.kept], nodes, {})
    missed = errors(poses, ends.i, ends.j, ends.z)
    known = inverse3(spread_between(poses, edges, ends.i, ends.j))
    is_open = np.einsum("la,lab,lb->l", missed, known, missed) <= MEND_SIGMAS**2
    alone = list(compress(alone, is_open.tolist()))
    votes, motion = _most_agreed(alone, layout.poses)
    if votes >= _LEAST:
        start = min(max(link.source, link.target) for link in alone)
        x, y, _ = compose(motion, layout.poses[start]) - layout.poses[start]
        where = evidence.at_keyframe(start)
        yield Finding(
            code=RIVAL,
            severity="doubtful",
            message=f"walls seen around {told(where)} and {counted(votes - 1, 'time')} more look "
            f"like those seen {math.hypot(x, y):.1f} m from there before: too few to tell whether "
            "the robot came back",
            advice="drive some metres more of a way that was driven before",
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


def narrow_links(
    driven: int, narrow: Mapping[tuple[int, int], float | None], radius_m: float
) -> Iterator[Finding]:
    """Links that the robot drove along, and that have no way for one of this radius.

    `narrow` are the pairs of submaps with the radius that fits, None where no free floor joins
    them; of all that it drove along, which are `driven`.
    """
    if narrow:
        share = len(narrow) / driven
        severity, limit = graded(share, _NARROW_SHARE, math.inf)
        links = [
            f"{one}-{other} ({'shut' if fits_m is None else f'{fits_m:.2f} m fits'})"
            for (one, other), fits_m in list(narrow.items())[:_TOLD]
        ]
        links += ["..."] * (len(narrow) > _TOLD)
        is_shut = all(fits_m is None for fits_m in narrow.values())
        yield Finding(
            code=NARROW,
            severity=severity,
            message=f"{len(narrow):,} of the {counted(driven, 'link')} that the robot drove along "
            f"have no way for a robot of {radius_m:g} m radius: {', '.join(links)}",
            advice="look what stands there now"
            if is_shut
            else "build with `--set ways.robot_radius_m=...`, half the width of your robot",
            value=share,
            limit=limit,
        )


def is_of_recording(finding: Finding) -> bool:
    """Whether a finding of a stored map stays when it is laid out anew: it is of a recording.

    What is told of its layout is found again. Of rival places those have a limit.
    """
    return finding.code not in LAYOUT_CODES or (finding.code == RIVAL and finding.limit is None)


def of_layout(evidence: Evidence) -> list[Finding]:
    """What is to be said of a layout, of one recording or of several."""
    checks = (loose_parts, moved_parts, maybe_back, refused_layout, walls, left_out)
    return [finding for check in checks for finding in check(evidence)]

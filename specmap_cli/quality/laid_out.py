"""Findings about the layout: pieces without a tie, closures refused, walls drawn twice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import FloatArray, compose, invert, step_lengths
from specmap_cli.core.text import counted
from specmap_cli.layout.audit import DOUBTFUL
from specmap_cli.layout.path_graph import Ends
from specmap_cli.layout.pose_graph import Link
from specmap_cli.quality.evidence import (
    MOVED_M,
    MOVED_VOTES,
    SAME_PLACE_M,
    STILL_RAD,
    Evidence,
    graded,
    told,
)

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
        yield Finding(
            code=LOOSE,
            severity="doubtful" if severity == "note" else severity,
            message=f"a guess alone places the {way_m:.0f} m that follow "
            f"{told(where)}: nothing there was recognised",
            advice="drive through a place seen before, or record odometry",
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


def refuted(evidence: Evidence) -> Iterator[Finding]:
    """Closures that contradict the layout; where rooms look alike some always do."""
    count = sum(link.kind == "closure" for link in evidence.layout.dropped)
    if count:
        verb = "contradicts" if count == 1 else "contradict"
        yield Finding(
            code=REFUTED,
            severity="note",
            message=f"{counted(count, 'loop closure')} {verb} the rest: left out",
            value=float(count),
        )


def beyond_grid(evidence: Evidence) -> Iterator[Finding]:
    """Keyframes that did not fit into the largest grid allowed."""
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
    checks = (
        *(loose_parts, moved_parts, rival_places, refused_layout),
        *(walls, refuted, beyond_grid),
    )
    return [finding for check in checks for finding in check(evidence)]

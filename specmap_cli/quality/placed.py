"""Findings about the layout: pieces without a tie, closures refused, walls drawn twice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from specmap_cli.core.findings import Finding, Where
from specmap_cli.core.geometry import step_lengths
from specmap_cli.core.text import counted
from specmap_cli.layout.audit import Disagreement
from specmap_cli.quality.evidence import Evidence, graded

_LOOSE_SHARE_POOR = 0.1  # share of the way that a guess places, above which a map is poor
_WALLS_SHARE_POOR = 0.1  # share of the passes compared that disagree, above which a map is poor
MOVED_M = 1.0  # a piece that the layout moved farther is told of
MOVED_VOTES = 3  # a piece that was moved is doubtful when fewer matches say so
SAME_PLACE_M = 5.0  # disagreements, and matches, this near are of one place
LOOSE, WALLS, REFUTED = "loose-part", "walls-disagree", "closures-refuted"
MENDED = "walls-mended"
BEYOND, MOVED, LAYOUT = "beyond-grid", "part-moved", "layout-refused"


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
        stamp_ns = evidence.keyframes_ns[start]
        yield Finding(
            code=LOOSE,
            severity="doubtful" if severity == "note" else severity,
            message=f"a guess alone places the {way_m:.0f} m that follow "
            f"{stamp_ns * 1e-9:.3f} s: nothing there was recognised",
            advice="drive through a place seen before, or record odometry",
            value=share,
            limit=limit,
            where=Where.of(stamp_ns, evidence.place_of(start)),
        )


def walls(evidence: Evidence) -> Iterator[Finding]:
    """Places where passes of the robot disagree about the walls, a finding a place."""
    found = evidence.audit.disagreements
    if not found:
        return
    share = len(found) / evidence.audit.compared
    severity, limit = graded(share, 0.0, _WALLS_SHARE_POOR)
    for group in _by_place(found, SAME_PLACE_M):
        worst = max(group, key=lambda one: one.walls_m)
        x, y = worst.place
        earlier_ns, later_ns = (evidence.keyframes_ns[n] for n in (worst.earlier, worst.later))
        apart_m = worst.apart_m
        how = "contradict each other" if apart_m is None else f"are {apart_m:.2f} m apart"
        yield Finding(
            code=WALLS,
            severity=severity,
            message=f"near ({x:.1f}, {y:.1f}) the walls seen at {earlier_ns * 1e-9:.3f} s and "
            f"{later_ns * 1e-9:.3f} s {how} (over {worst.walls_m:.1f} m)",
            advice="the map is bent or folded there, or the building changed",
            value=share,
            limit=limit,
            where=Where.of(later_ns, worst.place),
        )


def contradictions(evidence: Evidence) -> Iterator[Finding]:
    """Passes that contradict each other all over the map, a little everywhere."""
    standing = evidence.layout.evidence.standing
    if standing.is_doubtful and not evidence.audit.disagreements:
        yield Finding(
            code=WALLS,
            severity="doubtful",
            message=f"{standing.share:.1%} of the walls that two passes saw contradict each other",
            advice="the map is bent, or much moved meanwhile",
            value=standing.share,
        )


def mended(evidence: Evidence) -> Iterator[Finding]:
    """Walls that the layout drew twice and the audit brought together; what is left is told."""
    healing = evidence.layout.healing
    if healing is not None:
        yield Finding(
            code=MENDED,
            severity="note",
            message=f"{healing.walls_m:.1f} m of wall were drawn twice: matched again in "
            f"{counted(len(healing.links), 'place')}, the map moved by up to {healing.moved_m:.2f} "
            "m",
            value=healing.moved_m,
        )


def moved_parts(evidence: Evidence) -> Iterator[Finding]:
    """Pieces after a break that the layout moved far, and by how many closures and passes."""
    for part in evidence.layout.evidence.parts:
        if part.moved_m <= MOVED_M or not part.votes:
            continue
        stamp_ns = evidence.keyframes_ns[part.first]
        yield Finding(
            code=MOVED,
            severity="doubtful" if part.votes < MOVED_VOTES else "note",
            message=f"the layout moved what follows {stamp_ns * 1e-9:.3f} s by "
            f"{part.moved_m:.1f} m, to where closures and passes ({part.votes}) put it",
            value=part.moved_m,
            limit=MOVED_M,
            where=Where.of(stamp_ns, evidence.place_of(part.first)),
        )


def refused_layout(evidence: Evidence) -> Iterator[Finding]:
    """A layout under which more walls contradict each other is not taken."""
    if evidence.layout.evidence.choice == "tracked" and len(evidence.layout.nodes):
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


def _by_place(found: Sequence[Disagreement], reach_m: float) -> Iterator[list[Disagreement]]:
    """Disagreements near each other together, the longest walls first."""
    waiting = sorted(found, key=lambda one: -one.walls_m)
    while waiting:
        centre = np.array(waiting[0].place)
        near = [np.hypot(*(np.array(one.place) - centre)) <= reach_m for one in waiting]
        yield [one for one, is_near in zip(waiting, near, strict=True) if is_near]
        waiting = [one for one, is_near in zip(waiting, near, strict=True) if not is_near]

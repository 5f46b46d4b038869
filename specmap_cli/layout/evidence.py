"""What a layout rests on, and how far it moved things: what an audit and a verdict need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.layout.contradictions import Standing
from specmap_cli.layout.judging import Judged
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.stops import stops
from specmap_cli.layout.uncertainty import misfit, path_error, surprise

_STRETCH_M = 10.0  # of path: shorter ones bend by what a nearby pass mends anywhere

# relaxed: closures and passes; passes: these alone, closures contradicted them; tracked: as it was
Choice = Literal["relaxed", "passes", "tracked"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SuspectGroup:
    """Closures that follow one another along both passes, and mend more than a little.

    They lie between keyframes `first` and `last` of the newer pass and would move it by `away_m`.
    The standings are of the layouts with and without them.
    """

    links: tuple[Link, ...]
    first: int
    last: int
    away_m: float
    believed: bool
    standing_with: Standing
    standing_without: Standing


@dataclass(frozen=True, slots=True, kw_only=True)
class PartMove:
    """A piece of the path from keyframe `first` on, after a break, against what bridged the break.

    `moved_m` and `turned_rad`: its first keyframe seen from the one before, layout against tracked.
    `votes` closures and passes tie it to other parts; without any it is where the guess put it.
    """

    first: int
    moved_m: float
    turned_rad: float
    votes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Bend:
    """A stretch of path that the layout bent: keyframe `target` seen from keyframe `source`.

    `moved_m` and `turned_rad` are those of the layout against what was tracked. `sigmas`
    compares both with the error of the stretch.
    """

    source: int
    target: int
    moved_m: float
    turned_rad: float
    sigmas: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Healing:
    """What the audit mended: `links` between passes that drew their walls twice.

    `walls_m` of wall were contradicted before. No keyframe was moved farther than `moved_m`.
    """

    links: tuple[Link, ...]
    walls_m: float
    moved_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LayoutEvidence:
    """What was judged, what moved, and how the passes stand to each other before and after.

    `bends` holds every stretch of 10 m. `limits` counts by the name of a setting how often it cut
    the work short.
    """

    choice: Choice = "tracked"
    closures: tuple[Judged, ...] = ()
    groups: tuple[SuspectGroup, ...] = ()
    parts: tuple[PartMove, ...] = ()
    bends: tuple[Bend, ...] = ()
    standing_tracked: Standing = field(default_factory=Standing)
    standing: Standing = field(default_factory=Standing)
    limits: Mapping[str, int] = field(default_factory=dict)


def part_moves(graph: Graph, draft: Draft) -> tuple[PartMove, ...]:
    """How far each part after a break was moved."""
    before, after = graph.poses, draft.poses
    moves = []
    for part in graph.part_numbers[1:]:
        row = int(np.argmax(graph.parts == part))
        gap = _moved(before[row - 1 : row + 1], after[row - 1 : row + 1])
        ties = sum(_is_tie(graph, link, part) for link in draft.loops)
        moves.append(
            PartMove(
                first=int(graph.nodes[row]),
                moved_m=float(np.hypot(gap[0], gap[1])),
                turned_rad=abs(float(gap[2])),
                votes=ties,
            )
        )
    return tuple(moves)


def bends(graph: Graph, poses: FloatArray) -> tuple[Bend, ...]:
    """How far each stretch of the path was bent; stretches over a break are left out."""
    ends = np.array([0, *stops(graph.path, _STRETCH_M)], dtype=np.int64)
    i, j = ends[:-1], ends[1:]
    whole = graph.parts[i] == graph.parts[j]
    i, j = i[whole], j[whole]
    tracked = compose(invert(graph.poses[i]), graph.poses[j])
    error = misfit(poses, i, j, tracked)
    spread = path_error(graph, graph.poses)
    sigmas = np.sqrt(surprise(error, spread.between(i, j)))
    return tuple(
        Bend(
            source=int(graph.nodes[a]),
            target=int(graph.nodes[b]),
            moved_m=float(np.hypot(e[0], e[1])),
            turned_rad=abs(float(e[2])),
            sigmas=float(sigma),
        )
        for a, b, e, sigma in zip(i, j, error, sigmas, strict=True)
    )


def settled_verdicts(judged: Sequence[Judged], dropped: Sequence[Link]) -> tuple[Judged, ...]:
    """The verdicts after the layout was solved: those that did not fit are outliers."""
    out = {id(link) for link in dropped}
    return tuple(
        replace(one, believed=False, reason="outlier")
        if one.believed and id(one.link) in out
        else one
        for one in judged
    )


def _moved(before: FloatArray, after: FloatArray) -> FloatArray:
    """(3,) the second of two poses seen from the first, after against before."""
    was, now = (compose(invert(poses[0]), poses[1]) for poses in (before, after))
    return compose(invert(was), now)


def _is_tie(graph: Graph, link: Link, part: int) -> bool:
    ends = {int(graph.parts[graph.row[end]]) for end in (link.source, link.target)}
    return len(ends) == 2 and part in ends

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

# relaxed: closures and passes; passes: these alone, closures contradicted them; tracked: as it was
Choice = Literal["relaxed", "passes", "tracked"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PartMove:
    """A piece of the path from keyframe `first` on, after a break, against what bridged the break.

    `moved_m`: its first keyframe seen from the one before, layout against tracked. `votes` closures
    and passes tie it to other parts; without any it is where the guess put it.
    """

    first: int
    moved_m: float
    votes: int


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
    """What was judged, what moved, and how the passes stand to each other.

    `limits` counts by the name of a setting how often it cut the work short.
    """

    choice: Choice = "tracked"
    closures: tuple[Judged, ...] = ()
    parts: tuple[PartMove, ...] = ()
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
                votes=ties,
            )
        )
    return tuple(moves)


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

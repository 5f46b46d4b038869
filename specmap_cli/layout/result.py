"""The layout of all keyframes, and what it rests on: what an audit and a verdict need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.records import IntArray
from specmap_cli.layout.audit import Agreement
from specmap_cli.layout.path_graph import Draft, Ends, Graph, RowPair
from specmap_cli.layout.pose_graph import Link, graph_text
from specmap_cli.layout.trajectory import propagated

# Of a claim what the consistency found (see `consistency.py`), or:
# outlier: the solution misses it; walls: the layout with it was not taken.
Reason = Literal["impossible", "outvoted", "alone", "outlier", "walls"]
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
class Layout:
    """Relaxed poses (n, 3) of all keyframes, and the pose graph they come from.

    `nodes` are the keyframe numbers in the graph; `odometry`, `kept` and `dropped` its edges, the
    last two being closures and nearby passes. `why` says of the ends of those dropped what speaks
    against them. `loose` are the keyframes at which tracking restarted
    and whose place, and that of what follows, is a guess. `choice` is what the poses come from,
    `parts` how far pieces after a break were moved, `agreement` how the passes stand to each other.
    """

    poses: FloatArray
    nodes: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    odometry: tuple[Link, ...] = ()
    kept: tuple[Link, ...] = ()
    dropped: tuple[Link, ...] = ()
    why: Mapping[RowPair, Reason] = field(default_factory=dict)
    loose: tuple[int, ...] = ()
    choice: Choice = "tracked"
    parts: tuple[PartMove, ...] = ()
    agreement: Agreement = field(default_factory=Agreement)

    @classmethod
    def of(cls, graph: Graph, candidate: Candidate) -> Layout:
        """The layout of all keyframes from the settled draft of the nodes."""
        draft = candidate.draft
        older, newer = Ends.of(graph.row, draft.loops).parts(graph)
        moves = []
        for part in graph.part_numbers[1:]:
            row = int(np.argmax(graph.parts == part))
            was, now = (
                compose(invert(poses[row - 1]), poses[row]) for poses in (graph.poses, draft.poses)
            )
            gap = compose(invert(was), now)
            move = PartMove(
                first=int(graph.nodes[row]),
                moved_m=float(np.hypot(gap[0], gap[1])),
                votes=int(np.count_nonzero((older == part) != (newer == part))),
            )
            moves.append(move)
        return cls(
            poses=propagated(graph.tracked, graph.nodes, draft.poses),
            nodes=graph.nodes,
            odometry=graph.odometry,
            kept=draft.loops,
            dropped=candidate.dropped,
            loose=loose_starts(graph, draft.loops),
            choice=candidate.choice,
            parts=tuple(moves),
            agreement=candidate.agreement,
        )

    def g2o(self) -> str:
        """The pose graph in the format of g2o.

        Vertices carry keyframe numbers, dropped edges are left out.
        """
        nodes = self.nodes.tolist()
        poses = {number: self.poses[number] for number in nodes}
        return graph_text(poses, [*self.odometry, *self.kept], nodes[:1])


@dataclass(frozen=True, slots=True)
class Candidate:
    """A draft that is settled, the links it was settled without, and what it is made of.

    `agreement` is how its passes stand to each other.
    """

    choice: Choice
    draft: Draft
    dropped: tuple[Link, ...]
    agreement: Agreement


def loose_starts(graph: Graph, loops: Sequence[Link]) -> tuple[int, ...]:
    """First keyframes of the parts that no loop ties to the first part, nor over others."""
    ties = Ends.of(graph.row, loops).parts(graph)
    count = len(graph.part_numbers)
    tied = csr_array((np.ones(len(loops)), ties), shape=(count, count))
    _, piece = connected_components(tied, directed=False)
    apart = np.flatnonzero(piece != piece[0])
    return tuple(int(graph.nodes[np.argmax(graph.parts == part)]) for part in apart)

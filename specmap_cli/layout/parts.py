"""Parts: pieces of the path between breaks of the tracking, each rigid to begin with.

A part hangs on the one before by a guess. Links between parts, from closures or matches, say where
it really is. Before the pose graph is solved the part is moved there as a whole, since a robust
optimisation takes what is metres off for an outlier. Where no link says it, the walls of the part
are looked for among those of all older parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.core.records import IntArray
from specmap_cli.layout.path_graph import LOOP_EVERY_M, Draft, Ends, Graph
from specmap_cli.layout.place_search import WallMap
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.wall_matching import link_to_nearest
from specmap_cli.layout.walls import PLACE_NODES, Walls

# Two links agree when they put the part this near: as far as tracking bends a part of some metres.
_SAME_M, _SAME_RAD = 0.5, 0.15
PART_TRIES = 20  # searches to rejoin a piece of the path after tracking was lost
_PART_VOTES = 3  # finds that must agree on where the piece lies
_SPREAD_TRIES = 20  # so many are twice as far along the part as if they were made at every stop
_EVERY = 2  # nodes: from every other one nearly the same is seen


def place_parts(graph: Graph, closures: Sequence[Link], votes: int) -> Draft:
    """The layout as tracked, but each part where most closures with older parts put it.

    `votes` of them must agree: one may be of a place that looks alike.
    """
    draft = Draft(poses=graph.poses)
    for part in graph.part_numbers[1:]:
        draft = place_part(graph, draft, part, closures, votes=votes)
    return draft


def place_part(
    graph: Graph, draft: Draft, part: int, links: Sequence[Link], *, votes: int
) -> Draft:
    """The draft with `part` tied, where links to older parts put it, when `votes` of them agree.

    The guess that placed the part counts as one of them. The later parts, which hang on it, move
    with it.
    """
    ends = Ends.of(graph.row, links)
    older, newer = ends.parts(graph)
    across = (newer == part) & (older < part)
    claimed = compose(draft.poses[ends.i[across]], ends.z[across])
    motions = compose(claimed, invert(draft.poses[ends.j[across]]))  # of the map
    if not len(motions):
        return draft
    motions = np.concatenate([motions, np.zeros((1, 3))])
    motion, agreeing = most_voted(motions, draft.poses[graph.parts == part, :2].mean(axis=0))
    if agreeing < votes:
        return draft
    poses, later = np.array(draft.poses), graph.parts >= part
    poses[later] = compose(motion, poses[later])
    return replace(draft, poses=poses, tied=draft.tied | {part})


def most_voted(motions: FloatArray, centre: FloatArray) -> tuple[FloatArray, int]:
    """The motion that most others agree with, and how many do, itself included.

    `centre` (2,) is where the motions (L, 3) are compared: a turn far from the origin moves much.
    The first of equals is taken.
    """
    placed = compose(motions, np.array([centre[0], centre[1], 0.0]))
    apart = np.hypot(*(placed[:, None, :2] - placed[None, :, :2]).transpose(2, 0, 1))
    turned = np.abs(wrap_angles(placed[:, None, 2] - placed[None, :, 2]))
    votes = ((apart <= _SAME_M) & (turned <= _SAME_RAD)).sum(axis=1)
    best = int(votes.argmax())
    return motions[best], int(votes[best])


def loose_starts(graph: Graph, loops: Sequence[Link]) -> tuple[int, ...]:
    """First keyframes of the parts that no loop ties to the first part, nor over others."""
    ties = Ends.of(graph.row, loops).parts(graph)
    count = len(graph.part_numbers)
    tied = csr_array((np.ones(len(loops)), ties), shape=(count, count))
    _, piece = connected_components(tied, directed=False)
    apart = np.flatnonzero(piece != piece[0])
    return tuple(int(graph.nodes[np.argmax(graph.parts == part)]) for part in apart)


@dataclass(frozen=True, slots=True, kw_only=True)
class PartSearch:
    """A part that is being looked for: the walls to find it among, and the finds so far.

    The walls are those of all parts older than `part`, seen from `rows` (K,).
    """

    part: int
    rows: IntArray
    older: WallMap
    finds: tuple[Link, ...] = ()


def rejoin(
    node: int, graph: Graph, draft: Draft, walls: Walls, search: PartSearch | None
) -> tuple[Draft, PartSearch | None]:
    """One more try to find the part of row `node` by the walls around that node.

    No pose of the part is trusted, so that the fit must be good, and the part is moved only when
    `_PART_VOTES` finds agree where to; it is tied then. `search` holds the earlier finds. The more
    tries have failed, the farther the robot must have come for the next. A part is given up after
    `PART_TRIES`.
    """
    part = int(graph.parts[node])
    if search is not None and search.part != part:
        search = None
    tries = draft.tries.get(part, 0)
    way_m = float(graph.path[node] - graph.path[np.argmax(graph.parts == part)])
    due_m = LOOP_EVERY_M * tries * (1.0 + tries / _SPREAD_TRIES)
    if tries >= PART_TRIES or way_m < due_m:
        return draft, search
    draft = replace(draft, tries={**draft.tries, part: tries + 1})
    if search is None:
        rows = np.flatnonzero(graph.parts < part)
        some = rows[::_EVERY].tolist()
        seen = partial(walls.seen_of_all, some, draft.poses)
        older = WallMap.of(walls.of_all(some, draft.poses), seen, standing=True)
        search = PartSearch(part=part, rows=rows, older=older)
        draft = draft.counting("stray_cells", search.older.coarsened)
    fit = search.older.place_of(walls.around(node, PLACE_NODES, draft.poses))
    if fit is not None:
        find = link_to_nearest(graph, draft.poses, search.rows, node, fit)
        search = replace(search, finds=(*search.finds, find))
    known = (*draft.hints, *search.finds)
    return place_part(graph, draft, part, known, votes=_PART_VOTES), search

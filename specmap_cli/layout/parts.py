"""Parts: pieces of the path between breaks of the tracking, each rigid to begin with.

A part hangs on the one before by a guess. Links between parts, from closures or matches, say where
it really is. Before the pose graph is solved the part is moved there as a whole, since a robust
optimisation takes what is metres off for an outlier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.core.records import IntArray
from specmap_cli.layout.path_graph import Draft, Graph, lengths_matrix
from specmap_cli.layout.pose_graph import Link

# Two links agree when they put the part this near: as far as tracking bends a part of some metres.
_SAME_M, _SAME_RAD = 0.5, 0.15


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
    """The draft with `part` tied, where the links put it, when `votes` of them agree.

    The guess that placed the part counts as one of them. The later parts, which hang on it, move
    with it.
    """
    motions = corrections(graph, draft.poses, part, links)
    if len(motions):
        motions = np.concatenate([motions, np.zeros((1, 3))])
    best = agreed(motions, draft.poses[graph.parts == part, :2].mean(axis=0))
    if best is None or best[1] < votes:
        return draft
    poses = shifted(draft.poses, graph.parts, part, best[0])
    return replace(draft, poses=poses, tied=draft.tied | {part})


def corrections(graph: Graph, poses: FloatArray, part: int, links: Sequence[Link]) -> FloatArray:
    """Motions (L, 3) of the map that would satisfy each link between `part` and an older part.

    Each is to be composed from the left with the poses (M, 3) of the part.
    """
    found = []
    for link in links:
        i, j = graph.row[link.source], graph.row[link.target]
        z = np.array(link.source_from_target)
        if graph.parts[i] > graph.parts[j]:
            i, j, z = j, i, invert(z)
        if graph.parts[j] == part and graph.parts[i] < part:
            found.append(compose(compose(poses[i], z), invert(poses[j])))
    return np.array(found).reshape(-1, 3)


def agreed(motions: FloatArray, centre: FloatArray) -> tuple[FloatArray, int] | None:
    """The motion most others agree with, and how many do, itself included; None without any.

    `centre` (2,) is where the motions (L, 3) are compared: a turn far from the origin moves much.
    The first of equals is taken.
    """
    if not len(motions):
        return None
    placed = compose(motions, np.array([centre[0], centre[1], 0.0]))
    apart = np.hypot(*(placed[:, None, :2] - placed[None, :, :2]).transpose(2, 0, 1))
    turned = np.abs(wrap_angles(placed[:, None, 2] - placed[None, :, 2]))
    votes = ((apart <= _SAME_M) & (turned <= _SAME_RAD)).sum(axis=1)
    best = int(votes.argmax())
    return motions[best], int(votes[best])


def shifted(poses: FloatArray, parts: IntArray, part: int, motion: FloatArray) -> FloatArray:
    """Poses (M, 3) with `part` and the later ones moved as a whole by `motion` (3,) of the map."""
    result = np.array(poses)
    later = parts >= part
    result[later] = compose(motion, poses[later])
    return result


def loose_starts(graph: Graph, loops: Sequence[Link]) -> tuple[int, ...]:
    """First keyframes of the parts that no loop ties to the first part, nor over others."""
    ends = [
        (int(graph.parts[graph.row[link.source]]), int(graph.parts[graph.row[link.target]]))
        for link in loops
    ]
    count = len(graph.part_numbers)
    ties = lengths_matrix(count, ends, [1.0] * len(ends))
    _, piece = connected_components(ties, directed=False)
    apart = np.flatnonzero(piece != piece[0])
    return tuple(int(graph.nodes[np.argmax(graph.parts == part)]) for part in apart)

"""Nearby passes: places the robot came by again, found and matched along the path.

A candidate is a pair of nodes that the layout in the making puts near each other though the path
between them is long. The walls seen around the newer one are matched against those seen around the
older, within what the path may have drifted since the last such match.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.layout.agreement import Ends
from specmap_cli.layout.pass_matching import match_passes
from specmap_cli.layout.path_graph import LOOP_EVERY_M, LOOP_PATH_M, Draft, Graph, Pair
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.solving import renewed
from specmap_cli.layout.strays import Search, rejoin
from specmap_cli.layout.uncertainty import DRIFT_SHARE, misfit
from specmap_cli.layout.wall_matching import nearby_link
from specmap_cli.layout.walls import PLACE_NODES, Walls

LOOPS_PER_NODE = 2  # passes tried until one fits
LOOP_RADIUS_M = 3.0  # two passes nearer than this are matched
LOOP_SEARCH_M = 0.3  # a pass is searched this far at the least
LOOP_SEARCH_MAX_M = 2.0  # a pass is searched this far at the most
_SOLVE_EVERY = 12  # edges found before the layout is renewed
_NEWER_NODES = 3  # as PLACE_NODES, for the newer pass: its own drift must not blur it
METRES_A_RADIAN = 0.7  # of distance that are as bad as a turn, for the overlap of two scans
_NODES_A_LINK = 150  # a solution of more nodes costs more, and waits for more links
_NEWS = 1 / 3  # share of the least search by which a link must miss the draft to be news to it
_LEAST_SHARE = 1e-6  # of drift: keeps a path that does not drift from dividing by zero
_NEW_QUESTION_M = 1.0  # a guess that moved this far is worth another match


def find_passes(graph: Graph, draft: Draft, walls: Walls, first: int = 0) -> Draft:
    """The draft with the nearby passes that could be matched, solved again as they come in.

    Goes along the path, from row `first` on. Where a part hangs on the others by a guess only, it
    is looked for among all older walls first. Nodes that the draft was tried at are asked again,
    but matched only when they moved. Links that say what the draft says anyway are no reason to
    solve it.
    """
    tried, linked = dict(draft.tried), _linked(graph, draft.loops)
    asked = {newer for older, newer in tried if older != newer}
    start_m, news = float(graph.path[first]), 0
    due_m, tied_m = start_m + LOOP_EVERY_M, start_m
    renew_after = max(_SOLVE_EVERY, len(graph.nodes) // _NODES_A_LINK)
    search: Search | None = None
    for node, way_m in enumerate(graph.path.tolist()):
        if node < first or (way_m < due_m and node not in asked):
            continue
        part, due_m = int(graph.parts[node]), way_m + LOOP_EVERY_M
        if part in draft.tied:
            drift_m = LOOP_SEARCH_M + DRIFT_SHARE * (way_m - tied_m)
            passes = passes_at(node, graph, draft.poses, walls, tried, linked, drift_m)
            found, is_tied = passes.links, passes.is_tied
            tried.update(passes.guesses)
            draft = draft.counting("loop_search_max_m", passes.cut_short)
            if is_tied:
                due_m = way_m + _spacing_m(passes.older)
        else:
            draft, search = rejoin(node, graph, draft, walls, search)
            found = search.finds if search is not None and part in draft.tied else ()
            is_tied = bool(found)
        if is_tied:
            tied_m = way_m
        if found:
            draft = replace(draft, loops=(*draft.loops, *found))
            news += _news(graph, draft.poses, found)
        if news >= renew_after:
            draft, news = renewed(graph, draft), 0
    return replace(draft, tried=tried)


def _linked(graph: Graph, loops: Sequence[Link]) -> set[Pair]:
    """The rows, older and newer, that nearby passes tie."""
    return {
        (graph.row[link.source], graph.row[link.target]) for link in loops if link.kind == "nearby"
    }


def _spacing_m(older: int) -> float:
    """The way from a stop that is tied to the next one, where `older` passes came by.

    What n passes tell of a place errs by one over the root of n: the more of them, the less one
    match more can add. But never so far that the path drifts by half of the least search.
    """
    safe_m = 0.5 * LOOP_SEARCH_M / max(DRIFT_SHARE, _LEAST_SHARE)
    return max(LOOP_EVERY_M, min(math.sqrt(older) * LOOP_EVERY_M, safe_m))


def _news(graph: Graph, poses: FloatArray, links: Sequence[Link]) -> int:
    """How many links miss the poses (M, 3) by a good part of what the next match searches."""
    ends = Ends.of(graph, links)
    missed = misfit(poses, ends.i, ends.j, ends.z)
    return int(np.count_nonzero(np.hypot(*missed[:, :2].T) > _NEWS * LOOP_SEARCH_M))


@dataclass(frozen=True, slots=True, kw_only=True)
class Passes:
    """The links found at one node, and the pairs of rows that were matched from which `guesses`.

    `is_tied` says that the node is tied to an older pass, by these links or from before; `older`
    counts the passes that came by. `cut_short` counts the matches that were not searched as far as
    the path may have drifted.
    """

    links: tuple[Link, ...]
    guesses: Mapping[Pair, Pose2]
    is_tied: bool
    older: int
    cut_short: int


def passes_at(
    node: int,
    graph: Graph,
    poses: FloatArray,
    walls: Walls,
    tried: Mapping[Pair, Pose2],
    linked: Collection[Pair],
    drift_m: float,
) -> Passes:
    """Row `node` matched with older ones at the poses (M, 3), which may be wrong by `drift_m`.

    One after the other until it is tied to one: what the next would add is little. Pairs that were
    `tried` are matched again only from a guess that differs by a metre; some of them are `linked`.
    """
    reach_m = min(drift_m, LOOP_SEARCH_MAX_M)
    links: list[Link] = []
    guesses: dict[Pair, Pose2] = {}
    matched, is_tied = 0, False
    near = candidates(node, poses, graph.path)
    for old in near[:LOOPS_PER_NODE]:
        guess = Pose2(*compose(invert(poses[old]), poses[node]).tolist())
        guesses[old, node] = guess
        if _is_new(guess, tried.get((old, node))):
            matched += 1
            newer, older = (node, _NEWER_NODES), (old, PLACE_NODES)
            fit = match_passes(walls, poses, newer, older, guess, reach_m)
            if fit is not None:
                links.append(nearby_link(graph, old, node, fit))
        is_tied = bool(links) or (old, node) in linked
        if is_tied:
            break
    return Passes(
        links=tuple(links),
        guesses=guesses,
        is_tied=is_tied,
        older=len(near),
        cut_short=matched if drift_m > reach_m else 0,
    )


def candidates(node: int, poses: FloatArray, path: FloatArray) -> list[int]:
    """Older rows near row `node`, one a pass, the best to match with first.

    They lie far from it along the path, and from each other.
    """
    older = int(np.searchsorted(path, path[node] - LOOP_PATH_M))
    away = poses[:older, :2] - poses[node, :2]
    distance = np.sqrt((away**2).sum(axis=1))
    old = np.flatnonzero(distance < LOOP_RADIUS_M)
    turn = np.abs(wrap_angles(poses[old, 2] - poses[node, 2]))
    rank = distance[old] + METRES_A_RADIAN * turn
    chosen: list[int] = []
    for k in old[np.argsort(rank, kind="stable")].tolist():
        if all(abs(path[k] - path[c]) > LOOP_RADIUS_M for c in chosen):
            chosen.append(k)
    return chosen


def _is_new(guess: Pose2, before: Pose2 | None) -> bool:
    """Whether a pair was not matched yet, or from another place."""
    return before is None or (before.inverse() @ guess).distance > _NEW_QUESTION_M

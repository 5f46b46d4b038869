"""Nearby passes: places the robot came by again, found and matched along the path.

A candidate is a pair of nodes that the layout in the making puts near each other though the path
between them is long. The walls seen around the newer one are matched against those seen around the
older, within what the path may have drifted since the last such match.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.layout.path_graph import Draft, Graph, Pair
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.solving import renewed
from specmap_cli.layout.stops import stops
from specmap_cli.layout.strays import Search, rejoin
from specmap_cli.layout.wall_matching import match_walls, nearby_link
from specmap_cli.layout.walls import PLACE_NODES, Walls

_NEWER_NODES = 3  # as PLACE_NODES, for the newer pass: its own drift must not blur it
_METRES_A_RADIAN = 0.7  # of distance that are as bad as a turn, for the overlap of two scans
_NODES_A_LINK = 150  # a solution of more nodes costs more, and waits for more links
_NEW_QUESTION_M = 1.0  # a guess that moved this far is worth another match


def find_passes(graph: Graph, draft: Draft, walls: Walls, config: RelaxationConfig) -> Draft:
    """The draft with the nearby passes that could be matched, solved again as they come in.

    Goes along the path. Where a part hangs on the others by a guess only, it is looked for among
    all older walls first. Pairs that the draft was tried on are matched again only when they moved.
    """
    tried, tied_m, solved = dict(draft.tried), 0.0, len(draft.loops)
    renew_after = max(config.solve_every, len(graph.nodes) // _NODES_A_LINK)
    search: Search | None = None
    for node in stops(graph.path, config.loop_every_m):
        part, way_m = int(graph.parts[node]), float(graph.path[node])
        if part in draft.tied:
            drift_m = config.loop_search_m + config.drift_share * (way_m - tied_m)
            passes = passes_at(node, graph, draft.poses, walls, tried, drift_m, config)
            found = passes.links
            tried.update(passes.guesses)
            draft = draft.counting("loop_search_max_m", passes.cut_short)
        else:
            draft, search = rejoin(node, graph, draft, walls, search, config)
            found = search.finds if search is not None and part in draft.tied else ()
        if found:
            draft, tied_m = replace(draft, loops=(*draft.loops, *found)), way_m
        if len(draft.loops) - solved >= renew_after:
            draft, solved = renewed(graph, draft, config), len(draft.loops)
    return replace(draft, tried=tried)


@dataclass(frozen=True, slots=True, kw_only=True)
class Passes:
    """The links found at one node, and the pairs of rows that were matched from which `guesses`.

    `cut_short` counts those that were not searched as far as the path may have drifted.
    """

    links: tuple[Link, ...]
    guesses: Mapping[Pair, Pose2]
    cut_short: int


def passes_at(
    node: int,
    graph: Graph,
    poses: FloatArray,
    walls: Walls,
    tried: Mapping[Pair, Pose2],
    drift_m: float,
    config: RelaxationConfig,
) -> Passes:
    """Row `node` matched with older ones at the poses (M, 3), which may be wrong by `drift_m`.

    Pairs that were `tried` are matched again only from a guess that differs by a metre.
    """
    reach_m = min(drift_m, config.loop_search_max_m)
    links: list[Link] = []
    guesses: dict[Pair, Pose2] = {}
    matched = 0
    for old in candidates(node, poses, graph.path, config):
        guess = Pose2(*compose(invert(poses[old]), poses[node]).tolist())
        guesses[old, node] = guess
        if not _is_new(guess, tried.get((old, node))):
            continue
        matched += 1
        source = walls.around(node, _NEWER_NODES, poses)
        target = walls.around(old, PLACE_NODES, poses)
        fit = match_walls(source, target, guess, reach_m, config)
        if fit is not None:
            links.append(nearby_link(graph, old, node, fit))
    return Passes(
        links=tuple(links), guesses=guesses, cut_short=matched if drift_m > reach_m else 0
    )


def candidates(
    node: int, poses: FloatArray, path: FloatArray, config: RelaxationConfig
) -> list[int]:
    """Older rows to match row `node` with: near it, far along the path, apart from each other."""
    old = np.flatnonzero(path < path[node] - config.loop_path_m)
    away = poses[old, :2] - poses[node, :2]
    distance = np.sqrt((away**2).sum(axis=1))
    turn = np.abs(wrap_angles(poses[old, 2] - poses[node, 2]))
    near = distance < config.loop_radius_m
    old, rank = old[near], (distance + _METRES_A_RADIAN * turn)[near]
    chosen: list[int] = []
    for k in old[np.argsort(rank, kind="stable")].tolist():
        if len(chosen) == config.loops_per_node:
            break
        if all(abs(path[k] - path[c]) > config.loop_radius_m for c in chosen):
            chosen.append(k)
    return chosen


def _is_new(guess: Pose2, before: Pose2 | None) -> bool:
    """Whether a pair was not matched yet, or from another place."""
    return before is None or (before.inverse() @ guess).distance > _NEW_QUESTION_M

"""Passes far from where the layout has them: searched as far as the path's error reaches.

Where no pass has tied the path for long, a place may lie metres away from where it was seen before,
along a bare corridor more than across. Its walls are looked for within that error. What is found
is a claim as a closure is: walls that look alike are found, too, and several claims must agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import IntArray
from specmap_cli.layout.nearby_passes import LOOP_RADIUS_M, LOOP_SEARCH_MAX_M, LOOPS_PER_NODE
from specmap_cli.layout.path_graph import LOOP_PATH_M, Draft, Graph, Pair
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.stops import stops
from specmap_cli.layout.strays import Guess, OlderWalls
from specmap_cli.layout.uncertainty import Uncertainty, within_ellipse
from specmap_cli.layout.wall_matching import WallFit, nearby_link
from specmap_cli.layout.walls import PLACE_NODES, Walls

_WIDE_EVERY_M = 10.0  # path between searches as far as its error reaches
_WIDE_SEARCH_MAX_M = 15.0  # such a search reaches this far at the most
_REACH_SIGMAS = 3.0  # of the path's error that are searched
_MOST_ROWS = 80  # whose walls make one search: some 25 m of path, or every other of more
_NEW_QUESTION_M = 1.0  # a guess that moved this far is worth another search
_WHOLE_MAP = -1  # the walls of a search here are not those of all parts older than one


@dataclass(frozen=True, slots=True)
class WideClaims:
    """Links found, and for each row that was searched, as a pair with itself, from where."""

    links: tuple[Link, ...]
    guesses: Mapping[Pair, Pose2]


def wide_claims(graph: Graph, draft: Draft, walls: Walls, spread: Uncertainty) -> WideClaims:
    """What is found along the path, every `_WIDE_EVERY_M`, where no pass ties it well enough."""
    if not LOOPS_PER_NODE:
        return WideClaims((), {})
    ties = _ties(graph, draft)
    links: list[Link] = []
    guesses: dict[Pair, Pose2] = {}
    for row in stops(graph.path, _WIDE_EVERY_M):
        pose, part = Pose2(*draft.poses[row].tolist()), int(graph.parts[row])
        before = draft.tried.get((row, row))
        if part not in draft.tied or not _is_new(pose, before):
            continue
        error = _error(row, ties, graph, spread)
        old = _within(row, error, graph, draft.poses)
        if error is None or not len(old):
            continue
        guesses[row, row] = pose
        fit = _found(row, old, Guess(pose, error), draft.poses, walls)
        if fit is not None:
            links.append(_claim(graph, draft.poses, row, old, fit))
    return WideClaims(tuple(links), guesses)


def _ties(graph: Graph, draft: Draft) -> IntArray:
    """Rows that a link ties to an older one, ascending; the first row of all is tied."""
    newer = [max(graph.row[link.source], graph.row[link.target]) for link in draft.loops]
    return np.unique(np.array([0, *newer], dtype=np.int64))


def _error(row: int, ties: IntArray, graph: Graph, spread: Uncertainty) -> FloatArray | None:
    """Covariance (3, 3) of a row seen from the last tie before it, in the map; None if small."""
    last = int(ties[np.searchsorted(ties, row, side="right") - 1])
    if graph.parts[last] != graph.parts[row]:
        return None
    error = spread.between(np.array([last]), np.array([row]))[0]
    turn = Pose2(*spread.poses[row].tolist()).rotation()
    place = np.einsum("ab,bc,dc->ad", turn, error[:2, :2], turn)
    half = 0.5 * (place[0, 0] - place[1, 1])
    larger = 0.5 * (place[0, 0] + place[1, 1]) + np.sqrt(half**2 + place[0, 1] ** 2)
    longest = float(np.sqrt(larger))  # the axis of the ellipse
    if _REACH_SIGMAS * longest <= LOOP_SEARCH_MAX_M:
        return None
    scale = min(1.0, _WIDE_SEARCH_MAX_M / (_REACH_SIGMAS * longest))
    error[:2, :2] = place * scale**2
    return np.asarray(error, dtype=np.float64)


def _within(
    row: int,
    error: FloatArray | None,
    graph: Graph,
    poses: FloatArray,
) -> IntArray:
    """Older rows that the path's error lets be near a row, thinned."""
    if error is None:
        return np.zeros(0, dtype=np.int64)
    old = np.flatnonzero(graph.path < graph.path[row] - LOOP_PATH_M)
    reach = _REACH_SIGMAS**2 * error[:2, :2] + LOOP_RADIUS_M**2 * np.eye(2)
    away = poses[old, :2] - poses[row, :2]
    old = old[within_ellipse(away, reach)]
    return np.asarray(old[:: max(1, -(-len(old) // _MOST_ROWS))], dtype=np.int64)


def _found(
    row: int,
    old: IntArray,
    guess: Guess,
    poses: FloatArray,
    walls: Walls,
) -> WallFit | None:
    """The pose in the map of the walls around a row, among those of older rows."""
    older = OlderWalls.of(_WHOLE_MAP, walls.of_all(old.tolist(), poses))
    return older.place_of(walls.around(row, PLACE_NODES, poses), guess)


def _claim(graph: Graph, poses: FloatArray, row: int, old: IntArray, fit: WallFit) -> Link:
    """The link from the nearest older row to where the walls of a row were found."""
    pose = fit.target_from_source
    away = np.hypot(poses[old, 0] - pose.x, poses[old, 1] - pose.y)
    nearest = int(old[np.argmin(away)])
    relative = Pose2(*compose(invert(poses[nearest]), np.array(pose)).tolist())
    return nearby_link(graph, nearest, row, WallFit(relative, fit.information))


def _is_new(guess: Pose2, before: Pose2 | None) -> bool:
    return before is None or (before.inverse() @ guess).distance > _NEW_QUESTION_M

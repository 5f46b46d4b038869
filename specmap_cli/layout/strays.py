"""Parts whose place nobody knows: their walls are looked for among those of all older parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.matching import Match, ScoreField, Window, search, search_everywhere, thinned
from specmap_cli.layout.parts import place_part
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.wall_matching import (
    COARSE_POINTS_M,
    FINE_POINTS_M,
    WallFit,
    confirmed,
    field_of,
    nearby_link,
)
from specmap_cli.layout.walls import PLACE_NODES, Walls

_CELL_M, _BLUR_M = 0.1, 0.1  # of the field of the whole map
_SIDE = 40.0  # of that field, in ranges of the laser
_STEP_M, _TURN_RAD, _MOST_TURN_RAD = 0.3, 0.04, 0.08  # of the search in a map that is not too large
_RIVALS, _LEAD = 4, 0.05  # places compared, and the score by which the best must lead
_NEAR_STEPS, _NEAR_RAD, _NEAR_M = 0.75, 0.06, 0.1  # the search about each: its width and its step
_PINNED_M = 0.1  # largest mean deviation of a place found: more is a corridor's open direction
_NEAR_RANGES = 2.0  # walls this many ranges around a place are those seen from it


@dataclass(frozen=True, slots=True, kw_only=True)
class OlderWalls:
    """The walls (N, 2) of all parts older than `part`, and their score field.

    Places are searched `step_m` apart; `coarsened` says that the map is so large that this is more
    than usual.
    """

    part: int
    points: FloatArray
    field: ScoreField
    step_m: float
    coarsened: bool

    @classmethod
    def of(cls, part: int, points: FloatArray, config: RelaxationConfig) -> OlderWalls:
        """The walls with their field."""
        field = ScoreField.from_points(points, _CELL_M, _BLUR_M, _SIDE * config.match_range_m)
        side_m = float(np.sqrt(field.values.size * field.resolution**2))
        needed_m = side_m / config.stray_cells
        return cls(
            part=part,
            points=points,
            field=field,
            step_m=max(_STEP_M, needed_m),
            coarsened=needed_m > _STEP_M,
        )

    def place_of(self, source: FloatArray, config: RelaxationConfig) -> WallFit | None:
        """The pose of points (N, 2) in the map.

        They must fit well, nowhere else nearly as well, and leave no direction open: in a bare
        corridor nothing is found.
        """
        best = self._best(source, config)
        if best is None:
            return None
        away = self.points - (best.pose.x, best.pose.y)
        near = np.hypot(away[:, 0], away[:, 1]) < _NEAR_RANGES * config.match_range_m
        score = 0.5 + 0.5 * config.loop_score  # halfway to a perfect fit
        field = field_of(self.points[near], config)
        found = confirmed(field, source, best.pose, score, config)
        if found is None or _variance(found.information) > 2 * _PINNED_M**2:
            return None
        return found

    def _best(self, source: FloatArray, config: RelaxationConfig) -> Match | None:
        """The place that fits best, if it leads clearly."""
        few = thinned(source, FINE_POINTS_M)
        if len(few) < config.match_points:
            return None
        turn = min(_TURN_RAD * self.step_m / _STEP_M, _MOST_TURN_RAD)
        sparse = thinned(source, COARSE_POINTS_M)
        rough = search_everywhere(self.field, sparse, _RIVALS, self.step_m, turn)
        width = _NEAR_STEPS * self.step_m
        window = Window(distance_m=width, angle_rad=_NEAR_RAD, step_m=_NEAR_M)
        fine = [search(self.field, few, match.pose, window) for match in rough]
        fine.sort(key=lambda match: -match.score)
        if not fine or (len(fine) > 1 and fine[1].score > fine[0].score - _LEAD):
            return None
        return fine[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """A part that is being looked for: the walls to find it among, and the finds so far."""

    older: OlderWalls
    finds: tuple[Link, ...] = ()


def rejoin(
    node: int,
    graph: Graph,
    draft: Draft,
    walls: Walls,
    search: Search | None,
    config: RelaxationConfig,
) -> tuple[Draft, Search | None]:
    """One more try to find the part of row `node` by the walls around that node.

    No pose of the part is trusted, so that the fit must be good, and the part is moved only when
    `stray_votes` finds agree where to; it is tied then. `search` holds the earlier finds. A part is
    given up after `stray_tries`.
    """
    part = int(graph.parts[node])
    if search is None or search.older.part != part:
        search = None
    tries = draft.tries.get(part, 0)
    if tries < config.stray_tries:
        draft = replace(draft, tries={**draft.tries, part: tries + 1})
        if search is None:
            search = Search(older=_older_walls(part, graph, draft.poses, walls, config))
            draft = draft.counting("stray_cells", search.older.coarsened)
        find = _find(node, graph, draft.poses, walls, search.older, config)
        search = replace(search, finds=(*search.finds, *find))
        draft = place_part(graph, draft, part, search.finds, votes=config.stray_votes)
    return draft, search


def _older_walls(
    part: int, graph: Graph, poses: FloatArray, walls: Walls, config: RelaxationConfig
) -> OlderWalls:
    rows = np.flatnonzero(graph.parts < part).tolist()
    return OlderWalls.of(part, walls.of_all(rows, poses), config)


def _find(
    node: int,
    graph: Graph,
    poses: FloatArray,
    walls: Walls,
    older: OlderWalls,
    config: RelaxationConfig,
) -> tuple[Link, ...]:
    """The link from the nearest older node to `node`, where its walls were found; or none."""
    fit = older.place_of(walls.around(node, PLACE_NODES, poses), config)
    if fit is None:
        return ()
    pose, rows = fit.target_from_source, np.flatnonzero(graph.parts < older.part)
    away = np.hypot(poses[rows, 0] - pose.x, poses[rows, 1] - pose.y)
    nearest = int(rows[np.argmin(away)])
    relative = Pose2(*compose(invert(poses[nearest]), np.array(pose)).tolist())
    return (nearby_link(graph, nearest, node, replace(fit, target_from_source=relative)),)


def _variance(information: FloatArray) -> float:
    """Of the place, both directions together, from an information matrix (3, 3)."""
    return float(np.linalg.inv(information)[:2, :2].trace())

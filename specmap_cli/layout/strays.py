"""Parts whose place nobody knows: their walls are looked for among those of all older parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, compose, inverse3, invert
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.matching import Match, Window, search
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.parts import place_part
from specmap_cli.layout.path_graph import LOOP_EVERY_M, Draft, Graph
from specmap_cli.layout.place_search import Pyramid, Wanted, best_places
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.standable import seen_free
from specmap_cli.layout.uncertainty import within_ellipse
from specmap_cli.layout.wall_matching import (
    FINE_POINTS_M,
    LOOP_SCORE,
    MATCH_POINTS,
    WallFit,
    confirmed,
    field_of,
    nearby_link,
    sure_score,
)
from specmap_cli.layout.walls import PLACE_NODES, Walls

STRAY_TRIES = 20  # searches to rejoin a piece of the path after tracking was lost
_STRAY_VOTES = 3  # finds that must agree on where the piece lies
_STRAY_CELLS = 512  # cells a side in such a search: a larger map is searched coarser
_SEARCH_BLOCKS = 400_000  # places followed at once in that search, at the most
_CELL_M, _BLUR_M = 0.1, 0.1  # of the field of the whole map
_SIDE = 40.0  # of that field, in ranges of the laser
_STEP_M, _TURN_RAD, _MOST_TURN_RAD = 0.3, 0.04, 0.08  # of the search in a map that is not too large
_RIVALS, _LEAD = 4, 0.05  # places compared, and the score by which the best must lead
_NEAR_STEPS, _NEAR_RAD, _NEAR_M = 0.75, 0.06, 0.1  # the search about each: its width and its step
_PINNED_M = 0.1  # largest mean deviation of a place found: more is a corridor's open direction
_BLOCK_M = 2.4  # side of the blocks that search begins with
_GUESS_SIGMAS = 3.0  # of a guess that are searched
_SPARSE_M = 0.4  # between the points of that search: some 100 of them tell a place
_REACH_RANGES = 1.5  # from a node to the farthest wall seen from the nodes around it
_SPREAD_TRIES = 20  # so many are twice as far along the part as if they were made at every stop
_EVERY = 2  # nodes: from every other one nearly the same is seen
_NEAR_RANGES = 2.0  # walls this many ranges around a place are those seen from it


@dataclass(frozen=True, slots=True)
class Guess:
    """Where points may be: about `pose`, with an error of this covariance (3, 3) in the map."""

    pose: Pose2
    covariance: FloatArray

    def angles(self, step_rad: float) -> FloatArray:
        """(A,) headings within three sigmas, from the guess outwards on either side."""
        reach = min(np.pi, _GUESS_SIGMAS * float(np.sqrt(self.covariance[2, 2])))
        count = int(np.ceil(reach / step_rad))
        steps = step_rad * np.arange(-count, count + 1)
        return np.asarray(self.pose.theta + steps, dtype=np.float64)

    def reaches(self, places: FloatArray, middle: FloatArray) -> NDArray[np.bool_]:
        """(B,) whether `middle` (2,), a point of the source, may lie at these places (B, 2)."""
        away = places - self.pose.apply(middle[None])
        spread = _GUESS_SIGMAS**2 * self.covariance[:2, :2] + _BLOCK_M**2 * np.eye(2)
        return within_ellipse(away, spread)


@dataclass(frozen=True, slots=True, kw_only=True)
class OlderWalls:
    """The walls (N, 2) of all parts older than `part`, and their score field.

    Places are searched `step_m` apart; `coarsened` says that the map is so large that this is more
    than usual.
    """

    part: int
    points: FloatArray
    field: ScoreField
    pyramid: Pyramid
    step_m: float
    coarsened: bool

    @classmethod
    def of(
        cls,
        part: int,
        points: FloatArray,
        seen: Callable[[ScoreField], BoolArray] | None = None,
    ) -> OlderWalls:
        """The walls with their field; `seen` says in which of its cells a robot may stand."""
        field = ScoreField.from_points(points, _CELL_M, _BLUR_M, _SIDE * MATCH_RANGE_M)
        side_m = float(np.sqrt(field.values.size * field.resolution**2))
        needed_m = side_m / _STRAY_CELLS
        step_m = max(_STEP_M, needed_m)
        coarse = field.coarser(max(1, round(step_m / field.resolution)))
        reach_m = _REACH_RANGES * MATCH_RANGE_M
        return cls(
            part=part,
            points=points,
            field=field,
            pyramid=Pyramid.of(coarse, reach_m, None if seen is None else seen(coarse)),
            step_m=step_m,
            coarsened=needed_m > _STEP_M,
        )

    def place_of(self, source: FloatArray, guess: Guess | None = None) -> WallFit | None:
        """The pose of points (N, 2) in the map: anywhere, or as far as a guess may be off.

        They must fit well, nowhere else nearly as well, and leave no direction open: in a bare
        corridor nothing is found.
        """
        best = self._best(source, guess)
        if best is None:
            return None
        away = self.points - (best.pose.x, best.pose.y)
        near = np.hypot(away[:, 0], away[:, 1]) < _NEAR_RANGES * MATCH_RANGE_M
        field = field_of(self.points[near])
        found = confirmed(field, source, best.pose, sure_score())
        if found is None or _variance(found.information) > 2 * _PINNED_M**2:
            return None
        return found

    def _best(self, source: FloatArray, guess: Guess | None) -> Match | None:
        """The place that fits best, if it leads clearly."""
        few = thinned(source, FINE_POINTS_M)
        if len(few) < MATCH_POINTS:
            return None
        turn = min(_TURN_RAD * self.step_m / _STEP_M, _MOST_TURN_RAD)
        sparse = thinned(source, _SPARSE_M)
        angles, blocks = np.arange(0.0, 2 * np.pi, turn), self.pyramid.blocks()
        if guess is not None and len(sparse):
            angles = guess.angles(turn)
            blocks = blocks[guess.reaches(self.pyramid.centres_of(blocks), sparse.mean(axis=0))]
        rough, _ = best_places(self.pyramid, sparse, blocks, angles, _wanted(), _RIVALS)
        width = _NEAR_STEPS * self.step_m
        window = Window(distance_m=width, angle_rad=_NEAR_RAD, step_m=_NEAR_M)
        fine = [search(self.field, few, match.pose, window) for match in rough]
        fine.sort(key=lambda match: -match.score)
        if not fine or (len(fine) > 1 and fine[1].score > fine[0].score - _LEAD):
            return None
        return fine[0]


def _wanted() -> Wanted:
    """Places whose pooled score, an upper bound, may still become that of a match."""
    return Wanted(least=LOOP_SCORE, lead=2 * _LEAD, most=_SEARCH_BLOCKS)


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
) -> tuple[Draft, Search | None]:
    """One more try to find the part of row `node` by the walls around that node.

    No pose of the part is trusted, so that the fit must be good, and the part is moved only when
    `_STRAY_VOTES` finds agree where to; it is tied then. `search` holds the earlier finds. The more
    tries have failed, the farther the robot must have come for the next. A part is given up after
    `STRAY_TRIES`.
    """
    part = int(graph.parts[node])
    if search is None or search.older.part != part:
        search = None
    tries = draft.tries.get(part, 0)
    way_m = float(graph.path[node] - graph.path[np.argmax(graph.parts == part)])
    due_m = LOOP_EVERY_M * tries * (1.0 + tries / _SPREAD_TRIES)
    if tries < STRAY_TRIES and way_m >= due_m:
        draft = replace(draft, tries={**draft.tries, part: tries + 1})
        if search is None:
            search = Search(older=_older_walls(part, graph, draft.poses, walls))
            draft = draft.counting("stray_cells", search.older.coarsened)
        find = _find(node, graph, draft.poses, walls, search.older)
        search = replace(search, finds=(*search.finds, *find))
        known = (*draft.hints, *search.finds)
        draft = place_part(graph, draft, part, known, votes=_STRAY_VOTES)
    return draft, search


def _older_walls(part: int, graph: Graph, poses: FloatArray, walls: Walls) -> OlderWalls:
    rows = np.flatnonzero(graph.parts < part)[::_EVERY].tolist()
    seen = partial(seen_free, walls, rows, poses)
    return OlderWalls.of(part, walls.of_all(rows, poses), seen)


def _find(
    node: int,
    graph: Graph,
    poses: FloatArray,
    walls: Walls,
    older: OlderWalls,
) -> tuple[Link, ...]:
    """The link from the nearest older node to `node`, where its walls were found; or none."""
    fit = older.place_of(walls.around(node, PLACE_NODES, poses))
    if fit is None:
        return ()
    pose, rows = fit.target_from_source, np.flatnonzero(graph.parts < older.part)
    away = np.hypot(poses[rows, 0] - pose.x, poses[rows, 1] - pose.y)
    nearest = int(rows[np.argmin(away)])
    relative = Pose2(*compose(invert(poses[nearest]), np.array(pose)).tolist())
    return (nearby_link(graph, nearest, node, replace(fit, target_from_source=relative)),)


def _variance(information: FloatArray) -> float:
    """Of the place, both directions together, from an information matrix (3, 3)."""
    return float(inverse3(information)[:2, :2].trace())

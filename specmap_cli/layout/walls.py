"""The walls that the robot saw around nodes of the graph, and walls matched with walls.

Two rooms see the wall between them from either side. Matched with each other the two sides would
lie on one another: the rooms would come nearer by the thickness of the wall, and nearly all of it
would fit. So the sides of walls count, and the space before them.

A view is measured by what of it could have been seen: a point on a wall of the other pass speaks
for a match, one in space that the other pass saw empty speaks against it, and one where the other
pass never looked says nothing. So the view that overlaps by a third counts for a third.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np

from specmap_cli.core.geometry import (
    FloatArray,
    Pose2,
    apply_each,
    compose,
    inverse3,
    invert,
    product,
)
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import SPREAD_M, Prior, Window, answers, covariance, refine, search
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.path_graph import MATCH_RANGE_M, Graph, RowPair
from specmap_cli.layout.pose_graph import Link

PLACE_NODES = 8  # nodes on either side whose walls make one place: some 2 m of path
CELL_M = 0.05  # points are thinned to one in a cell of the fields they are matched on
_REMEMBERED = 256  # nodes whose points stay in memory: some 5 MB
_GATHERED = 10_000  # points that are thinned together: 160 kB

_NEIGHBOURS = 2  # points on either side, from which the direction of a surface is had
_SURFACE_M = 0.5  # such neighbours farther from each other lie on two surfaces
_DISTINCT_M = 1e-6  # nearer ones have no direction
_THICK_M = 0.3  # walls between rooms are no thicker
_CELL_M = 0.1  # of the grid in which sides are added up
_OTHER_SIDE = -0.5  # mean cosine of two facings: above it may be a wall around the corner
_UNIT = 64.0  # normals are whole numbers of its parts: their sums come out the same in any order

_FEWEST = 3  # corners of an area

MATCH_POINTS = 20  # walls with fewer points are not matched
# Share of the points that could have been seen that lie on walls by chance, or where people and
# furniture were moved: a point on a wall speaks for a match by the rest, another against it by
# this. What speaks for it, a point of the whole view: a tenth makes an edge, half of a perfect fit
# is sure. Of two passes through real rooms three quarters and more of what both could see fits.
LOOP_SCORE = 0.6
LEAST_EVIDENCE, SURE = 0.1, 0.5 * (1.0 - LOOP_SCORE)
_SEEN_M = 0.15  # beyond the first wall seen, that counts as seen: the noise of readings and poses

# Searches go from coarse to fine, their points thinned to about the step: four cells first, over
# all that the path may have drifted, then two cells, then none.
_BLUR_M = 0.1  # sigma of the field: a wall is found from twice as far
_COARSE_CELLS, _COARSE_M, _COARSE_POINTS_M = 4, 0.2, 0.25
_FINE, FINE_POINTS_M = Window(distance_m=0.3, angle_rad=0.09, step_m=0.1), 0.2
_REFINED_POINTS_M, _REFINED_STEPS = 0.1, 8
# The heading drifts by some degrees a metre, and is searched no farther than a scan still overlaps.
_TURN_PER_M, _LEAST_TURN_RAD, _MOST_TURN_RAD = 0.15, 0.06, 0.35
# Of places that fit alike the nearer wins: a metre off costs as much as 1 % of the points.
_PENALTY_PER_M2, _PENALTY_PER_RAD2 = 0.01, 0.05
_APART_M = 0.5  # what looks alike in a building, doors or cupboards, stands farther apart
_SIDE = 4.0  # of the field of a place, in ranges: stray points beyond it cost no memory
_WINDOW_M2 = SPREAD_M**2 / 3  # variance of a window that fits all over
_OPEN_M2 = 2.0**2  # of a place along a corridor that shows nothing: the wall is still that wall
# Error of the best match: a cell's side over the root of 12, and what people and furniture moved.
_FLOOR = np.diag([0.015**2, 0.015**2, 0.004**2])

# Farther than a pass may drift: on cells of this size, and steps.
_WIDE_CELL_M, _WIDE_STEP_M, _WIDE_STEP_RAD = 0.1, 0.3, 0.04
_WIDE_SIDE = 40.0  # of that field, in ranges
_SPARSE_M = 0.4  # between the points of that search: some 100 of them tell a place
_AROUND = Window(distance_m=0.225, angle_rad=0.06, step_m=0.1)  # searched about each answer
_LEAD = 0.05  # by which the best answer must lead
_PINNED_M = 0.1  # largest mean deviation of a place found: more is a corridor's open direction
_NEAR_RANGES = 2.0  # walls this many ranges around a place are those seen from it

_FEW = 0.05  # share of points that cannot move a match by much


class Walls:
    """Wall points around the nodes of a graph, read from the store as needed; some are kept."""

    def __init__(self, store: KeyframeStore, graph: Graph, before: Walls | None = None) -> None:
        """`before` are those of another graph of the store: what they keep in memory stays."""
        self._store, self._graph = store, graph
        after = [motion.kind != "odometry" for motion in graph.odometry]
        self._pieces = np.cumsum([False, *after])  # between all breaks, bridged or not
        self._sides: Callable[[int], Sides] = lru_cache(_REMEMBERED)(self._read)
        if before is not None:
            self._sides = before._sides

    def sides(self, node: int) -> Sides:
        """The points of one node in its base frame, with the sides that its laser saw."""
        return self._sides(int(self._graph.nodes[node]))

    def around(self, node: int, reach: int, poses: FloatArray) -> Sides:
        """What is seen from nodes within `reach` of row `node`, in the frame of `node`.

        `poses` (M, 3) place the nodes. Only nodes between the same breaks are used.
        """
        near, places = self._near(node, reach, poses)
        sides = [self.sides(k) for k in near]
        turns = places * (0.0, 0.0, 1.0)
        return Sides(
            apply_each(places, [one.points for one in sides]),
            apply_each(turns, [one.normals for one in sides]),
        )

    def seen_around(
        self, node: int, reach: int, poses: FloatArray, field: ScoreField, margin_m: float
    ) -> BoolArray:
        """(H, W) which cells of a field in the frame of row `node` were seen from these nodes."""
        near, places = self._near(node, reach, poses)
        return seen_from((self.sides(k).points for k in near), places, field, margin_m)

    def seen_of_all(
        self, nodes: Sequence[int], poses: FloatArray, field: ScoreField, margin_m: float
    ) -> BoolArray:
        """(H, W) which cells of a field in the map were seen from rows `nodes`."""
        return seen_from((self.sides(k).points for k in nodes), poses[nodes], field, margin_m)

    def _near(self, node: int, reach: int, poses: FloatArray) -> tuple[list[int], FloatArray]:
        """The rows around a row, and where they are in its frame, (n, 3)."""
        pieces = self._pieces
        low, high = max(0, node - reach), min(len(pieces), node + reach + 1)
        others = [k for k in range(low, high) if pieces[k] == pieces[node]]
        return others, compose(invert(poses[node]), poses[others])

    def of_all(self, nodes: Sequence[int], poses: FloatArray) -> FloatArray:
        """Points (N, 2) seen from all rows `nodes`, in the map, thinned as they are gathered."""
        clouds: list[FloatArray] = [np.zeros((0, 2))]
        count, most = 0, _GATHERED
        for k in nodes:
            clouds.append(Pose2(*poses[k].tolist()).apply(self.sides(k).points))
            count += len(clouds[-1])
            if count > most:  # twice what was left the last time: each point is thinned a few times
                clouds = [thinned(np.concatenate(clouds), CELL_M)]
                count = len(clouds[0])
                most = max(_GATHERED, 2 * count)
        return thinned(np.concatenate(clouds), CELL_M)

    def _read(self, number: int) -> Sides:
        """The points of a keyframe with the sides that its laser saw."""
        points = thinned(self._store.points(number, MATCH_RANGE_M), CELL_M)
        laser = self._store.base_from_laser(number)
        return Sides.of(points, (laser.x, laser.y))


@dataclass(frozen=True, slots=True)
class Sides:
    """Wall points (N, 2) and the unit normals (N, 2) of their surfaces, to where they are seen.

    A normal is nought where no surface is known: a post, the end of a wall.
    """

    points: FloatArray
    normals: FloatArray

    @classmethod
    def of(cls, points: FloatArray, viewer: tuple[float, float]) -> Sides:
        """The sides of points (N, 2), in order of bearing, that are seen from one place."""
        normals, reach = np.zeros((len(points), 2)), _NEIGHBOURS
        along = points[2 * reach :] - points[: -2 * reach]
        length = np.hypot(along[:, 0], along[:, 1])
        known = (length > _DISTINCT_M) & (length < _SURFACE_M)
        rows = np.flatnonzero(known) + reach
        across = np.column_stack([-along[:, 1], along[:, 0]])[known] / length[known, None]
        to_viewer = viewer - points[rows]
        outwards = (across * to_viewer).sum(axis=1) < 0.0
        normals[rows] = np.where(outwards[:, None], -across, across)
        return cls(points, normals)

    def placed(self, pose: Pose2) -> Sides:
        """The same in the frame in which theirs lies at a pose."""
        turn = Pose2(0.0, 0.0, pose.theta)
        return Sides(pose.apply(self.points), turn.apply(self.normals))


def from_behind(source: Sides, target: Sides, guess: Pose2, drift_m: float) -> BoolArray:
    """(N,) whether the target shows the wall under a point of the source from its other side only.

    `guess` is `target_from_source`; `drift_m` bounds how wrong it may be: sides are compared that
    far around, and the thickness of a wall. Where walls face each other within that, nothing is
    said.
    """
    cells = np.floor(target.points / _CELL_M).astype(np.int64)
    if not len(cells):
        return np.zeros(len(source.points), dtype=bool)
    reach = math.ceil((drift_m + _THICK_M) / _CELL_M)
    low = cells.min(axis=0) - reach
    width, height = (cells.max(axis=0) - low + reach + 1).tolist()
    columns, rows = (cells - low).T
    normals = np.round(_UNIT * target.normals)
    lengths = np.where(normals.any(axis=1), _UNIT, 0.0)
    # in x and y, and of the lengths, over the square around each cell
    sums = [
        cv2.boxFilter(
            np.bincount(rows * width + columns, each, width * height).reshape(height, width),
            ddepth=-1,
            ksize=(2 * reach + 1, 2 * reach + 1),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        for each in (*normals.T, lengths)
    ]
    placed = source.placed(guess)
    at = np.floor(placed.points / _CELL_M).astype(np.int64) - low
    inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    x, y, known = (each[at[inside, 1], at[inside, 0]] for each in sums)
    behind = np.zeros(len(at), dtype=bool)
    along = placed.normals[inside]
    behind[inside] = along[:, 0] * x + along[:, 1] * y < _OTHER_SIDE * known
    return behind


def seen_from(
    views: Iterable[FloatArray], places: FloatArray, field: ScoreField, margin_m: float
) -> BoolArray:
    """(H, W) which cells of a field lie in what was seen, or so near to it.

    What a scan saw is the area between the robot and its returns, joined in their order: `views`
    are returns (N, 2), and `places` (n, 3) those of the robot in the frame of the field.
    """
    seen = np.zeros(field.values.shape, dtype=np.uint8)
    size = np.array(field.values.shape[::-1])
    for points, place in zip(views, places.tolist(), strict=True):
        corners = np.concatenate([np.zeros((1, 2)), points])
        if len(corners) >= _FEWEST:
            cells = (Pose2(*place).apply(corners) - field.origin) / field.resolution
            near = np.minimum(np.maximum(np.floor(cells), -size), 2 * size)  # 32 bits hold these
            cv2.fillPoly(seen, [near.astype(np.int32)], 1)
    reach = max(1, round(margin_m / field.resolution))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    return np.asarray(cv2.dilate(seen, kernel) > 0)


@dataclass(frozen=True, slots=True)
class WallFit:
    """The pose of points among others, and its information (3, 3) in the points' own frame."""

    target_from_source: Pose2
    information: FloatArray


Seen = Callable[[ScoreField, float], BoolArray]  # which cells, and how far beyond them


def everywhere(field: ScoreField, _: float) -> BoolArray:
    """(H, W) all cells of a field: what could have been seen where nothing is known of that."""
    return np.ones(field.values.shape, dtype=bool)


@dataclass(frozen=True, slots=True)
class Place:
    """What was seen around a place: how near walls are, and what a point there speaks for."""

    walls: ScoreField
    evidence: ScoreField

    @classmethod
    def of(cls, target: FloatArray, seen: Seen = everywhere) -> Place:
        """The place of walls (M, 2); `seen` says which cells of a field were looked into."""
        walls = ScoreField.from_points(target, CELL_M, _BLUR_M, _SIDE * MATCH_RANGE_M)
        values = walls.values - np.float32(LOOP_SCORE) * seen(walls, _SEEN_M).astype(np.float32)
        return cls(walls, replace(walls, values=values))

    def match(
        self, source: FloatArray, guess: Pose2, drift_m: float, least: float = LEAST_EVIDENCE
    ) -> WallFit | None:
        """The pose of points `source` (N, 2), if there is at least so much evidence for it.

        `guess` is `target_from_source`; `drift_m` bounds how wrong it may be.
        """
        few = thinned(source, FINE_POINTS_M)
        if len(few) < MATCH_POINTS:
            return None
        # perhaps no search is due
        if drift_m <= _APART_M and self.evidence.score(few, guess) >= least:
            points = thinned(source, _REFINED_POINTS_M)
            near = refine(self.walls, points, guess, _REFINED_STEPS, _BLUR_M)
            if self.evidence.score(points, near.pose) >= max(SURE, least):
                return self._fit(source, few, near.pose)
        window = Window(
            distance_m=drift_m,
            angle_rad=float(np.clip(_TURN_PER_M * drift_m, _LEAST_TURN_RAD, _MOST_TURN_RAD)),
            step_m=_COARSE_M,
            penalty_per_m2=_PENALTY_PER_M2,
            penalty_per_rad2=_PENALTY_PER_RAD2,
        )
        coarse = thinned(source, _COARSE_POINTS_M)
        rough = search(self.evidence.coarser(_COARSE_CELLS), coarse, guess, window)
        return None if rough.score <= 0.0 else self.confirmed(source, rough.pose, least)

    def confirmed(self, source: FloatArray, rough: Pose2, least: float) -> WallFit | None:
        """A rough pose of points (N, 2) brought to the optimum, with `least` evidence there."""
        few = thinned(source, FINE_POINTS_M)
        if len(few) < MATCH_POINTS:
            return None
        fine = search(self.evidence, few, rough, _FINE)
        if fine.score <= 0.0:
            return None
        points = thinned(source, _REFINED_POINTS_M)
        near = refine(self.walls, points, fine.pose, _REFINED_STEPS)
        if self.evidence.score(points, near.pose) < least:
            return None
        return self._fit(source, few, near.pose)

    def _fit(self, source: FloatArray, few: FloatArray, near: Pose2) -> WallFit:
        """The match of points (N, 2) at the optimum by a pose; `few` of them tell its error."""
        pose = refine(self.walls.sharper(), thinned(source, CELL_M), near).pose
        spread = opened(covariance(self.walls, few, pose))
        turn = np.eye(3)
        turn[:2, :2] = pose.rotation().T  # errors are weighed in the source's own frame
        known = inverse3(product(product(turn, spread), turn.T) + _FLOOR)
        # a short overlap counts as little as it is
        told = max(LEAST_EVIDENCE, self.evidence.score(few, pose)) / (1.0 - LOOP_SCORE)
        return WallFit(pose, told * known)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Walls (M, 2) in the map, however far they reach, and the field on which a view is sought."""

    points: FloatArray
    field: ScoreField

    @classmethod
    def of(cls, points: FloatArray) -> Surroundings:
        """Those of walls (M, 2)."""
        most_m = _WIDE_SIDE * MATCH_RANGE_M
        return cls(points, ScoreField.from_points(points, _WIDE_CELL_M, _BLUR_M, most_m))

    def find(self, source: FloatArray, seen: Seen, prior: Prior) -> WallFit | None:
        """The pose of a view `source` (N, 2) among the walls, however far the prior reaches.

        It must fit well, nowhere else nearly as well, and leave no direction open: in a bare
        corridor nothing is found. Among trees less fits than among walls: the more the best place
        leads by, the less must fit there. `seen` says which cells of a field, and so near to them,
        were looked into.
        """
        few = thinned(source, FINE_POINTS_M)
        if len(few) < MATCH_POINTS:
            return None
        some = thinned(source, _SPARSE_M)
        rough = answers(self.field, some, prior, _WIDE_STEP_M, _WIDE_STEP_RAD)
        fine = [search(self.field, few, match.pose, _AROUND) for match in rough]
        fine.sort(key=lambda match: -match.score)
        if not fine:
            return None
        best = fine[0].pose
        lead = fine[0].score - max((match.score for match in fine[1:]), default=0.0)
        if lead < _LEAD:
            return None
        least = max(LEAST_EVIDENCE, SURE - (lead - _LEAD))
        near = np.hypot(*(self.points - (best.x, best.y)).T) < _NEAR_RANGES * MATCH_RANGE_M
        fit = Place.of(self.points[near], seen).confirmed(source, best, least)
        if fit is None:
            return None
        variance = float(inverse3(fit.information)[:2, :2].trace())
        return fit if variance <= 2 * _PINNED_M**2 else None


def opened(spread: FloatArray) -> FloatArray:
    """A covariance (3, 3) of a match without what it owes to the window that was looked at.

    Along a bare corridor all of the window fits alike: nothing is known of the way there, and the
    spread is that of the window. Information is what is known beyond that.
    """
    half = 0.5 * (spread[0, 0] - spread[1, 1])
    turn = 0.5 * np.arctan2(spread[0, 1], half)  # of the longer axis
    axis = np.array([np.cos(turn), np.sin(turn)])
    longest = 0.5 * (spread[0, 0] + spread[1, 1]) + np.hypot(half, spread[0, 1])
    known = max(1.0 / longest - 1.0 / _WINDOW_M2, 1.0 / _OPEN_M2)
    result = np.array(spread)
    result[:2, :2] += max(0.0, 1.0 / known - longest) * axis[:, None] * axis
    return result


def match_passes(
    graph: Graph,
    walls: Walls,
    poses: FloatArray,
    rows: RowPair,
    guess: Pose2,
    drift_m: float,
    reach: int,
) -> Link | None:
    """The link of two rows, older and newer, if the walls around them fit.

    `poses` (M, 3) place the rows; the newer pass is made of `reach` of them on either side. `guess`
    is the newer row seen from the older one; it may be wrong by `drift_m`. A wall that the older
    pass saw from its other side only does not fit, however near it lies.
    """
    old, new = rows
    source, target = walls.around(new, reach, poses), walls.around(old, PLACE_NODES, poses)
    place = Place.of(target.points, partial(walls.seen_around, old, PLACE_NODES, poses))
    fit = place.match(source.points, guess, drift_m)
    if fit is None:
        return None
    behind = from_behind(source, target, guess, drift_m)
    share = float(behind.mean())
    if share >= _FEW:
        rest = LEAST_EVIDENCE / max(1.0 - share, LEAST_EVIDENCE)  # of the whole view
        fit = place.match(source.points[~behind], guess, drift_m, rest)
        if fit is None:
            return None
    return Link(
        source=int(graph.nodes[old]),
        target=int(graph.nodes[new]),
        source_from_target=fit.target_from_source,
        information=fit.information,
        kind="nearby",
    )


def link_to_nearest(
    graph: Graph, poses: FloatArray, rows: IntArray, row: int, fit: WallFit
) -> Link:
    """The link to a row whose walls were found in the map, from the nearest of other `rows`.

    `poses` (M, 3) are those of the map.
    """
    found = fit.target_from_source
    nearest = int(rows[np.argmin(np.hypot(poses[rows, 0] - found.x, poses[rows, 1] - found.y))])
    relative = compose(invert(poses[nearest]), np.array(found))
    return Link(
        source=int(graph.nodes[nearest]),
        target=int(graph.nodes[row]),
        source_from_target=Pose2(*relative.tolist()),
        information=fit.information,
        kind="nearby",
    )

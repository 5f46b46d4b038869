"""Walls matched with walls: from a rough pose to the best one, and how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, inverse3, invert, product
from specmap_cli.core.records import IntArray
from specmap_cli.grids.matching import SPREAD_M, Window, covariance, refine, search
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.path_graph import MATCH_RANGE_M, Graph, RowPair
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.walls import CELL_M, PLACE_NODES, Walls, from_behind

MATCH_POINTS = 20  # walls with fewer points are not matched
LOOP_SCORE = 0.6  # a match below this is no edge

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
# Between two places tried in a search the score falls to no less than this share of the best:
# half the diagonal of a step of the fine one, 7 cm, is 0.7 sigma of the field.
_HOPELESS = 0.75
_SIDE = 4.0  # of the field of a place, in ranges: stray points beyond it cost no memory
_WINDOW_M2 = SPREAD_M**2 / 3  # variance of a window that fits all over
_OPEN_M2 = 2.0**2  # of a place along a corridor that shows nothing: the wall is still that wall
# Error of the best match: a cell's side over the root of 12, and what people and furniture moved.
_FLOOR = np.diag([0.015**2, 0.015**2, 0.004**2])
_FEW = 0.05  # share of points that cannot move a match by much


@dataclass(frozen=True, slots=True)
class WallFit:
    """The pose of points among others, and its information (3, 3) in the points' own frame."""

    target_from_source: Pose2
    information: FloatArray


def match_walls(
    source: FloatArray,
    target: FloatArray,
    guess: Pose2,
    drift_m: float,
    least_score: float = LOOP_SCORE,
) -> WallFit | None:
    """The pose of points `source` (N, 2) among `target` (M, 2), if they reach `least_score` there.

    `guess` is `target_from_source`; `drift_m` bounds how wrong it may be.
    """
    field = field_of(target)
    few = thinned(source, FINE_POINTS_M)
    if len(few) < MATCH_POINTS:
        return None
    if drift_m <= _APART_M and field.score(few, guess) >= least_score:  # perhaps no search is due
        near = refine(field, thinned(source, _REFINED_POINTS_M), guess, _REFINED_STEPS, _BLUR_M)
        if near.score >= 0.5 + 0.5 * least_score:  # halfway from what is asked to a perfect fit
            return _fit(field, source, few, near.pose)
    window = Window(
        distance_m=drift_m,
        angle_rad=float(np.clip(_TURN_PER_M * drift_m, _LEAST_TURN_RAD, _MOST_TURN_RAD)),
        step_m=_COARSE_M,
        penalty_per_m2=_PENALTY_PER_M2,
        penalty_per_rad2=_PENALTY_PER_RAD2,
    )
    coarse = thinned(source, _COARSE_POINTS_M)
    rough = search(field.coarser(_COARSE_CELLS), coarse, guess, window)
    if rough.score < _HOPELESS * least_score:
        return None
    return confirmed(field, source, rough.pose, least_score)


def field_of(target: FloatArray) -> ScoreField:
    """The score field of the walls (M, 2) around one place."""
    return ScoreField.from_points(target, CELL_M, _BLUR_M, _SIDE * MATCH_RANGE_M)


def confirmed(
    field: ScoreField, source: FloatArray, rough: Pose2, least_score: float
) -> WallFit | None:
    """A rough pose of points (N, 2) brought to the optimum, if `least_score` is reached there."""
    few = thinned(source, FINE_POINTS_M)
    if len(few) < MATCH_POINTS:
        return None
    fine = search(field, few, rough, _FINE)
    if fine.score < _HOPELESS * least_score:
        return None
    near = refine(field, thinned(source, _REFINED_POINTS_M), fine.pose, _REFINED_STEPS)
    if near.score < least_score:
        return None
    return _fit(field, source, few, near.pose)


def _fit(field: ScoreField, source: FloatArray, few: FloatArray, near: Pose2) -> WallFit:
    """The match of points (N, 2) at the optimum by a pose; its error is had from `few` of them."""
    pose = refine(field.sharper(), thinned(source, CELL_M), near).pose
    spread = opened(covariance(field, few, pose))
    turn = np.eye(3)
    turn[:2, :2] = pose.rotation().T  # errors are weighed in the source's own frame
    return WallFit(pose, inverse3(product(product(turn, spread), turn.T) + _FLOOR))


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
    source = walls.around(new, reach, poses)
    target = walls.around(old, PLACE_NODES, poses)
    fit = match_walls(source, target, guess, drift_m)
    if fit is None:
        return None
    sides, others = (
        walls.sides_around(new, reach, poses),
        walls.sides_around(old, PLACE_NODES, poses),
    )
    behind = from_behind(sides, others, guess, drift_m)
    share = float(behind.mean())
    if share >= _FEW:
        asked = LOOP_SCORE / max(1.0 - share, LOOP_SCORE)
        fit = match_walls(source[~behind], target, guess, drift_m, asked)
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

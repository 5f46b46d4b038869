"""What two maps have in common under a transform: how well their walls agree, and where they join.

A map that is bent a little by drift fits another one nowhere exactly. So each submap may lie off by
what a layout leaves open, and how far off it was is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure.prepared import PlacedGrid, PreparedGrid, PreparedMap
from specmap_cli.recognition.closure.verification import (
    CONTRADICTION_WEIGHT,
    MIN_WALL_M,
    Check,
    agreement,
    judge,
)

# How far a submap may lie from where one rigid transform puts it: what a layout leaves open, as
# `CLOSURE_SLACK_M` of the layout does; and by how much it may be turned.
_SLACK_M, _SLACK_RAD = 0.5, math.radians(3.0)
_ODD = 0.5  # score of a submap of which a quarter, at the least, is not what the other map saw
_POINTS, _STEPS = 300, 8  # of the match of a submap
# Of the match of two submaps near the transform of the maps.
_JOINT_POINTS, _JOINT_STEPS, _JOINT_SHIFT_M = 1000, 15, 0.5
_MOST_TURN_RAD = math.radians(3.0)
_NEAR_SCORE = 0.1  # of a wide field: two sigma of it, some 0.6 m: no match moves a wall farther


@dataclass(frozen=True, slots=True, kw_only=True)
class PieceFit:
    """One submap of either map under a transform, and where it fits best nearby.

    `known_m` of its `walls_m` lie where the other map saw; `confirmed_m` of these are there, too,
    and `contradicted_m` stand in its free space. `old_from_new` is the transform that fits it best,
    `off_m` away where it lies, at `centre` (2,) in the new map.
    """

    walls_m: float
    known_m: float
    confirmed_m: float
    contradicted_m: float
    old_from_new: Pose2
    off_m: float
    centre: FloatArray

    @property
    def score(self) -> float:
        """The share confirmed less twice the share contradicted."""
        lost = CONTRADICTION_WEIGHT * self.contradicted_m
        return (self.confirmed_m - lost) / self.known_m if self.known_m > 0.0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonGround:
    """Two maps under a transform, where both saw.

    `confirmed` and `contradicted` are shares of the walls that both maps know about, the worse of
    both maps'; `confirmed_m` metres of wall that agree; `at_odds` the share of the walls that are
    in submaps which do not fit, the worse of both maps'; `residual_m` (root mean square): how far
    submaps lie off.
    """

    pieces: tuple[PieceFit, ...]
    confirmed: float
    contradicted: float
    confirmed_m: float
    at_odds: float
    residual_m: float

    @property
    def score(self) -> float:
        """The share confirmed less twice the share contradicted."""
        return self.confirmed - CONTRADICTION_WEIGHT * self.contradicted


def common_ground(
    old: tuple[PreparedMap, PreparedGrid],
    new: tuple[PreparedMap, PreparedGrid],
    old_from_new: Pose2,
) -> CommonGround:
    """Two maps, each its submaps and its whole grid, under a transform."""
    there = [_fit(piece, old[1], old_from_new) for piece in new[0].all()]
    back = []
    for piece in old[0].all():  # sought in the new map, and told of the old one
        fit = _fit(piece, new[1], old_from_new.inverse())
        centre = fit.old_from_new.apply(fit.centre[None])[0]
        back.append(replace(fit, old_from_new=fit.old_from_new.inverse(), centre=centre))
    sides = []  # of either map's walls: shares confirmed and contradicted, metres, share at odds
    for own in (there, back):
        known = sum(fit.known_m for fit in own)
        good = sum(fit.confirmed_m for fit in own)
        bad = sum(fit.contradicted_m for fit in own)
        odd = sum(fit.known_m for fit in own if fit.score < _ODD)
        some = known > 0.0
        sides.append((good / known, bad / known, good, odd / known) if some else (0.0,) * 4)
    confirmed, contradicted, confirmed_m, at_odds = zip(*sides, strict=True)
    fits = (*there, *back)
    weights = np.array([fit.confirmed_m for fit in fits])
    off = np.array([fit.off_m for fit in fits])
    heavy = weights.sum() > 0.0
    return CommonGround(
        pieces=fits,
        confirmed=min(confirmed),
        contradicted=max(contradicted),
        confirmed_m=min(confirmed_m),
        at_odds=max(at_odds),
        residual_m=math.sqrt(float(np.average(off**2, weights=weights))) if heavy else 0.0,
    )


def _fit(piece: PlacedGrid, whole: PreparedGrid, whole_from_map: Pose2) -> PieceFit:
    """A submap of one map against the whole grid of the other."""
    grid, frame = piece.grid, piece.frame
    guess = whole_from_map @ frame
    best = refine(whole.field, evenly(grid.walls, _POINTS), guess, _STEPS, _SLACK_M).pose
    if abs(wrap_angle(best.theta - guess.theta)) > _SLACK_RAD:
        best = guess
    said = agreement(whole.area, best.apply(grid.walls))
    walls_m = len(grid.walls) * grid.metres_a_point
    known_m = said.known * walls_m
    middle = grid.walls.mean(axis=0)[None]
    return PieceFit(
        walls_m=walls_m,
        known_m=known_m,
        confirmed_m=said.confirmed * known_m,
        contradicted_m=said.contradicted * known_m,
        old_from_new=best @ frame.inverse(),
        off_m=math.dist(best.apply(middle)[0], guess.apply(middle)[0]),
        centre=frame.apply(middle)[0],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """A submap of the old map and one of the new map whose grids match under an alignment.

    `check` is of the two grids, `map_from_map` what it says of the maps (old from new).
    """

    old: int
    new: int
    map_from_map: Pose2
    check: Check


def joints(
    old: PreparedMap, new: PreparedMap, old_from_new: Pose2, config: RecognitionConfig
) -> tuple[Joint, ...]:
    """The pairs of submaps that match near a transform of their maps, by id of new, then of old.

    Only those are told that are the best of one of both submaps: neighbours that see each other
    through a door match, too, but slide along their walls.
    """
    found, most = list[Joint](), dict[tuple[str, int], float]()
    for walls_m, i, j in _shared(old, new, old_from_new):
        ends = ("old", i), ("new", j)
        if all(walls_m <= most.get(end, 0.0) for end in ends):
            continue  # neither's best: no more can be confirmed than lies near
        one, other = old.of(i), new.of(j)
        if one is None or other is None:
            continue
        guess = one.frame.inverse() @ old_from_new @ other.frame
        points = evenly(other.grid.walls, _JOINT_POINTS)
        pose = refine(one.grid.field, points, guess, _JOINT_STEPS, _JOINT_SHIFT_M).pose
        check = judge(one.grid, other.grid, pose)
        turn = abs(wrap_angle(pose.theta - guess.theta))
        if turn <= _MOST_TURN_RAD and check.matches(config.min_score):
            map_from_map = one.frame @ pose @ other.frame.inverse()
            found.append(Joint(old=i, new=j, map_from_map=map_from_map, check=check))
            most |= {end: max(check.confirmed_m, most.get(end, 0.0)) for end in ends}
    found.sort(key=lambda joint: (joint.new, joint.old))
    best: dict[tuple[str, int], Joint] = {}
    for joint in sorted(found, key=lambda joint: joint.check.confirmed_m):
        best["old", joint.old] = best["new", joint.new] = joint
    return tuple(joint for joint in found if any(joint is other for other in best.values()))


def _shared(
    old: PreparedMap, new: PreparedMap, old_from_new: Pose2
) -> list[tuple[float, int, int]]:
    """Pairs of submaps, old and new, that may match, those first that may share most wall.

    With each the metres of the new one's walls that lie near walls of the old one. Pairs whose
    boxes do not meet share none.
    """
    found = []
    for other in new.all():
        walls = (old_from_new @ other.frame).apply(other.grid.walls)
        low, high = walls.min(axis=0), walls.max(axis=0)
        for one in old.all():
            walls = one.frame.apply(one.grid.walls)
            if (low >= walls.max(axis=0)).any() or (walls.min(axis=0) >= high).any():
                continue
            guess = one.frame.inverse() @ old_from_new @ other.frame
            points = guess.apply(evenly(other.grid.walls, _JOINT_POINTS))
            share = float((one.grid.wide.at(points) > _NEAR_SCORE).mean())
            walls_m = share * len(other.grid.walls) * other.grid.metres_a_point
            if walls_m >= MIN_WALL_M:
                found.append((walls_m, one.submap, other.submap))
    return sorted(found, key=lambda pair: (-pair[0], pair[2], pair[1]))

"""What two maps have in common under a transform: where each submap of either fits best.

A layout bends from room to room: a submap may lie off by a little, and those beside it with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import BentMotion, FloatArray, LocalMotion, Pose2, wrap_angle
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.matching import covariance, refine
from specmap_cli.recognition.closure.verification import (
    CONTRADICTION_WEIGHT,
    LEAST_WALL_M,
    MIN_WALL_M,
    PreparedGrid,
    agreement,
    walls_of,
)

# How far a submap may lie from where one rigid transform puts it: what a layout leaves open, as
# `CLOSURE_SLACK_M` of the layout does; and by how much it may be turned.
_SLACK_M, _SLACK_RAD = 0.5, math.radians(3.0)
ODD = 0.5  # score of a submap of which a quarter, at the least, is not what the other map saw
_POINTS, _STEPS = 300, 8  # of the match of a submap
_SAME_WALL_M = 0.3  # between walls of two submaps that are one
# Of a submap that lies where it fits by itself: how well it fits, metres of wall, and the standard
# deviation of its place. A room of which the other map saw but a wall slides along it.
_FITS, _FITTING_M, _FIXED_M = 0.7, 5.0, 0.13


@dataclass(frozen=True, slots=True, kw_only=True)
class MapToAlign:
    """A finished map: its `whole` grid, and the grids of its submaps by id.

    `frames` are those of the submaps in the map. In a map whose stretch was made longer, what lies
    beyond is `longer_m` farther on towards `heading`, metres and radians.
    """

    whole: GridMap
    grids: Mapping[int, GridMap]
    frames: Mapping[int, Pose2]
    longer_m: float = 0.0
    heading: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PieceFit:
    """One submap of either map under a transform, and where it fits best nearby.

    `known_m` of its `walls_m` lie where the other map saw; `confirmed_m` of these are there, too,
    and `contradicted_m` stand in its free space. `old_from_new` is the transform that fits it best,
    `off_m` away from where it was looked for, at `centre` (2,) in the new map. The scores around it
    leave `spread_m` open there, in the direction in which they leave most, and `spread_rad` of the
    heading (standard deviations). `partner` is the submap of the other map that has most of these
    walls, if any has.
    """

    submap: int
    walls_m: float
    known_m: float
    confirmed_m: float
    contradicted_m: float
    old_from_new: Pose2
    off_m: float
    centre: FloatArray
    spread_m: float
    spread_rad: float
    partner: int | None

    @property
    def score(self) -> float:
        """The share confirmed less twice the share contradicted."""
        lost = CONTRADICTION_WEIGHT * self.contradicted_m
        return (self.confirmed_m - lost) / self.known_m if self.known_m > 0.0 else 0.0


def bent_motion(rigid: Pose2, fits: Iterable[PieceFit]) -> BentMotion:
    """The motion between two maps, `rigid` and bent to where their submaps fit."""
    local = [
        LocalMotion(fit.centre, fit.old_from_new, fit.spread_m, fit.spread_rad)
        for fit in fits
        if fit.score >= _FITS and fit.confirmed_m >= _FITTING_M and fit.spread_m <= _FIXED_M
    ]
    return BentMotion(rigid, tuple(local))


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonGround:
    """Two maps under a transform, where both saw; each submap may lie off by a little.

    `old` and `new` are the fits of their submaps. `confirmed` and `contradicted` are shares of the
    walls that both maps know about, the worse of both maps'; `confirmed_m` metres of wall that
    agree; `at_odds` the share of the walls that are in submaps which do not fit, the worse of both
    maps'; `residual_m` (root mean square): how far submaps lie off.
    """

    old: tuple[PieceFit, ...]
    new: tuple[PieceFit, ...]
    confirmed: float
    contradicted: float
    confirmed_m: float
    at_odds: float
    residual_m: float


class SubmapWalls:
    """A map, its whole grid prepared, and the walls of its submaps, in the map."""

    def __init__(self, map_: MapToAlign, whole: PreparedGrid) -> None:
        self.map, self.whole = map_, whole
        self.walls: dict[int, FloatArray] = {}
        self.metres: dict[int, float] = {}  # of wall a point
        for id_, frame in sorted(map_.frames.items()):
            points, each_m = walls_of(map_.grids[id_])
            if len(points) * each_m >= LEAST_WALL_M:
                self.walls[id_], self.metres[id_] = frame.apply(points), each_m

    @cached_property
    def trees(self) -> dict[int, cKDTree]:
        """The walls of each submap, to ask which of them has a wall."""
        return {id_: cKDTree(walls) for id_, walls in self.walls.items()}

    def fits(self, other: SubmapWalls, other_from_map: Pose2) -> list[PieceFit]:
        """Its submaps against the whole of another map; `old_from_new` is from here to there.

        One that does not fit where the transform puts it may fit where those do that lie round it:
        a layout bends from room to room.
        """
        found = {id_: self._fit(id_, other, other_from_map) for id_ in self.walls}
        while True:
            bent = bent_motion(other_from_map, found.values())
            better = {}
            for id_, before in found.items():
                if before.score < _FITS:
                    fit = self._fit(id_, other, bent.near(before.centre))
                    if fit.score >= _FITS:
                        better[id_] = fit
            if not better:
                return list(found.values())
            found |= better

    def _fit(self, id_: int, other: SubmapWalls, other_from_map: Pose2) -> PieceFit:
        """A submap where it fits best near where a transform puts it."""
        walls, each_m = self.walls[id_], self.metres[id_]
        middle = walls.mean(axis=0)
        x, y = middle.tolist()
        guess = other_from_map @ Pose2(x, y, 0.0)
        points = evenly(walls - middle, _POINTS)
        best = refine(other.whole.field, points, guess, _STEPS, _SLACK_M).pose
        if abs(wrap_angle(best.theta - guess.theta)) > _SLACK_RAD:
            best = guess
        there = best.apply(walls - middle)
        said = agreement(other.whole, there)
        known_m = said.known * len(walls) * each_m
        spread = covariance(other.whole.field, points, best)
        return PieceFit(
            submap=id_,
            walls_m=len(walls) * each_m,
            known_m=known_m,
            confirmed_m=said.confirmed * known_m,
            contradicted_m=said.contradicted * known_m,
            old_from_new=best @ Pose2(-x, -y, 0.0),
            off_m=math.dist(best[:2], guess[:2]),
            centre=middle,
            spread_m=math.sqrt(float(np.linalg.eigvalsh(spread[:2, :2])[-1])),
            spread_rad=math.sqrt(float(spread[2, 2])),
            partner=other.partner(there, each_m),
        )

    def partner(self, walls: FloatArray, each_m: float) -> int | None:
        """The submap that has most of some walls (n, 2) in the map, if one has enough."""
        points = evenly(walls, _POINTS)
        each_m *= len(walls) / len(points)
        low, high = points.min(axis=0), points.max(axis=0)
        best, most_m = None, MIN_WALL_M
        for id_, tree in self.trees.items():
            if (low < tree.maxes).all() and (tree.mins < high).all():
                away, _ = tree.query(points, distance_upper_bound=_SAME_WALL_M)
                shared_m = float(np.count_nonzero(np.isfinite(away))) * each_m
                if shared_m > most_m:
                    best, most_m = id_, shared_m
        return best


def common_ground(old: SubmapWalls, new: SubmapWalls, old_from_new: Pose2) -> CommonGround:
    """What two maps have in common under a transform."""
    there = tuple(new.fits(old, old_from_new))
    back = tuple(
        replace(
            fit,
            old_from_new=fit.old_from_new.inverse(),
            centre=fit.old_from_new.apply(fit.centre[None])[0],
        )
        for fit in old.fits(new, old_from_new.inverse())
    )
    sides = []  # of either map's walls: shares confirmed and contradicted, metres, share at odds
    for own in (there, back):
        known = sum(fit.known_m for fit in own)
        good = sum(fit.confirmed_m for fit in own)
        bad = sum(fit.contradicted_m for fit in own)
        odd = sum(fit.known_m for fit in own if fit.score < ODD)
        some = known > 0.0
        sides.append((good / known, bad / known, good, odd / known) if some else (0.0,) * 4)
    confirmed, contradicted, confirmed_m, at_odds = zip(*sides, strict=True)
    weights = np.array([fit.confirmed_m for fit in (*there, *back)])
    off = np.array([fit.off_m for fit in (*there, *back)])
    heavy = weights.sum() > 0.0
    return CommonGround(
        old=back,
        new=there,
        confirmed=min(confirmed),
        contradicted=max(contradicted),
        confirmed_m=min(confirmed_m),
        at_odds=max(at_odds),
        residual_m=math.sqrt(float(np.average(off**2, weights=weights))) if heavy else 0.0,
    )

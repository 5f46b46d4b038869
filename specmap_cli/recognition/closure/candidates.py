"""Transforms between two maps, refined on their walls, and how much wall speaks for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import FREE, GridMap
from specmap_cli.grids.matching import refine
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.closure.prepared import PreparedGrid
from specmap_cli.recognition.closure.verification import net_walls_m
from specmap_cli.recognition.closure.votes import Party

# Of the refinement of a candidate: from a coarse cell of the search away, then to the centimetre.
_ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M = 400, 8, 0.6
_FINE_STEPS, _FINE_SHIFT_M = 15, 0.2
_NEAR_SCORE, _FEWEST_NEAR = 0.1, 50  # of a wide field: two sigma of it, some 0.6 m
_WALLS_PER_M2 = 3.0  # of rooms, with all that stands in them; offices have two
_FLOOR_POINTS = 5000  # of the free space: its share that both saw to a hundredth


@dataclass(frozen=True, slots=True)
class Candidate:
    """A refined transform, the metres of wall that speak for it, and the party that found it.

    Walls count only as far as there are rooms between them: maps that touch back to back have
    straight walls in common, and nothing else.
    """

    old_from_new: Pose2
    merit_m: float
    party: Party | None

    @property
    def strength(self) -> int:
        """How many submaps of either map found it by themselves."""
        return 0 if self.party is None else self.party.strength


@dataclass(frozen=True, slots=True)
class Floors:
    """What was seen free: in the old map's `grid`, and points (n, 2) of the new map's free space.

    Each point stands for `area_m2`.
    """

    grid: GridMap
    points: FloatArray
    area_m2: float

    @classmethod
    def of(cls, old: GridMap, new: GridMap) -> Floors:
        """The free space of two maps."""
        free = np.argwhere(new.free)
        points = evenly(free, _FLOOR_POINTS)
        area_m2 = new.free_area_m2 / max(1, len(points))
        return cls(old, new.centres_of(points), area_m2)

    def common_m2(self, old_from_new: Pose2) -> float:
        """Square metres that are free in both maps."""
        values = self.grid.values_at(old_from_new.apply(self.points))
        return float(np.count_nonzero(values == FREE)) * self.area_m2


def refined(
    old: PreparedGrid,
    new: PreparedGrid,
    floors: Floors,
    guess: Pose2,
    party: Party | None,
) -> Candidate:
    """A guess that `party` made, if any, moved to where the walls of both maps fit best."""
    few = evenly(_near_walls(old, new, guess), _ROUGH_POINTS)
    near = _about_their_middle(old.field, few, guess, _ROUGH_STEPS, _ROUGH_SHIFT_M)
    walls = _near_walls(old, new, near)
    fine = _about_their_middle(old.field.sharper(), walls, near, _FINE_STEPS, _FINE_SHIFT_M)
    around_m = _WALLS_PER_M2 * floors.common_m2(fine)
    return Candidate(fine, min(net_walls_m(old, new, fine), around_m), party)


def _near_walls(old: PreparedGrid, new: PreparedGrid, old_from_new: Pose2) -> FloatArray:
    """(N, 2) the points on the new map's walls that come near walls of the old one; or all."""
    near = old.wide.at(old_from_new.apply(new.walls)) > _NEAR_SCORE
    return new.walls[near] if np.count_nonzero(near) >= _FEWEST_NEAR else new.walls


def _about_their_middle(
    field: ScoreField, points: FloatArray, guess: Pose2, steps: int, shift_m: float
) -> Pose2:
    """`refine`, by no more than a shift where the points (N, 2) are: the frame may lie far off."""
    x, y = points.mean(axis=0).tolist()
    found = refine(field, points - (x, y), guess @ Pose2(x, y, 0.0), steps, shift_m)
    return found.pose @ Pose2(-x, -y, 0.0)

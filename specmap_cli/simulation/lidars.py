"""A 3D lidar with its errors, in a world whose walls stand between a floor and a ceiling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.simulation.driving import Drive
from specmap_cli.simulation.lasers import Laser
from specmap_cli.simulation.worlds import World


class Cloud(NamedTuple):
    """Returns of one sweep: `points` (N, 3) in the lidar's frame, `times_s` (N,) after its stamp.

    They come in the order in which they were measured; `times_s` is None for a sweep at once.
    """

    points: FloatArray
    times_s: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Lidar:
    """A 3D lidar: `level` with beams at every one of the `elevations` (R,), radians, upwards.

    It stands `height_m` above the floor; walls and the ceiling are `ceiling_m` above it.
    """

    level: Laser
    elevations: FloatArray
    height_m: float
    ceiling_m: float

    def clouds(
        self, world: World, drive: Drive, times_s: FloatArray, rng: np.random.Generator
    ) -> Iterator[Cloud]:
        """The sweeps that begin at the times (n,)."""
        for walls in self.level.casts(world, drive, times_s):
            for distances in walls:
                yield self._cloud(self.level.measured(self._ranges(distances), rng))

    def _ranges(self, walls: FloatArray) -> FloatArray:
        """True ranges (B, R) of all beams, given the distances (B,) of the walls over ground."""
        slopes = np.tan(self.elevations)
        above, below = self.ceiling_m - self.height_m, self.height_m
        room = np.where(slopes > 0.0, above, below)
        level = slopes == 0.0
        ends = np.where(level, np.inf, room / np.where(level, 1.0, np.abs(slopes)))
        return np.minimum(walls[:, None], ends) / np.cos(self.elevations)

    def _cloud(self, ranges: FloatArray) -> Cloud:
        """The returns among measured ranges (B, R)."""
        hit = np.isfinite(ranges)
        column, ring = np.nonzero(hit)
        bearings, elevations = self.level.bearings[column], self.elevations[ring]
        over_ground = ranges[hit] * np.cos(elevations)
        x, y = over_ground * np.cos(bearings), over_ground * np.sin(bearings)
        points = np.column_stack([x, y, ranges[hit] * np.sin(elevations)])
        timed = self.level.sweep_s > 0.0
        return Cloud(points, self.level.beam_times_s[column] if timed else None)


def ring_elevations(field_of_view_rad: float, rings: int) -> FloatArray:
    """Elevations (R,) of the rings from the lowest to the highest, centred on level."""
    half = 0.5 * field_of_view_rad
    return np.linspace(-half, half, rings)

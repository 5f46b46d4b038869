"""The world of a simulation: a plan that stops beams and in which a robot drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap, cast_rays


@dataclass(frozen=True, slots=True)
class World:
    """A floor plan in which everything that is not free is a wall.

    `plan` holds FREE and OCCUPIED cells only; `distance` (H, W) and `clearance` (H, W) are metres
    to the nearest wall, for beams and for the robot.
    """

    plan: GridMap
    distance: FloatArray
    clearance: FloatArray

    @classmethod
    def of(cls, plan: GridMap) -> World:
        """The world of a plan: unknown cells, outside the building or never seen, stop a beam."""
        cells = np.where(plan.free, FREE, OCCUPIED).astype(np.uint8)
        solid = GridMap(cells, plan.resolution, plan.origin)
        return cls(solid, solid.obstacle_distance(), solid.clearance())

    def clearance_at(self, points: NDArray[Any]) -> FloatArray:
        """(N,) metres from each point (N, 2) to the next wall, half a cell on the safe side."""
        cells = self.plan.cells_of(points)
        inside = self.plan.inside(cells)
        clearance = np.zeros(len(cells))
        clearance[inside] = self.clearance[cells[inside, 0], cells[inside, 1]]
        return np.maximum(clearance - 0.5 * self.plan.resolution, 0.0)

    def cast(self, origins: NDArray[Any], angles: NDArray[Any], max_range: float) -> FloatArray:
        """True ranges (N,) of rays from origins (N, 2) along angles (N,), +inf past the range."""
        return cast_rays(self.distance, self.plan, origins, angles, max_range)

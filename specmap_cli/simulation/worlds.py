"""The world of a simulation: a plan that stops beams and in which a robot drives, and its rooms.

The true rooms are painted by hand: which of them a pose of the robot lies in is the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import (
    FREE,
    OCCUPIED,
    GridMap,
    LengthArray,
    cast_rays,
    clearance_of,
    exact,
    nearest_values,
)

LabelArray = NDArray[np.int32]

# The pictures of Bormann et al., "Room Segmentation: Survey, Implementation, and Analysis", ICRA
# 2016, hold rooms of 255 and walls of 0; their specks of a few pixels are slips of the brush.
_ROOM_GREY = 250
_ROOM_MIN_PIXELS = 100


@dataclass(frozen=True, slots=True)
class World:
    """A floor plan in which everything that is not free is a wall.

    `plan` holds FREE and OCCUPIED cells only; `distance` (H, W) and `clearance` (H, W) are metres
    to the nearest wall, for beams and for the robot.
    """

    plan: GridMap
    distance: LengthArray
    clearance: FloatArray

    @classmethod
    def of(cls, plan: GridMap) -> World:
        """The world of a plan: unknown cells, outside the building or never seen, stop a beam."""
        cells = np.where(plan.free, FREE, OCCUPIED).astype(np.uint8)
        solid = GridMap(cells, plan.resolution, plan.origin)
        clearance = exact(clearance_of(plan.free)) * plan.resolution
        return cls(solid, solid.obstacle_distance(), clearance)

    def clearance_at(self, points: NDArray[Any]) -> FloatArray:
        """(N,) metres from each point (N, 2) to the next wall, half a cell on the safe side."""
        clearance = self.plan.under(points, self.clearance, 0.0)
        return np.maximum(clearance - 0.5 * self.plan.resolution, 0.0)

    def cast(self, origins: NDArray[Any], angles: NDArray[Any], max_range: float) -> FloatArray:
        """True ranges (N,) of rays from origins (N, 2) along angles (N,), +inf past the range."""
        return cast_rays(self.distance, self.plan, origins, angles, max_range)


@dataclass(frozen=True, slots=True)
class RoomTruth:
    """Rooms painted by hand: `labels` (H, W), 0 = no room, row 0 the lowest y, as in a GridMap."""

    labels: LabelArray
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def count(self) -> int:
        """How many rooms there are; they are numbered 1, 2, ..."""
        return int(self.labels.max(initial=0))

    def at(self, points: NDArray[Any], reach_m: float = 0.5) -> LabelArray:
        """(N,) room of each point (N, 2 or more columns), by the nearest painted cell.

        A point up to `reach_m` from a room, such as one on the line of a door, is in that room; a
        point farther away is in none: 0.
        """
        positions = np.asarray(points, dtype=np.float64)[:, :2]
        nearest, away = nearest_values(self.labels)
        height, width = self.labels.shape
        cells = np.floor((positions - self.origin) / self.resolution).astype(np.intp)
        columns = np.clip(cells[:, 0], 0, width - 1)
        rows = np.clip(cells[:, 1], 0, height - 1)
        outside = np.hypot(cells[:, 0] - columns, cells[:, 1] - rows)
        distance = (away[rows, columns] + outside) * self.resolution
        return np.where(distance <= reach_m, nearest[rows, columns], 0).astype(np.int32)


def read_rooms(path: str | Path, resolution: float) -> RoomTruth:
    """The rooms of a ground-truth picture: its white (> 250) connected regions of >= 100 pixels.

    `resolution` is metres a pixel; the lower left corner of the picture is the origin. Rooms are
    numbered in the order of the picture's rows, from its top. Raises MapError when the picture
    cannot be read or shows no room.
    """
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise MapError(
            "cannot be read as a picture", "give a PNG with white rooms", mark=";", where=path
        )
    white = (picture > _ROOM_GREY).astype(np.uint8)
    _, regions, stats, _ = cv2.connectedComponentsWithStats(white)
    kept = stats[:, cv2.CC_STAT_AREA] >= _ROOM_MIN_PIXELS
    kept[0] = False
    if not kept.any():
        raise MapError(f"no white region of {_ROOM_MIN_PIXELS} pixels; is it a plan?", where=path)
    number = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    return RoomTruth(np.ascontiguousarray(number[regions][::-1]), resolution)

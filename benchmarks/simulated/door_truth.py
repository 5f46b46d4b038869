"""The true doors of a floor plan: the free strips that its painter left between two rooms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, GridMap
from specmap_cli.simulation.worlds import RoomTruth

# Of a strip: narrower ones are holes in a painted wall; wider ones may count as doors or as open
# borders, whatever a map says of them.
NARROWEST_M, WIDEST_M = 0.5, 1.6
_LEAST_CELLS = 4  # of a strip, and of its contact with a room
_DEPTH_M = 0.3  # before and behind its line the passage may be narrower
_FINE = 10  # looks a cell
_BESIDE_M = 0.7  # from the middle of a strip to a place that is well inside a room


@dataclass(frozen=True, slots=True)
class TrueDoor:
    """A strip between rooms: its middle, its clear width, and places on both sides (2, 2)."""

    place: FloatArray
    width_m: float
    sides: FloatArray

    @property
    def counts(self) -> bool:
        """Whether it is a door for sure."""
        return NARROWEST_M <= self.width_m <= WIDEST_M


def true_doors(plan: GridMap, rooms: RoomTruth) -> list[TrueDoor]:
    """The strips of a plan that are at least as wide as a door."""
    free = plan.free
    strips = (free & (rooms.labels == 0)).astype(np.uint8)
    count, parts = cv2.connectedComponents(strips, connectivity=8)
    found = [_door(plan, parts == number, rooms) for number in range(1, count)]
    return [door for door in found if door is not None and door.width_m >= NARROWEST_M]


def _door(plan: GridMap, strip: BoolArray, rooms: RoomTruth) -> TrueDoor | None:
    """The door of one strip, None for a speck or one that touches a single room."""
    cells = np.argwhere(strip)
    around = cv2.dilate(strip.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    touched = np.bincount(rooms.labels[around & plan.free])[1:]
    if len(cells) < _LEAST_CELLS or np.count_nonzero(touched >= _LEAST_CELLS) < 2:
        return None
    middle = cells.mean(axis=0)
    _, _, axes = np.linalg.svd(cells - middle, full_matrices=False)
    along, across = axes[0], np.array([-axes[0][1], axes[0][0]])
    depth = round(_DEPTH_M / plan.resolution)
    runs = [run(plan.free, middle + k * across, along) for k in range(-depth, depth + 1)]
    width = min((length for length in runs if length), default=0.0)
    beside = middle + np.array([[-1.0], [1.0]]) * across * (_BESIDE_M / plan.resolution)
    return TrueDoor(
        plan.centres_of(middle[None])[0], width * plan.resolution, plan.centres_of(beside)
    )


def run(free: BoolArray, start: FloatArray, way: NDArray[np.float64]) -> float:
    """Cells that are free in one piece along a straight line through `start`; 0 if that is not."""
    return max(0.0, sum(_steps(free, start, sign * way) for sign in (-1.0, 1.0)) - 1.0 / _FINE)


def _steps(free: BoolArray, start: FloatArray, way: FloatArray) -> float:
    """How far one gets from a place, in cells."""
    for step, (row, column) in enumerate(_cells(start, way)):
        inside = 0 <= row < free.shape[0] and 0 <= column < free.shape[1]
        if not inside or not free[row, column]:
            return step / _FINE
    raise AssertionError("a line that never ends")


def _cells(start: FloatArray, way: FloatArray) -> Iterator[tuple[int, int]]:
    step = 0
    while True:
        row, column = np.rint(start + step * way / _FINE).astype(int).tolist()
        yield row, column
        step += 1


def narrowest(plan: GridMap, place: FloatArray) -> float:
    """Metres of the shortest free line through a place of a plan, in any direction; 0 in a wall."""
    cell = plan.cells_of(place[None])[0]
    angles = np.arange(0.0, np.pi, np.pi / 24)
    ways = np.column_stack([np.sin(angles), np.cos(angles)])
    return min(run(plan.free, cell, way) for way in ways) * plan.resolution

"""What stands in one map where another one saw free space: walls, furniture, closed doors."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.bent import BentMotion
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap

# An obstacle is another one when it stands farther than this from all obstacles of the other map:
# what cells, the noise of a laser and a map that is bent a little leave open.
_APART_M, _APART_CELLS = 0.15, 2.5
_ROUNDING_M = 1e-6  # of a whole number of cells
# It must stand so deep in free space of the other map: its edge is where beams ended by chance.
_DEPTH_M, _DEPTH_CELLS = 0.12, 2.0
NEAR_M = 5.0  # farther off, half a degree and a slanting wall are more than that
_BESIDE_CELLS = 1.5  # what hangs together with it belongs to it when it is off by more than this
_LEAST_M, _LEAST_CELLS = 0.15, 5  # a hand's breadth and its noise; single cells flicker
_GAP_M = 0.2  # between pieces of one thing: its faces are seen, and some of these from aside


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    """Something that one map has and the other has not.

    `corners` (4, 2) are those of the smallest box round it, `centre` (2,) its middle, both in the
    map that has it; `length_m` and `width_m` the sides of the box, the longer first; `cells` how
    many cells of the map show it.
    """

    corners: FloatArray
    centre: FloatArray
    length_m: float
    width_m: float
    cells: int

    @property
    def area_m2(self) -> float:
        """Square metres of the box."""
        return self.length_m * self.width_m


@dataclass(frozen=True, slots=True)
class Surveyed:
    """The grid of a map, and the `track` (n, 2 or more) of the robot that saw it."""

    grid: GridMap
    track: FloatArray

    def saw_well(self, places: FloatArray) -> BoolArray:
        """(N,) whether the robot came near each place (N, 2): from afar it sees at a slant."""
        if not len(places) or not len(self.track):
            return np.zeros(len(places), dtype=np.bool_)
        away = cKDTree(self.track[:, :2]).query(places, distance_upper_bound=NEAR_M)[0]
        return np.asarray(np.isfinite(away))


def things_in(grid: GridMap, seen: Surveyed, other_from_grid: BentMotion) -> list[Thing]:
    """What stands in a map where another one saw free space, the largest first."""
    cells, other = np.argwhere(grid.occupied), seen.grid
    apart_m, depth_m = _distances(other)
    places = other_from_grid.apply(grid.centres_of(cells))
    placed = other.cells_of(places)
    inside = other.inside(placed)
    inside[inside] = seen.saw_well(places[inside])
    cells, (rows, columns) = cells[inside], placed[inside].T
    free = other.cells[rows, columns] == FREE
    apart = apart_m[rows, columns]
    sure = free & (apart > max(_APART_M, _APART_CELLS * other.resolution) + _ROUNDING_M)
    sure &= depth_m[rows, columns] > max(_DEPTH_M, _DEPTH_CELLS * other.resolution)
    beside = free & (apart > _BESIDE_CELLS * other.resolution)
    found = [_thing(grid, part) for part in _parts(grid, cells, sure, beside)]
    large = [thing for thing in found if thing.length_m >= _LEAST_M and thing.cells >= _LEAST_CELLS]
    return sorted(large, key=lambda thing: (-thing.length_m, *thing.centre.tolist()))


def _distances(grid: GridMap) -> tuple[FloatArray, FloatArray]:
    """(H, W) metres from each cell to the nearest obstacle, and to the nearest cell not free."""
    return grid.obstacle_distance(), grid.clearance()


def _parts(
    grid: GridMap, cells: NDArray[np.intp], sure: BoolArray, beside: BoolArray
) -> list[NDArray[np.intp]]:
    """The cells (N, 2) of each thing: those that are sure and what hangs together with them."""
    picture = np.zeros(grid.cells.shape, dtype=np.uint8)
    picture[tuple(cells[sure | beside].T)] = 1
    reach = max(1, round(0.5 * _GAP_M / grid.resolution))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    count, labels = cv2.connectedComponents(cv2.dilate(picture, kernel), connectivity=8)
    some = cells[sure | beside]
    of_cell = labels[tuple(some.T)]
    known = np.bincount(labels[tuple(cells[sure].T)], minlength=count)
    return [some[of_cell == k] for k in range(1, count) if known[k] >= _LEAST_CELLS]


def _thing(grid: GridMap, cells: NDArray[np.intp]) -> Thing:
    """The thing that some cells (N, 2) show."""
    points = grid.centres_of(cells)
    (x, y), sides, _ = box = cv2.minAreaRect(points.astype(np.float32))
    length, width = sorted((float(side) + grid.resolution for side in sides), reverse=True)
    return Thing(
        corners=np.asarray(cv2.boxPoints(box), dtype=np.float64),
        centre=np.array([x, y], dtype=np.float64),
        length_m=length,
        width_m=width,
        cells=len(cells),
    )


def walls_in_common(grid: GridMap, other: GridMap, other_from_grid: BentMotion) -> BoolArray:
    """(H, W) which obstacles of a map stand where the other one has some, too."""
    cells = np.argwhere(grid.cells == OCCUPIED)
    placed = other.cells_of(other_from_grid.apply(grid.centres_of(cells)))
    inside = other.inside(placed)
    near = np.zeros(len(cells), dtype=np.bool_)
    rows, columns = placed[inside].T
    reach_m = max(_APART_M, _APART_CELLS * other.resolution)
    near[inside] = other.obstacle_distance()[rows, columns] <= reach_m
    common = np.zeros(grid.cells.shape, dtype=np.bool_)
    common[tuple(cells[near].T)] = True
    return common

"""A line across a submap: how far it reaches, and on which side of it a place lies on foot."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, GridMap
from specmap_cli.topology.borders import Line
from specmap_cli.topology.flooding import beside, drawn, flood
from specmap_cli.topology.regions import NOBODY, Regions

_STEP = 0.5  # cells: no cell is passed over, but for its corner
_BESIDE = 2.0  # cells: so near to a line a place is on one side of it for sure
_LEFT, _RIGHT = 1, 2


def fence_of(mine: BoolArray, grid: GridMap, line: Line) -> Line | None:
    """The line from border to border of the cells `mine` (H, W); None where it crosses none.

    An end that lies in them is moved on until it does not; one outside stays.
    """
    if not (mine & drawn([line], grid)).any():
        return None
    start, end = np.array(line[0]), np.array(line[1])
    step = (end - start) / np.hypot(*(end - start)) * _STEP * grid.resolution
    return _moved_on(mine, grid, start, -step), _moved_on(mine, grid, end, step)


def is_right_of(fence: Line, mine: BoolArray, grid: GridMap, places: FloatArray) -> BoolArray:
    """(n,) whether each place (n, 2 or more) is right of a fence across the cells `mine` (H, W).

    A place is on the side from which one comes to it first on foot, without crossing the fence; one
    that is out of reach is on its side of the straight line.
    """
    barrier = drawn([fence], grid)
    along, across, length = beside(grid.centres_of(np.argwhere(mine)), fence)
    near = (np.abs(across) <= _BESIDE * grid.resolution) & (along >= 0.0) & (along <= length)
    markers = np.zeros(mine.shape, dtype=np.int32)
    markers[mine] = np.where(near, np.where(across < 0.0, _RIGHT, _LEFT), 0)
    markers[barrier] = 0
    sides = flood(mine, markers, barrier)
    sides[~mine | (sides < _LEFT)] = NOBODY
    found = Regions(grid, sides, {}).owners(places)
    along, across, _ = beside(places[:, :2], fence)
    close = (np.abs(across) <= _BESIDE * grid.resolution) & (along >= 0.0) & (along <= length)
    return np.where(close | (found == NOBODY), across < 0.0, found == _RIGHT)


def _moved_on(
    mine: BoolArray, grid: GridMap, place: FloatArray, step: FloatArray
) -> tuple[float, float]:
    """The first place of a way in equal steps that is not in the cells `mine`."""
    steps = round(2.0 * sum(mine.shape) / _STEP)  # beyond the edge of the grid
    way = place + step * np.arange(steps)[:, None]
    cells = grid.cells_of(way)
    inside = grid.inside(cells)
    held = np.zeros(len(way), dtype=np.bool_)
    held[inside] = mine[tuple(cells[inside].T)]
    x, y = way[int(np.argmin(held))].tolist()
    return x, y

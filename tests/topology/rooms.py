"""Rooms drawn in code, with the submap of each cell given by hand."""

import numpy as np

from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.topology.regions import NOBODY, Regions

CELL_M = 0.05
Box = tuple[float, float, float, float]  # x0, y0, x1, y1 in metres


def regions_of(
    size: tuple[float, float], rooms: dict[int, list[Box]], furniture: list[Box] | None = None
) -> Regions:
    """A solid block with rooms carved out of it, each of one submap; what lies over all is last."""
    shape = round(size[1] / CELL_M), round(size[0] / CELL_M)
    cells = np.full(shape, OCCUPIED, dtype=np.uint8)
    owner = np.full(shape, NOBODY, dtype=np.int64)
    for submap, boxes in rooms.items():
        for box in boxes:
            cells[_cells(box)], owner[_cells(box)] = FREE, submap
    for box in furniture or []:
        cells[_cells(box)], owner[_cells(box)] = OCCUPIED, NOBODY
    return Regions.of(GridMap(cells, CELL_M), owner)


def two_rooms(*doors: Box) -> Regions:
    """Room 0 of 5 x 6 m, room 1 of 4 x 6 m beside it, and doors through the wall of 0.2 m."""
    return regions_of((9.8, 6.6), {0: [(0.3, 0.3, 5.3, 6.3), *doors], 1: [(5.5, 0.3, 9.5, 6.3)]})


def _cells(box: Box) -> tuple[slice, slice]:
    x0, y0, x1, y1 = (round(value / CELL_M) for value in box)
    return slice(y0, y1), slice(x0, x1)

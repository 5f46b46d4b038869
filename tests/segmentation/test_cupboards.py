"""Furniture that stands at a wall."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.segmentation.furniture import fill_cupboards, pieces_at_walls
from specmap_cli.segmentation.visibility import LabelArray

CELL_M = 0.05


def two_rooms() -> CellArray:
    """Rooms of 4 x 3 m beside each other, walls of 0.15 m, unknown all around."""
    cells = np.full((100, 200), UNKNOWN, dtype=np.uint8)
    cells[17:83, 17:183] = OCCUPIED
    cells[20:80, 20:98] = FREE
    cells[20:80, 101:180] = FREE
    return cells


def labelled(cells: CellArray) -> LabelArray:
    labels = np.where(cells == FREE, 0, -1).astype(np.int32)
    labels[:, 100:][cells[:, 100:] == FREE] = 1
    return labels


def filled(cells: CellArray) -> LabelArray:
    pieces = pieces_at_walls(GridMap(cells, CELL_M), 0.4)
    return fill_cupboards(labelled(cells), pieces, CELL_M)


@pytest.mark.parametrize("inside", [OCCUPIED, UNKNOWN])
def test_a_cupboard_at_a_wall_belongs_to_its_room(inside: int) -> None:
    cells = two_rooms()
    cells[30:60, 86:98] = OCCUPIED  # at the wall between the rooms: the other one is near
    cells[31:59, 87:97] = inside
    assert (filled(cells)[31:59, 87:97] == 0).all()


@pytest.mark.parametrize(
    ("rows", "columns"),
    [
        ((50, 54), (20, 60)),  # a piece of wall into the room
        ((70, 83), (17, 183)),  # 0.65 m thick, longer than a row of cupboards
        ((20, 80), (95, 105)),  # between the rooms, 3 m long, 0.5 m thick
    ],
)
def test_walls_and_what_is_outside_get_no_label(
    rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    cells = two_rooms()
    cells[slice(*rows), slice(*columns)] = OCCUPIED
    np.testing.assert_array_equal(filled(cells), labelled(cells))

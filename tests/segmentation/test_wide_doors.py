"""Wide openings in the line of a wall, and furniture that stands at one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, CellArray, GridMap
from specmap_cli.segmentation.division import segment
from specmap_cli.segmentation.obstacles import fill_cupboards, pieces_at_walls, with_narrow_doors
from specmap_cli.segmentation.visibility import LabelArray
from tests.segmentation.plans import plan

CELL_M = 0.05
CORRIDOR = (0.3, 0.3, 11.7, 2.1)
OFFICES = ((0.3, 2.3, 4.0, 6.3), (4.2, 2.3, 7.8, 6.3), (8.0, 2.3, 11.7, 6.3))
OPENINGS = tuple((x, 2.1, x + 2.0, 2.3) for x in (1.0, 5.0, 9.0))


def narrowed(free: BoolArray, widest_m: float = 2.5) -> BoolArray:
    return with_narrow_doors(free, np.zeros_like(free), CELL_M, widest_m)[1]


def widths_at(free: BoolArray, y_m: float) -> list[float]:
    """The widths of the openings in the row of cells at a height."""
    ends = np.flatnonzero(np.diff(np.pad(free[round(y_m / CELL_M)], 1).astype(int)))
    return [round(length * CELL_M, 2) for length in np.diff(ends)[::2].tolist()]


def test_offices_that_stand_open_are_told_from_their_corridor() -> None:
    openings = ((x, 2.1, x + 2.2, 2.3) for x in (1.0, 5.0, 9.0))
    building = plan(12.0, 6.6, CORRIDOR, *OFFICES, *openings)
    assert segment(building, SegmentationConfig()).count == 4
    assert segment(building, SegmentationConfig(wide_door_m=0.0)).count != 4  # corridor in pieces


def test_an_opening_is_narrowed_to_a_door_and_a_door_stays() -> None:
    building = plan(12.0, 6.6, CORRIDOR, *OFFICES, *OPENINGS[:2], (9.0, 2.1, 9.8, 2.3))
    assert widths_at(narrowed(building.free), 2.2) == [0.8, 0.8, 0.8]
    assert widths_at(narrowed(building.free, 1.9), 2.2) == [2.0, 2.0, 0.8]
    # where the room behind begins at its side, the wall ends in a corner: the partition of rooms
    building = plan(12.0, 6.6, CORRIDOR, *OFFICES, (0.3, 2.1, 2.3, 2.3), (4.2, 2.1, 6.2, 2.3))
    assert widths_at(narrowed(building.free), 2.2)[1] == 0.8


def test_no_corridor_is_cut_where_partitions_on_both_sides_meet_it() -> None:
    below = [(x0, -y1 + 4.4 + 2.2, x1, -y0 + 4.4 + 2.2) for x0, y0, x1, y1 in OFFICES]
    above = [(x0, y0 + 4.2, x1, y1 + 4.2) for x0, y0, x1, y1 in OFFICES]
    corridor = (0.3, 4.5, 11.7, 6.3)
    doors = [(x, y, x + 0.8, y + 0.2) for x in (2.8, 4.4, 6.6, 8.2) for y in (4.3, 6.3)]
    building = plan(12.0, 10.8, corridor, *below, *above, *doors)
    np.testing.assert_array_equal(narrowed(building.free), building.free)


@pytest.mark.parametrize(
    ("left", "right", "is_opening"),
    [
        (np.s_[28:32, :40], np.s_[28:32, 80:], True),
        (np.s_[28:32, :40], np.s_[28:, 80:], True),  # a wall opposite a corner
        (np.s_[28:32, :40], np.s_[:, 80:], False),  # opposite the middle of another
        (np.s_[19:41, :40], np.s_[19:41, 80:], False),  # 1.1 m thick
        (np.s_[28:32, 32:40], np.s_[28:32, 80:88], False),  # pieces of 0.4 m
    ],
)
def test_an_opening_lies_between_a_thin_wall_and_the_end_of_another(
    left: tuple[slice, slice], right: tuple[slice, slice], is_opening: bool
) -> None:
    free = np.ones((60, 120), dtype=bool)
    free[left] = free[right] = False
    found = narrowed(free)
    assert (widths_at(found[:, 40:80], 1.5) == [0.8]) == is_opening
    assert (found == free).all() != is_opening


def test_a_slanted_wall_points_at_nothing() -> None:
    rows, columns = np.mgrid[:160, :160]
    free = np.abs(columns - 0.5 * rows - 20) > 4  # a wall at an angle, ends at both sides
    free[(rows > 60) & (rows < 100) & (np.abs(columns - 0.5 * rows - 20) <= 4)] = True
    free[:, 120:124] = False
    np.testing.assert_array_equal(narrowed(free), free)


def test_a_post_in_the_line_of_a_wall_is_no_furniture() -> None:
    free = plan(12.0, 6.6, CORRIDOR, *OFFICES[:2], (8.0, 2.3, 11.7, 6.3), *OPENINGS).free.copy()
    free[42:46, 100:136] = True  # from 5 m to 6.8 m: two doors with a post between
    free[43:46, 116:120] = False
    small = np.zeros_like(free)
    small[43:46, 116:120] = True
    small[80:84, 116:120] = True  # a chair in the office
    opened, found = with_narrow_doors(free & ~small, small, CELL_M, 2.5)
    assert widths_at(opened, 2.2) == [2.0, 0.8, 1.0, 2.0]
    assert widths_at(found, 2.2) == [0.8, 0.8, 0.8, 0.8]
    assert opened[80:84, 116:120].all()
    # a table that is as wide is none
    small[40:70, 116:120] = True
    assert with_narrow_doors(free & ~small, small, CELL_M, 2.5)[0][small].all()


def test_beside_a_cupboard_at_a_wall_nothing_is_narrowed() -> None:
    """It is as thin as a wall, with the wall; the space beside it lies along the wall."""
    free = plan(12.0, 6.6, CORRIDOR, (4.2, 2.2, 7.8, 6.3), (5.0, 2.1, 5.8, 2.2)).free.copy()
    free[44:50, 132:156] = False  # from 6.6 m to the wall, 0.3 m deep
    np.testing.assert_array_equal(narrowed(free), free)


def test_holes_in_the_middle_of_a_wall_leave_it_in_line() -> None:
    free = plan(12.0, 6.6, CORRIDOR, *OFFICES, *OPENINGS).free.copy()
    free[43:45, ::3] = True  # the wall along the corridor is in rows 42 to 45
    assert widths_at(narrowed(free), 2.1) == widths_at(narrowed(free), 2.25) == [0.8, 0.8, 0.8]


def test_a_door_leaf_behind_the_wall_of_a_corridor_cuts_no_corridor() -> None:
    free = np.zeros((150, 120), dtype=bool)
    free[10:50, 5:115] = free[52:92, 5:115] = free[94:140, 5:115] = True  # the middle: a corridor
    free[92:94, 30:60] = free[50:52, 30:60] = True  # doors of two rooms, one opposite the other
    free[94:110, 60:62] = free[91, 60:62] = False  # a leaf, and a frame that stands out
    np.testing.assert_array_equal(narrowed(free)[55:88], free[55:88])


@given(seed=st.integers(0, 10_000))
def test_a_map_that_is_turned_has_the_same_openings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = np.ones((60, 70), dtype=bool)
    for row, column, height, width in rng.integers(2, 30, (6, 4)):
        free[row : row + min(height, 4), column : column + width] = False
    upright = narrowed(free)
    np.testing.assert_array_equal(np.rot90(narrowed(np.rot90(free)), -1), upright)
    assert not (upright & ~free).any()


def walled() -> CellArray:
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
    return fill_cupboards(labelled(cells), pieces_at_walls(GridMap(cells, CELL_M), 0.4), CELL_M)


@pytest.mark.parametrize("inside", [OCCUPIED, UNKNOWN])
def test_a_cupboard_at_a_wall_belongs_to_its_room(inside: int) -> None:
    cells = walled()
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
def test_walls_and_outside_get_no_label(rows: tuple[int, int], columns: tuple[int, int]) -> None:
    cells = walled()
    cells[slice(*rows), slice(*columns)] = OCCUPIED
    np.testing.assert_array_equal(filled(cells), labelled(cells))

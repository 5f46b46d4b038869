"""The division of a map: properties of any map, plans of known answers, and rings of corridors."""

import itertools
import math
import os
from dataclasses import astuple
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from sklearn.metrics import adjusted_rand_score

from specmap_cli.core.config import load_config
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.segmentation.division import (
    driven,
    open_rings,
    region_grid,
    regions_of,
    segment,
    segment_floorplan,
)
from specmap_cli.segmentation.visibility import LabelArray
from specmap_cli.segmentation.working_grid import upright_map, wall_angle
from tests.segmentation.plans import OFFICE, TWO_ROOMS, plan, same_parts, turned_by
from tests.strategies import few, grid_maps

DEFAULT = SegmentationConfig()
PAPER = load_config(preset="paper").segmentation
# a hall of 40 m x 30 m and a room beside it
HALL = plan(45.6, 30.6, (0.3, 0.3, 40.3, 30.3), (40.5, 0.3, 45.3, 15.3), (40.3, 6.0, 40.5, 6.9))


def test_an_office_becomes_its_rooms_and_its_corridor() -> None:
    found = segment(OFFICE, DEFAULT)
    assert found.count == 7
    core = cv2.erode(OFFICE.free.astype(np.uint8), np.ones((21, 21), dtype=np.uint8))
    truth = cv2.connectedComponents(core)[1] - 1  # the doors are closed
    both = (truth >= 0) & (found.labels >= 0)
    assert adjusted_rand_score(truth[both], found.labels[both]) > 0.99


@pytest.mark.parametrize("size", [(1.0, 1.0), (3.0, 4.0), (30.0, 2.0), (25.0, 18.0), (60.0, 45.0)])
def test_a_convex_room_of_any_size_stays_one(size: tuple[float, float]) -> None:
    width, height = size
    grid = plan(width + 0.6, height + 0.6, (0.3, 0.3, 0.3 + width, 0.3 + height))
    assert segment(grid, DEFAULT).count == 1


@pytest.mark.parametrize(("side", "count"), [(1.3, 1), (1.5, 2)])
def test_an_alcove_is_of_its_room_and_a_closet_above_2_m2_is_not(side: float, count: int) -> None:
    rooms = (0.3, 0.3, 5.3, 4.3), (5.5, 0.3, 5.5 + side, 0.3 + side)
    grid = plan(8.0, 4.6, *rooms, (5.3, 0.4, 5.5, 1.2))
    assert segment(grid, DEFAULT).count == count
    assert segment(grid, DEFAULT.model_copy(update={"merge": False})).count == 2


def test_a_round_hall_stays_one() -> None:
    cells = np.full((420, 420), OCCUPIED, dtype=np.uint8)
    cv2.circle(cells, (210, 210), 200, FREE, cv2.FILLED)
    assert segment(GridMap(cells, 0.05), DEFAULT).count == 1


@pytest.mark.parametrize("config", [DEFAULT, PAPER], ids=["default", "paper"])
@pytest.mark.parametrize(("turn", "up", "right"), [(0, 9, 3), (1, 0, 17), (2, 4, 1), (3, 6, 0)])
def test_turning_and_shifting_the_map_moves_the_labels(
    turn: int, up: int, right: int, config: SegmentationConfig
) -> None:
    moved = np.pad(np.rot90(OFFICE.cells, turn), ((up, 3), (right, 5)), constant_values=OCCUPIED)
    labels = segment(GridMap(moved, OFFICE.resolution), config).labels[up:-3, right:-5]
    assert same_parts(np.rot90(labels, -turn), segment(OFFICE, config).labels)


@pytest.mark.parametrize("factor", [2.0, 0.5, 3.0])
def test_scaling_resolution_and_lengths_together_changes_nothing(factor: float) -> None:
    lengths = ("cell_m", "obstacle_m", "node_step_m", "clearance_m", "sight_m")
    usual = DEFAULT.model_copy(update={"wide_door_m": 0.0})  # a door is as wide as a person needs
    scaled = usual.model_copy(update={name: getattr(usual, name) * factor for name in lengths})
    larger = GridMap(OFFICE.cells, OFFICE.resolution * factor)
    np.testing.assert_array_equal(segment(larger, scaled).labels, segment(OFFICE, usual).labels)


@pytest.mark.parametrize("config", [DEFAULT, PAPER], ids=["default", "paper"])
def test_every_free_cell_reachable_from_a_node_is_labelled(config: SegmentationConfig) -> None:
    cells = OFFICE.cells.copy()
    cells[np.random.default_rng(3).random(cells.shape) < 0.002] = OCCUPIED
    cells[40:44, 100:104] = FREE  # a pocket in a wall, and a slit into it of one cell
    found = segment(GridMap(cells, OFFICE.resolution), config)
    _, piece = cv2.connectedComponents((cells == FREE).astype(np.uint8), connectivity=4)
    nodes = OFFICE.cells_of(found.nodes)
    reached = np.unique(piece[nodes[:, 0], nodes[:, 1]])
    inside = np.isin(piece, reached[reached > 0])
    assert inside.any()
    assert (found.labels[inside] >= 0).all()


def test_chairs_do_not_split_a_room_and_are_filled() -> None:
    grid = plan(6.6, 6.6, (0.3, 0.3, 6.3, 6.3))
    cells = grid.cells.copy()
    for row in range(20, 110, 18):
        for column in range(60, 70, 8):
            cells[row : row + 8, column : column + 4] = OCCUPIED
    cluttered = GridMap(cells, 0.05)
    filled = segment(cluttered, DEFAULT)
    assert filled.count == 1
    np.testing.assert_array_equal(filled.labels >= 0, grid.free)
    bare = segment(cluttered, DEFAULT.model_copy(update={"fill": False}))
    np.testing.assert_array_equal(bare.labels >= 0, cluttered.free)


def test_the_paper_preset_uses_only_the_paper() -> None:
    found = segment(OFFICE, PAPER)
    assert found.count >= 5
    assert (found.spectrum.eigenvalues[: found.spectrum.used] > PAPER.eigenvalue_min).all()
    cells = np.argwhere(found.labels >= 0)[::97]
    points = OFFICE.centres_of(cells)
    distance = np.hypot(*(points[:, None] - found.nodes[None]).transpose(2, 0, 1))
    nearest = np.sort(distance, axis=1)
    clear = nearest[:, 1] - nearest[:, 0] > 2 * PAPER.cell_m  # ties within a working cell aside
    expected = found.node_labels[distance.argmin(axis=1)]
    np.testing.assert_array_equal(found.labels[cells[:, 0], cells[:, 1]][clear], expected[clear])


def test_nodes_keep_clear_of_walls_see_each_other_and_lie_in_their_region() -> None:
    turned = GridMap(np.ascontiguousarray(np.rot90(OFFICE.cells)), OFFICE.resolution)
    found = segment(turned, DEFAULT)
    clearance = turned.clearance()
    cells = turned.cells_of(found.nodes)
    least = DEFAULT.clearance_m - 0.5 * DEFAULT.cell_m  # a node is the middle of a coarse cell
    assert (clearance[cells[:, 0], cells[:, 1]] > least).all()
    np.testing.assert_array_equal(found.labels[cells[:, 0], cells[:, 1]], found.node_labels)
    one, other = found.nodes[found.pairs[:, 0]], found.nodes[found.pairs[:, 1]]
    assert np.hypot(*(one - other).T).max() <= DEFAULT.sight_m + 1e-6
    for share in np.linspace(0.0, 1.0, 40):
        assert (turned.values_at(one + share * (other - one)) == FREE).all()


@pytest.mark.parametrize("offset", [1, 2, 6, 9])
def test_a_wall_of_one_fine_cell_keeps_two_rooms_apart(offset: int) -> None:
    wall = 400 + offset
    cells = np.full((250, 804), OCCUPIED, dtype=np.uint8)  # cells of 1 cm, ten a working cell
    cells[5:245, 5:799] = FREE
    cells[:, wall] = OCCUPIED
    found = segment(GridMap(cells, 0.01), DEFAULT)
    left, right = found.labels[5:245, 5:wall], found.labels[5:245, wall + 1 : 799]
    assert (len(np.unique(left)), len(np.unique(right))) == (1, 1)
    assert min(left[0, 0], right[0, 0]) >= 0
    assert left[0, 0] != right[0, 0]


def test_a_long_hall_is_cut_by_the_sight_and_joined_again() -> None:
    hall = plan(40.6, 3.6, (0.3, 0.3, 40.3, 3.3))
    assert segment(hall, DEFAULT).count == 1
    assert segment(hall, DEFAULT.model_copy(update={"merge": False})).count >= 4


@pytest.mark.parametrize("placements", [1, 3])
def test_a_large_map_is_divided_alike_in_one_process_and_in_two(
    placements: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = DEFAULT.model_copy(update={"placements": placements, "merge": False})
    monkeypatch.delenv("SPECMAP_PROCESSES", raising=False)
    found = []
    for processors in ({0}, {0, 1}):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, those=processors: those)
        with patch.object(os, "fork", wraps=os.fork) as fork:
            found.append(segment(HALL, config))
        assert fork.called == (len(processors) > 1)
    for one, other in zip(*map(astuple, found), strict=True):
        np.testing.assert_equal(one, other)


def test_the_middle_of_an_open_hall_needs_no_nodes() -> None:
    """No obstacle is in sight there."""
    found, grid = segment(HALL, DEFAULT), HALL
    assert np.unique(found.labels[6:606, 6:806]).tolist() == [0]
    assert np.unique(found.labels[6:306, 810:906]).tolist() == [1]
    assert grid.clearance()[tuple(grid.cells_of(found.nodes).T)].max() <= DEFAULT.sight_m
    few_nodes = DEFAULT.model_copy(update={"node_step_m": 10.0, "placements": 1})
    assert segment(plan(20.6, 20.6, (0.3, 0.3, 20.3, 20.3)), few_nodes).count == 1  # some are left


def drive(xs: np.ndarray) -> np.ndarray:
    """Through the door of `TWO_ROOMS`, which is at x = 5.4 m."""
    return np.column_stack([xs, np.full(len(xs), 1.95), np.zeros(len(xs))])


def test_keyframes_change_region_in_the_door_and_beyond_the_map_are_in_that_of_its_edge() -> None:
    poses = drive(np.concatenate([np.linspace(1.0, 8.0, 71), [-3.0, 12.0]]))
    labels = regions_of(TWO_ROOMS, segment(TWO_ROOMS, DEFAULT).labels, poses, 0.0)
    (change,) = np.flatnonzero(np.diff(labels[:71]))
    assert 5.1 < poses[change, 0] < 5.7
    assert labels[71:].tolist() == [labels[0], labels[70]]
    assert labels.dtype == np.int64
    nothing = GridMap(np.full((20, 20), UNKNOWN, dtype=np.uint8), 0.05)
    none = segment(nothing, DEFAULT).labels
    assert regions_of(nothing, none, poses[:5], 1.0).tolist() == [0] * 5
    assert driven(nothing, none, poses[:5]) == []


def test_a_room_without_a_keyframe_is_not_entered() -> None:
    division = segment(TWO_ROOMS, DEFAULT).labels
    first, second = drive(np.linspace(1.0, 4.0, 20)), drive(np.linspace(1.0, 8.0, 71))
    mine = division[tuple(TWO_ROOMS.cells_of(first[:1, :2])[0])]
    ((window, cells),) = driven(TWO_ROOMS, division, first)
    np.testing.assert_array_equal(cells, division[window] == mine)
    assert cells.sum() == (division == mine).sum()
    both = driven(TWO_ROOMS, division, second)
    assert sum(int(cells.sum()) for _, cells in both) == (division >= 0).sum()


def without_grazed(labels: list[int], poses: np.ndarray, way_m: float) -> list[int]:
    """The rule written out: short regions go to the one before, the first ones to the one after."""
    way = dict.fromkeys(labels, 0.0)
    for k in range(1, len(labels)):
        way[labels[k]] += float(np.hypot(*(poses[k, :2] - poses[k - 1, :2])))
    kept = [label for label in labels if way[label] >= way_m]
    result, last = [], kept[0] if kept else max(way, key=lambda name: (labels.count(name), -name))
    for label in labels:
        last = label if label in kept else last
        result.append(last)
    return result


@given(seed=st.integers(0, 10_000), way_m=st.sampled_from([0.5, 1.5, 4.0, 1e3]))
@few(8)
def test_regions_hardly_driven_through_go_to_the_one_before(seed: int, way_m: float) -> None:
    rng = np.random.default_rng(seed)
    stops = np.concatenate([[rng.uniform(0.6, 9.0)], rng.uniform(4.3, 6.8, 4)])
    poses = drive(np.concatenate([np.linspace(a, b, 15) for a, b in itertools.pairwise(stops)]))
    division = segment(TWO_ROOMS, DEFAULT).labels
    every, found = (regions_of(TWO_ROOMS, division, poses, least_m) for least_m in (0.0, way_m))
    assert found.tolist() == without_grazed(every.tolist(), poses, way_m)


def test_the_grids_of_all_regions_show_all_that_is_labelled_where_it_lies() -> None:
    moved = GridMap(OFFICE.cells, OFFICE.resolution, (-3.0, 7.0))
    found = segment_floorplan(moved, DEFAULT)
    assert found.count == 7
    labelled = moved.centres_of(np.argwhere((found.labels >= 0) & moved.free))
    seen = np.zeros(len(labelled), dtype=int)
    for number in range(found.count):
        region = found.labels == number
        assert ndimage.label(region, np.ones((3, 3)))[1] == 1
        grid = region_grid(moved, region)
        seen += grid.values_at(labelled) == FREE
        walls = grid.centres_of(np.argwhere(grid.occupied))
        assert (moved.values_at(walls) == OCCUPIED).all()
        places = moved.centres_of(np.argwhere(region))
        assert (walls >= places.min(axis=0) - 0.11).all()  # no more than two cells of wall round it
        assert (walls <= places.max(axis=0) + 0.11).all()
    assert (seen == 1).all()


def test_of_a_region_in_scraps_the_largest_stays() -> None:
    closet = (7.5, 2.75, 8.0, 3.25)  # too small for a node
    grid, nearest = plan(8.5, 6, (0.5, 0.5, 5.5, 5.5), closet), SegmentationConfig(labels="nearest")
    assert (segment(grid, nearest).labels[:, 120:] == 0).any()
    found = segment_floorplan(grid, nearest)
    assert found.count == 1
    np.testing.assert_array_equal(np.argwhere(found.labels == 0), np.argwhere(grid.free[:, :120]))


@given(
    grid_maps(largest=12),
    st.integers(0, 3),
    st.tuples(*[st.integers(0, 5)] * 4),
    st.sampled_from([0.05, 0.1, 0.15]),
)
def test_every_copy_of_a_map_looks_the_same_and_labels_and_nodes_go_back(
    grid: GridMap, turned: int, frame: tuple[int, int, int, int], cell_m: float
) -> None:
    large = np.kron(grid.cells, np.ones((5, 5), dtype=np.uint8))
    around = np.pad(np.rot90(large, turned), (frame[:2], frame[2:]), constant_values=UNKNOWN)
    copies = [GridMap(cells, 0.05, (-1.0, 2.0)) for cells in (large, around)]
    one, other = (upright_map(copy, cell_m, 0.35) for copy in copies)
    np.testing.assert_array_equal(one.grid.cells, other.grid.cells)
    numbers = np.arange(one.grid.cells.size, dtype=np.int32).reshape(one.grid.cells.shape)
    for copy, upright in zip(copies, (one, other), strict=True):
        labels = upright.cells_in(copy, numbers, -1)
        assert (labels[copy.free] >= 0).all()
        shown = np.argwhere(copy.free)
        low, high = (shown.min(axis=0), shown.max(axis=0)) if len(shown) else (1, 0)
        cells = np.argwhere(labels >= 0)
        assert ((cells >= low) & (cells <= high)).all()  # there is nothing beyond the free cells
        places = upright.places(copy, np.argwhere(numbers >= 0))[labels[tuple(cells.T)]]
        tolerance = 0.75 * cell_m * (1 + (upright.tilt is not None))  # half a diagonal, each way
        assert np.linalg.norm(places - copy.centres_of(cells), axis=1).max(initial=0) <= tolerance


@given(st.integers(0, 3))
def test_the_free_space_lies_and_leans_whatever_single_cells_say(turned: int) -> None:
    free = np.zeros((40, 90), dtype=bool)
    free[5:35, 5:35] = free[15:24, 35:81] = True  # a room, and a corridor to the right of it
    ray = free.copy()
    ray[20, 81:90] = ray[0:5, 10] = True  # glimpses through a door and a window
    for picture in (free, ray):
        cells = np.where(np.rot90(picture, turned), FREE, UNKNOWN).astype(np.uint8)
        assert upright_map(GridMap(cells, 0.05), 0.05, 0.7).turns == -turned % 4


@pytest.mark.parametrize("degrees", [0, 7, -31])
@pytest.mark.parametrize("cell_m", [0.05, 0.15])
def test_the_middle_of_the_free_space_is_the_corner_of_a_block(degrees: int, cell_m: float) -> None:
    upright = upright_map(turned_by(degrees, OFFICE), cell_m, 0.7)
    assert (upright.tilt is not None) == (degrees != 0)
    inner = ndimage.binary_erosion(upright.grid.free, np.ones((5, 5)))
    off = np.argwhere(inner).mean(axis=0) + 2.0  # how walls are sampled moves it by a cell
    assert (off % upright.block < 4.0).all()


@pytest.mark.parametrize("degrees", [20.0, -33.0, 45.0, 70.0])
def test_a_map_turned_by_any_angle_has_its_rooms_again(degrees: float) -> None:
    plain = segment(OFFICE, DEFAULT).labels
    truth = turned_by(degrees, GridMap((plain + 3).astype(np.uint8), 0.05)).cells.astype(int) - 3
    found = segment(turned_by(degrees, OFFICE), DEFAULT)
    both = (truth >= 0) & (found.labels >= 0)
    shared = np.zeros((7, found.count))
    np.add.at(shared, (truth[both], found.labels[both]), 1.0)
    union = shared.sum(axis=0) + shared.sum(axis=1)[:, None] - shared
    assert found.count == 7
    assert (shared / union).max(axis=1).min() > 0.97


@given(st.floats(-44.0, 44.0))
def test_the_angle_of_walls_is_that_at_which_they_were_drawn(degrees: float) -> None:
    picture = (np.random.default_rng(0).random((300, 300)) < 0.01).astype(np.uint8)  # and noise
    corners = cv2.boxPoints(((150.0, 150.0), (200.0, 120.0), degrees))
    cv2.polylines(picture, [corners.astype(np.int32)], isClosed=True, color=(1,))
    assert abs(wall_angle(np.argwhere(picture)) - degrees) < 0.6
    assert wall_angle(np.zeros((0, 2), dtype=np.intp)) == 0.0
    assert wall_angle(np.array([[3, 4]])) == 0.0


def test_what_a_laser_only_saw_is_in_no_room() -> None:
    """Through a window, between two boards, and through a slit that no robot passes."""
    rooms = ((0.5, 4, 13.5, 5.6), (0.5, 0.5, 5, 3.8), (5.2, 0.5, 9.2, 3.8), (9.4, 0.5, 13.5, 3.8))
    beyond = (0.4, 6.3, 2.3, 8.5)  # a room that one sees through the window alone
    cells = np.full((210, 290), UNKNOWN, dtype=np.uint8)
    corners = np.array([[4, 5.8], [5, 5.8], [8, 9.5], [1, 9.5]])
    cv2.fillPoly(cells, [(20 * corners).astype(np.int32)], color=(FREE,))
    inner = (*rooms, beyond)
    walls = [(OCCUPIED, (x - 0.2, y - 0.2, x1 + 0.2, y1 + 0.2)) for x, y, x1, y1 in inner]
    doors = [(2.3, 7, 3.3, 7.9), (2, 3.8, 2.9, 4), (6, 3.8, 6.9, 4)]
    open_ = [*inner, *doors, (4, 5.6, 5, 5.8), (11, 3.8, 11.3, 4)]  # a window, a slit
    rays = [(x, 5.6, x + 0.05, 9) for x in (10, 10.2, 10.4)]
    half = (7.4, 0.3, 9.2, 3.8)  # of a room
    for value, (x, y, x1, y1) in (*walls, *((FREE, one) for one in open_ + rays), (UNKNOWN, half)):
        cells[round(20 * y) : round(20 * y1), round(20 * x) : round(20 * x1)] = value
    grid = GridMap(cells, 0.05)
    every, found = segment(grid, DEFAULT), segment(grid, DEFAULT, rooms=True)
    assert (every.count, found.count) == (6, 3)
    assert (every.labels[grid.free] >= 0).all()
    corridor, first, second, behind, fan, far, ray = (
        found.labels[20 * y + 10, 20 * x + 2]
        for x, y in ((7, 4), (3, 2), (6, 2), (11, 2), (5, 8), (1, 7), (10, 7))
    )
    assert len({corridor, first, second, -1}) == 4
    assert (behind, fan, far, ray) == (-1, -1, -1, -1)
    assert set(np.unique(found.node_labels)) == {-1, corridor, first, second}
    for label, area_m2 in ((corridor, 13 * 1.6), (first, 4.5 * 3.3), (second, 2.2 * 3.3)):
        assert np.count_nonzero(found.labels == label) * 0.05**2 == pytest.approx(area_m2, abs=0.7)


def test_rooms_of_a_drawing_stay_without_a_door_and_without_a_wall() -> None:
    flats = plan(
        *(20.2, 9.6, (0.3, 0.3, 5.3, 4.3), (5.5, 0.3, 9.5, 4.3), (5.3, 1.5, 5.5, 2.4)),
        *((10.5, 0.3, 14.5, 4.3), (14.7, 0.3, 18.7, 4.3), (14.5, 1.5, 14.7, 2.4)),  # another flat
        (0.3, 5.3, 5.3, 9.3),
    )
    assert segment_floorplan(flats, DEFAULT).count == 5
    bare = GridMap(np.where(OFFICE.free, FREE, UNKNOWN).astype(np.uint8), 0.05)
    found = segment(bare, DEFAULT, rooms=True)
    np.testing.assert_array_equal(found.labels, segment(OFFICE, DEFAULT).labels)


TURNS = (0.0, 20.0, 45.0, 90.0)


def without_rings(labels: LabelArray) -> LabelArray:
    """The same regions, those that are rings opened."""
    found = labels.copy()
    open_rings(found)
    return found


def ring(width: float, height: float) -> GridMap:
    """A corridor round a solid core; it begins at (5, 5)."""
    wide = 1.6
    right, top = 5.0 + width + 2 * wide, 5.0 + height + 2 * wide
    return plan(
        *(right + 5.0, top + 5.0),
        *((5.0, 5.0, right, 5.0 + wide), (5.0, top - wide, right, top)),
        *((5.0, 5.0, 5.0 + wide, top), (right - wide, 5.0, right, top)),
    )


def hall(width: float, height: float, side: float, *pillars: tuple[float, float]) -> GridMap:
    """One room from (0.5, 0.5) on, with square pillars that begin at the places given."""
    grid = plan(width + 1.0, height + 1.0, (0.5, 0.5, width + 0.5, height + 0.5))
    for x, y in pillars:
        rows, columns = (slice(round(n / 0.05), round((n + side) / 0.05)) for n in (y, x))
        grid.cells[rows, columns] = OCCUPIED
    return grid


def divided(grid: GridMap, degrees: float, places: list[tuple[float, float]]) -> list[int]:
    """The number of regions of a map that lies turned, and which ones hold places in metres."""
    turned = turned_by(degrees, grid)
    found = segment(turned, SegmentationConfig())
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    middles = [np.array(one.cells.shape[::-1]) / 2 for one in (grid, turned)]
    at = np.array(places) / 0.05 - middles[0]
    at = at @ np.array([[cosine, -sine], [sine, cosine]]) + middles[1]
    return [found.count, *(int(found.labels[round(y), round(x)]) for x, y in at.tolist())]


@pytest.mark.parametrize("degrees", TURNS)
@pytest.mark.parametrize(("width", "height"), [(12.0, 8.0), (8.0, 12.0), (30.0, 24.0)])
def test_the_long_sides_of_a_ring_have_corners(width: float, height: float, degrees: float) -> None:
    x, y = ((5.8, side / 2 + 6.6, side + 7.4) for side in (width, height))
    sides = [(x[1], y[0]), (x[1], y[2]), (x[0], y[1]), (x[2], y[1])]
    corners = [(x[0], y[0]), (x[2], y[0]), (x[0], y[2]), (x[2], y[2])]
    count, low, high, left, right, *found = divided(ring(width, height), degrees, sides + corners)
    assert count == 4
    assert len({low, high, left, right}) == 4
    assert found == ([low, low, high, high] if width > height else [left, right, left, right])


@pytest.mark.parametrize("degrees", TURNS[:3])
@pytest.mark.parametrize(
    "grid",
    [
        hall(14.0, 10.0, 1.0, *((x, y) for x in (3.0, 6.5, 10.0) for y in (3.0, 7.0))),
        hall(12.0, 12.0, 3.0, (5.0, 5.0)),
        hall(8.0, 7.0, 2.6, (3.2, 2.7)),
        ring(4.2, 4.2),
        plan(20.0, 16.0, (1, 1, 19, 3), (1, 1, 3, 15), (17, 1, 19, 15)),  # open at one side
    ],
    ids=["pillars", "core", "island", "lobby", "horseshoe"],
)
def test_halls_round_little_and_open_corridors_stay_whole(grid: GridMap, degrees: float) -> None:
    assert divided(grid, degrees, [(1.5, 1.5)])[0] == 1


def test_corridors_round_two_courts_are_seven() -> None:
    cross = [(1, 1, 33, 3), (1, 17, 33, 19), (1, 1, 3, 19), (31, 1, 33, 19), (16, 1, 18, 19)]
    assert segment(plan(34.0, 20.0, *cross), SegmentationConfig()).count == 7


def around(core: int, wide: int) -> LabelArray:
    """Cells of a region round a square, in the middle of some that have no label."""
    labels = np.full((core + 2 * wide + 20, core + 2 * wide + 60), -1, dtype=np.int32)
    labels[10:-10, 10 : core + 2 * wide + 10] = 0
    labels[10 + wide : -10 - wide, 10 + wide : core + wide + 10] = -1
    return labels


def test_a_ring_goes_round_more_than_it_holds() -> None:
    assert len(np.unique(without_rings(around(48, 10)))) == 2  # 68^2 with the floor, 2 x 48^2
    assert len(np.unique(without_rings(around(49, 10)))) == 5


def test_no_cell_is_lost_and_what_lies_beside_a_ring_keeps_its_label() -> None:
    labels = around(60, 10)
    labels[0:5, 0:5] = 1  # another region
    labels[45:50, 95:99] = 0  # a scrap of the ring
    found = without_rings(labels)
    np.testing.assert_array_equal(found < 0, labels < 0)
    assert (found[0:5, 0:5] == 1).all()
    assert (found[45:50, 95:99] == 0).all()
    assert np.unique(found).tolist() == [-1, 0, 1, 2, 3, 4]
    sizes = np.sort(np.bincount(found[10:90, 10:90][labels[10:90, 10:90] == 0]))[1:]
    np.testing.assert_allclose(sizes, [600, 600, 800, 800], atol=20)  # a cut is one cell wide


def test_corridors_that_go_on_and_pillars_move_no_cut() -> None:
    plain = around(60, 10)
    expected = without_rings(plain)
    more = plain.copy()
    more[10:22, 90:] = 0  # a corridor goes on, wider by two cells than the ring is
    more[14:18, 12:17] = -1  # a pillar in a corner
    more[26:29, 12:17] = -1  # and one below it
    found = without_rings(more)
    ours = (plain >= 0) & (more >= 0)
    pairs = np.unique(found[ours] * 10 + expected[ours], return_counts=True)[1]
    assert np.sort(pairs)[-4:].sum() >= ours.sum() - 4 * 10  # cells of the cuts

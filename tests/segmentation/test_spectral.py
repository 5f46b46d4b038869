"""The division of a map: properties it must have on any map, and plans with a known answer."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from sklearn.metrics import adjusted_rand_score

from specmap_cli.core.config import load_config
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, GridMap
from specmap_cli.segmentation.division import region_grid, regions_of, segment, segment_floorplan
from specmap_cli.segmentation.working_grid import canonical
from tests.segmentation.plans import OFFICE, TWO_ROOMS, plan, same_parts
from tests.strategies import few, seeds

DEFAULT = SegmentationConfig()
PAPER = load_config(preset="paper").segmentation


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


def test_a_round_hall_stays_one() -> None:
    cells = np.full((420, 420), OCCUPIED, dtype=np.uint8)
    cv2.circle(cells, (210, 210), 200, FREE, cv2.FILLED)
    assert segment(GridMap(cells, 0.05), DEFAULT).count == 1


@pytest.mark.parametrize("config", [DEFAULT, PAPER], ids=["default", "paper"])
@pytest.mark.parametrize("turn", [1, 2, 3])
def test_turning_the_map_turns_the_labels(turn: int, config: SegmentationConfig) -> None:
    turned = GridMap(np.ascontiguousarray(np.rot90(OFFICE.cells, turn)), OFFICE.resolution)
    labels = segment(turned, config).labels
    assert same_parts(np.rot90(labels, -turn), segment(OFFICE, config).labels)


@given(up=st.integers(0, 17), right=st.integers(0, 17))
@few(8)
def test_shifting_the_map_shifts_the_labels(up: int, right: int) -> None:
    cells = np.full((110, 190), OCCUPIED, dtype=np.uint8)
    cells[6:86, 6:106] = cells[6:86, 110:180] = cells[30:48, 106:110] = FREE
    shifted = np.pad(cells, ((up, 3), (right, 5)), constant_values=OCCUPIED)
    labels = segment(GridMap(shifted, 0.05), DEFAULT).labels
    inner = labels[up : up + 110, right : right + 190]
    np.testing.assert_array_equal(inner, segment(GridMap(cells, 0.05), DEFAULT).labels)


LENGTHS = ("cell_m", "obstacle_m", "node_step_m", "clearance_m", "sight_m")


@pytest.mark.parametrize("factor", [2.0, 0.1, 3.0])
def test_scaling_resolution_and_lengths_together_changes_nothing(factor: float) -> None:
    usual = DEFAULT.model_copy(update={"wide_door_m": 0.0})  # a door is as wide as a person needs
    scaled = usual.model_copy(update={name: getattr(usual, name) * factor for name in LENGTHS})
    larger = GridMap(OFFICE.cells, OFFICE.resolution * factor)
    np.testing.assert_array_equal(segment(larger, scaled).labels, segment(OFFICE, usual).labels)


@pytest.mark.parametrize("config", [DEFAULT, PAPER], ids=["default", "paper"])
def test_every_free_cell_reachable_from_a_node_is_labelled(config: SegmentationConfig) -> None:
    cells = OFFICE.cells.copy()
    rng = np.random.default_rng(3)
    cells[rng.random(cells.shape) < 0.002] = OCCUPIED
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
    used = found.spectrum.used
    assert (found.spectrum.eigenvalues[:used] > PAPER.eigenvalue_min).all()
    cells = np.argwhere(found.labels >= 0)[::97]
    points = OFFICE.centres_of(cells)
    distance = np.hypot(*(points[:, None] - found.nodes[None]).transpose(2, 0, 1))
    nearest = np.sort(distance, axis=1)
    clear = nearest[:, 1] - nearest[:, 0] > 2 * PAPER.cell_m  # ties within a working cell aside
    expected = found.node_labels[distance.argmin(axis=1)]
    np.testing.assert_array_equal(found.labels[cells[:, 0], cells[:, 1]][clear], expected[clear])


def test_unknown_cells_are_as_closed_as_walls() -> None:
    unknown = GridMap(np.where(OFFICE.free, FREE, UNKNOWN).astype(np.uint8), OFFICE.resolution)
    np.testing.assert_array_equal(segment(unknown, DEFAULT).labels, segment(OFFICE, DEFAULT).labels)


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_nodes_keep_clear_of_walls_see_each_other_and_lie_in_their_region(turn: int) -> None:
    turned = GridMap(np.ascontiguousarray(np.rot90(OFFICE.cells, turn)), OFFICE.resolution)
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


def drive(xs: np.ndarray) -> np.ndarray:
    """Through the door of `TWO_ROOMS`, which is at x = 5.4 m."""
    return np.column_stack([xs, np.full(len(xs), 1.95), np.zeros(len(xs))])


def test_keyframes_change_region_in_the_door_and_beyond_the_map_are_in_that_of_its_edge() -> None:
    poses = drive(np.concatenate([np.linspace(1.0, 8.0, 71), [-3.0, 12.0]]))
    labels = regions_of(TWO_ROOMS, poses, DEFAULT.model_copy(update={"region_min_m": 0.0}))
    (change,) = np.flatnonzero(np.diff(labels[:71]))
    assert 5.1 < poses[change, 0] < 5.7
    assert labels[71:].tolist() == [labels[0], labels[70]]
    assert labels.dtype == np.int64
    nothing = GridMap(np.full((20, 20), UNKNOWN, dtype=np.uint8), 0.05)
    assert regions_of(nothing, poses[:5], DEFAULT).tolist() == [0] * 5


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
    xs = np.concatenate([np.linspace(a, b, 15) for a, b in itertools.pairwise(stops)])
    poses = drive(xs)
    every, found = (
        regions_of(TWO_ROOMS, poses, SegmentationConfig(region_min_m=least_m))
        for least_m in (0.0, way_m)
    )
    assert found.tolist() == without_grazed(every.tolist(), poses, way_m)


def test_a_map_without_room_for_a_node_says_so() -> None:
    cells = np.full((40, 40), OCCUPIED, dtype=np.uint8)
    cells[5:8] = FREE
    with pytest.raises(NoResultError) as caught:
        segment_floorplan(GridMap(cells, 0.05), DEFAULT)
    assert str(caught.value) == (
        "no free space wider than 0.5 m in the map (0.3 m2 free): "
        "check the resolution and the thresholds"
    )


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


turns = st.integers(0, 3)


def blotch(seed: int) -> BoolArray:
    """A few free cells, one at the least."""
    rng = np.random.default_rng(seed)
    free = rng.random((rng.integers(1, 7), rng.integers(1, 7))) < 0.4
    free[rng.integers(free.shape[0]), rng.integers(free.shape[1])] = True
    return np.asarray(free)


@given(seeds, turns, st.tuples(*[st.integers(0, 5)] * 4))
def test_every_copy_of_a_map_looks_the_same(
    seed: int, turned: int, frame: tuple[int, int, int, int]
) -> None:
    free = blotch(seed)
    copy = np.pad(np.rot90(free, turned), (frame[:2], frame[2:]))
    np.testing.assert_array_equal(canonical(copy).apply(copy), canonical(free).apply(free))


@given(turns)
def test_the_free_space_lies_and_leans_whatever_single_cells_say(turned: int) -> None:
    free = np.zeros((40, 90), dtype=bool)
    free[5:35, 5:35] = free[15:24, 35:81] = True  # a room, and a corridor to the right of it
    ray = free.copy()
    ray[20, 81:90] = ray[0:5, 10] = True  # glimpses through a door and a window
    plain, seen = (canonical(np.rot90(picture, turned)).turns for picture in (free, ray))
    assert plain == seen == -turned % 4


@given(seeds, st.integers(1, 9))
def test_the_middle_of_the_free_space_is_the_corner_of_a_block(seed: int, block: int) -> None:
    free = np.kron(blotch(seed), np.ones((6, 6), dtype=bool))
    upright = canonical(free, block)
    rows, columns = upright.before
    assert 0 <= rows < block
    assert 0 <= columns < block
    turned = upright.apply(free)
    assert not turned[:rows].any()
    assert not turned[:, :columns].any()
    inner = ndimage.binary_erosion(turned, np.ones((5, 5)))
    middle = np.argwhere(inner if inner.any() else turned).mean(axis=0)
    assert (middle.astype(int) % block).tolist() == [0, 0]


@given(seeds)
def test_what_was_turned_is_put_back_where_it_was(seed: int) -> None:
    free = blotch(seed)
    upright = canonical(free)
    picture = np.arange(free.size).reshape(free.shape)
    turned, canvas = upright.apply(picture), np.full(free.shape, -1)
    back = upright.undo(turned, canvas)
    np.testing.assert_array_equal(back[upright.window], picture[upright.window])
    outside = np.ones(free.shape, dtype=bool)
    outside[upright.window] = False
    assert (back[outside] == -1).all()
    assert not free[outside].any()
    assert (canvas == -1).all()  # it is not changed itself
    cells = np.argwhere(np.ones(turned.shape, dtype=bool))
    rows, columns = upright.cells_in_grid(cells, turned.shape).astype(int).T
    np.testing.assert_array_equal(picture[rows, columns], turned.reshape(-1))
    nothing = canonical(np.zeros_like(free))  # without a free cell the window is empty
    assert nothing.apply(np.zeros_like(free)).shape == (0, 0)
    assert nothing.cells_in_grid(np.zeros((0, 2)), (0, 0)).shape == (0, 2)

"""Splitting while the robot moves, on tours with true poses; single tests of a way; its submap."""

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import Pose2, step_lengths
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.segmentation import online
from specmap_cli.segmentation.online import (
    PATH_MARGIN_M,
    SPLIT_CELL_M,
    CoarseSubmap,
    Occasion,
    OnlineSegmenter,
    Region,
    SplitTest,
    examine,
    way_driven,
)
from specmap_cli.segmentation.working_grid import reduced
from tests.casting import keyframe, ranges_at, store_of
from tests.segmentation.plans import OFFICE, TWO_ROOMS, plan
from tests.turning import turn

DEFAULT = SegmentationConfig()
EVERYWHERE = DEFAULT.model_copy(update={"path_band_m": 0.0})
GRID = GridConfig(resolution_m=0.05, footprint_m=0.2)
ONE_GRID = GRID.model_copy(update={"resolution_m": SPLIT_CELL_M})
PAPER = load_config(preset="paper").segmentation
BEARINGS = np.linspace(-np.pi, np.pi, 360, endpoint=False)
RANGE_M = 20.0


def waypoints_to_poses(*points: tuple[float, float]) -> list[Pose2]:
    """A pose every 0.1 m along straight lines."""
    poses = []
    for (x0, y0), (x1, y1) in pairwise(points):
        steps = max(1, round(float(np.hypot(x1 - x0, y1 - y0)) / 0.1))
        heading = float(np.arctan2(y1 - y0, x1 - x0))
        for share in np.arange(steps) / steps:
            poses.append(Pose2(x0 + share * (x1 - x0), y0 + share * (y1 - y0), heading))
    return poses


def record(grid: GridMap, poses: list[Pose2]) -> KeyframeStore:
    """Perfect scans from perfect poses."""
    seen = ranges_at(grid, np.array(poses), BEARINGS, RANGE_M)
    scans = (PlanarScan(k, BEARINGS, ranges, RANGE_M, True) for k, ranges in enumerate(seen))
    return store_of(map(keyframe, scans, poses))


def submap_of(
    store: KeyframeStore,
    keyframes: Iterable[int],
    config: SegmentationConfig = DEFAULT,
    grid: GridConfig = GRID,
) -> CoarseSubmap:
    submap = CoarseSubmap(config, grid, store)
    for number in keyframes:
        submap.add(number)
    return submap


def run(
    store: KeyframeStore,
    config: SegmentationConfig = DEFAULT,
    observer: online.Observer | None = None,
    keyframes: int | None = None,
) -> list[Region]:
    """The regions of the first keyframes, all unless told otherwise."""
    segmenter = OnlineSegmenter(config, GridConfig(), store, observer)
    count = len(store) if keyframes is None else keyframes
    return [r for number in range(count) for r in segmenter.add(number)] + segmenter.flush()


def examined(store: KeyframeStore, config: SegmentationConfig = DEFAULT) -> list[SplitTest]:
    tests: list[SplitTest] = []
    run(store, config, lambda test, *_: tests.append(test))
    return tests


TWICE_OVER = waypoints_to_poses(
    (1.0, 3.4), (4.0, 3.4), (3.0, 1.95), (6.2, 1.95), (8.8, 3.6), (8.8, 1.0), (6.5, 1.95),
    (2.8, 1.95), (1.0, 1.0), (4.0, 1.95), (6.2, 1.95), (8.8, 3.0),
)  # fmt: skip


@pytest.fixture(scope="module")
def two_room_tour() -> Iterator[KeyframeStore]:
    with record(TWO_ROOMS, TWICE_OVER) as store:
        yield store


def test_two_rooms_are_two_and_the_first_is_taken_up_again(two_room_tour: KeyframeStore) -> None:
    regions = run(two_room_tour)
    assert [region.continues for region in regions] == [None, None, 0, 1]
    assert [region.number for region in regions] == [0, 1, 2, 3]
    every = sorted(number for region in regions for number in region.keyframes)
    assert every == list(range(len(two_room_tour)))
    room = [pose.x > 5.4 for pose in TWICE_OVER]
    wrong = sum(room[k] != (region.number % 2) for region in regions for k in region.keyframes)
    assert wrong <= 0.03 * len(room)
    apart = run(two_room_tour, DEFAULT.model_copy(update={"regrow": False}))
    assert [region.continues for region in apart] == [None] * 4


def test_what_no_sight_line_joins_any_more_is_a_region_once_the_robot_is_gone() -> None:
    """A way round a corner through three rooms; the first door is too narrow for a sight line."""
    rooms = [(0.3, 0.3, 4.3, 4.3), (4.5, 0.3, 9.5, 4.3), (4.5, 4.5, 9.5, 8.5)]
    doors = [(4.3, 1.7, 4.5, 2.2), (8.0, 4.3, 8.9, 4.5)]
    way = waypoints_to_poses((1, 3), (3, 3), (3, 1.95), (6, 1.95), (8.45, 1.95), (8.45, 6.0))
    way += waypoints_to_poses((8.45, 6.0), (6.0, 6.0), (6.0, 7.5), (8.5, 7.5), (8.5, 6.5), (6, 6))
    tests: list[SplitTest] = []
    with record(plan(9.8, 8.8, *rooms, *doors), way) as store:
        regions = run(store, observer=lambda test, *_: tests.append(test))
        x, y = store.poses[:, :2].T
    assert sorted(k for region in regions for k in region.keyframes) == list(range(len(x)))
    assert [region.number for region in regions] == [0, 1, 2]
    assert {region.continues for region in regions} == {None}
    room = np.where(x < 4.4, 0, np.where(y < 4.4, 1, 2))
    for region, expected in zip(regions, (1, 0, 2), strict=True):
        assert (room[list(region.keyframes)] == expected).mean() > 0.95
    assert any((~test.reached).any() for test in tests)
    assert tests[-1].poses[:, 1].min() > 4.3  # the map of a test is that of the third room


def test_a_loss_of_track_ends_the_region_and_joins_nothing(two_room_tour: KeyframeStore) -> None:
    segmenter = OnlineSegmenter(DEFAULT, GridConfig(), two_room_tour)
    first = [region for number in range(30) for region in segmenter.add(number)]
    first += segmenter.flush()
    assert [region.keyframes for region in first] == [tuple(range(30))]
    assert segmenter.flush() == []
    rest = [r for number in range(30, len(two_room_tour)) for r in segmenter.add(number)]
    rest += segmenter.flush()
    assert all(region.continues != 0 for region in rest)


@pytest.mark.parametrize("width", [3.0, 12.0])
def test_a_hall_of_any_width_is_not_split(width: float) -> None:
    grid = plan(width + 0.6, 12.6, (0.3, 0.3, 0.3 + width, 12.3))
    right = width - 0.4
    poses = waypoints_to_poses((1.0, 1.0), (1.0, 11.5), (right, 11.5), (right, 1.0), (1.5, 1.0))
    with record(grid, poses) as store:
        regions = run(store)
    assert len(regions) == 1


def test_looking_into_a_room_does_not_split_the_corridor() -> None:
    with record(OFFICE, waypoints_to_poses((1.0, 5.5), (14.0, 5.5), (1.0, 5.4))) as store:
        assert len(run(store)) == 1
        assert len(run(store, PAPER)) > 1


def test_tests_come_by_the_way_travelled_or_by_keyframes(two_room_tour: KeyframeStore) -> None:
    whole = way_driven(two_room_tour, range(len(two_room_tour)))
    found = len(examined(two_room_tour))
    assert found == pytest.approx(whole / online._TEST_METRES, abs=0.1 * whole)
    assert len(examined(two_room_tour, PAPER)) == len(two_room_tour) // PAPER.test_keyframes


def test_the_longer_the_way_in_one_submap_the_rarer_the_tests() -> None:
    """With a share of 0.1, nothing shorter than 3 m is split off a way of 30 m."""
    grid = plan(30.6, 2.6, (0.3, 0.3, 30.3, 2.3))
    poses = waypoints_to_poses((1.0, 1.0), (29.0, 1.0), (1.0, 1.6))
    config = DEFAULT.model_copy(update={"split_share": 0.1})
    with record(grid, poses) as store:
        ways = [float(step_lengths(test.poses).sum()) for test in examined(store, config)]
    gaps = np.diff(ways)
    assert gaps[:4] == pytest.approx(1.0, abs=0.3)
    assert gaps[-1] == pytest.approx(0.1 * ways[-1], rel=0.15)


def test_the_paper_compares_the_second_eigenvalue(two_room_tour: KeyframeStore) -> None:
    tests: list[tuple[SplitTest, bool]] = []
    run(two_room_tour, PAPER, lambda test, split, _: tests.append((test, split)))
    for test, split in tests:
        assert test.chosen == 1
        assert test.eigenvalue == test.eigenvalues[1]
        if split:
            assert test.eigenvalue > 0.8


def test_the_outcome_does_not_depend_on_where_the_map_lies(two_room_tour: KeyframeStore) -> None:
    submap = submap_of(two_room_tour, range(90))
    here = examine(submap.grid(), submap.poses, DEFAULT)
    grid = submap.grid()
    far = GridMap(grid.cells, grid.resolution, (grid.origin[0] + 512.0, grid.origin[1] - 256.0))
    there = examine(far, submap.poses + (512.0, -256.0, 0.0), DEFAULT)
    assert here.eigenvalue == there.eigenvalue
    assert (here.stays != there.stays).sum() <= 1  # a pose on the line between two cells
    np.testing.assert_allclose(here.nodes + (512.0, -256.0), there.nodes)


def test_the_number_of_nodes_is_bounded() -> None:
    with record(OFFICE, waypoints_to_poses((1.0, 5.5), (14.0, 5.5))) as store:
        submap = submap_of(store, range(len(store)))
        assert len(examine(submap.grid(), submap.poses, DEFAULT).nodes) > 20
        turn("segmentation", split_nodes=20)
        assert 3 <= len(examine(submap.grid(), submap.poses, DEFAULT).nodes) <= 20


def test_the_observer_sees_what_is_split(two_room_tour: KeyframeStore) -> None:
    seen: list[tuple[SplitTest, bool, Occasion]] = []

    def observe(test: SplitTest, split: bool, occasion: Occasion) -> None:
        seen.append((test, split, occasion))

    segmenter = OnlineSegmenter(DEFAULT, GridConfig(), two_room_tour, observe)
    stamps_ns = two_room_tour.stamps_ns
    for number in range(len(two_room_tour)):
        before = len(seen)
        left = segmenter.add(number)
        assert len(seen) - before <= 1
        assert len(left) == sum(split for _, split, _ in seen[before:])
        for test, _, occasion in seen[before:]:
            assert occasion.latest == number
            assert occasion.seconds == (stamps_ns[number] - stamps_ns[0]) / 1e9
            assert len(test.poses) == number - occasion.first + 1
        for region in left:
            test, *_ = seen[-1]
            gone = two_room_tour.poses_of(region.keyframes)
            np.testing.assert_array_equal(gone, test.poses[~test.stays])
    for test, split, _ in seen:
        assert test.stays[-1]  # the robot is where it is
        assert not split or test.eigenvalue > DEFAULT.split_eigenvalue


@pytest.mark.parametrize("side", [0, 1])
def test_a_glimpse_is_too_short_to_be_split_off(two_room_tour: KeyframeStore, side: int) -> None:
    config = DEFAULT.model_copy(update={"region_min_m": (7.0, 100.0)[side]})
    regions = run(two_room_tour, config, keyframes=150)
    for region in regions[:-1]:
        assert way_driven(two_room_tour, region.keyframes) >= config.region_min_m
    assert (len(regions) == 1) == (side == 1)


def driven(grid: GridMap, *corners: tuple[float, float]) -> tuple[GridMap, np.ndarray]:
    """The whole plan, as if mapped, and the poses along some corners."""
    return grid, np.array(waypoints_to_poses(*corners))


def test_a_door_divides_the_way_where_it_is() -> None:
    test = examine(*driven(TWO_ROOMS, (1.0, 1.95), (8.5, 1.95)), DEFAULT)
    assert test.eigenvalue > DEFAULT.split_eigenvalue
    assert not test.stays[test.poses[:, 0] < 5.1].any()
    assert test.stays[test.poses[:, 0] > 5.7].all()
    assert test.reached.all()
    back = examine(*driven(TWO_ROOMS, (8.5, 1.95), (1.0, 1.95)), DEFAULT)
    assert back.eigenvalue == pytest.approx(test.eigenvalue)
    assert back.stays[back.poses[:, 0] < 5.1].all()


def test_what_lies_beyond_the_band_and_its_margin_changes_nothing() -> None:
    near = examine(*driven(TWO_ROOMS, (1.0, 1.0), (2.0, 1.0)), DEFAULT)
    cells = TWO_ROOMS.cells.copy()
    cells[:, round((2.0 + (DEFAULT.path_band_m + PATH_MARGIN_M)) / 0.05) + 2 :] = OCCUPIED
    same = examine(*driven(GridMap(cells, TWO_ROOMS.resolution), (1.0, 1.0), (2.0, 1.0)), DEFAULT)
    np.testing.assert_array_equal(near.eigenvalues, same.eigenvalues)
    np.testing.assert_array_equal(near.grid.cells, same.grid.cells)
    assert near.grid.cells.size < TWO_ROOMS.cells.size
    whole = examine(*driven(TWO_ROOMS, (1.0, 1.0), (2.0, 1.0)), EVERYWHERE)
    np.testing.assert_array_equal(whole.grid.cells, TWO_ROOMS.cells)


@pytest.mark.parametrize("margin", [0.0, 1.0])
def test_the_margin_keeps_obstacles_at_the_band_s_edge_whole(margin: float) -> None:
    cells = np.full((240, 240), FREE, dtype=np.uint8)
    cells[50:69, 133:152] = OCCUPIED  # a table of 0.95 m where the window without a margin ends
    grid, poses = driven(GridMap(cells, 0.05), (3.0, 3.0), (5.6, 3.0))
    turn("segmentation", path_margin_m=margin)
    on_it = (np.abs(examine(grid, poses, DEFAULT).nodes - (7.12, 2.97)) < 0.47).all(axis=1)
    assert on_it.any() == (margin > 0.0)


def test_of_rooms_seen_and_not_entered_there_may_be_as_many_as_eigenpairs() -> None:
    office = GridMap(reduced(OFFICE.cells, 2), 0.1)  # in the cells of such a test
    way = (1.0, 5.5), (14.0, 5.5), (12.4, 5.5), (12.4, 3.0)
    found = examine(*driven(office, *way), EVERYWHERE)
    assert found.chosen > 1
    turn("segmentation", split_eigenpairs=found.chosen)
    assert examine(*driven(office, *way), EVERYWHERE).eigenvalue == 0.0


def test_no_division_of_a_stand_a_way_off_the_map_or_a_map_too_small_for_a_graph() -> None:
    standing = examine(TWO_ROOMS, np.tile([2.0, 1.95, 0.0], (30, 1)), DEFAULT)
    grid, poses = driven(TWO_ROOMS, (1.0, 1.0), (3.0, 1.0))
    off = examine(grid, poses + (500.0, 0.0, 0.0), DEFAULT)
    assert (len(off.nodes), off.grid.cells.size) == (0, 0)
    small = examine(plan(1.0, 1.0, (0.3, 0.3, 0.7, 0.7)), np.array([[0.5, 0.5, 0.0]]), DEFAULT)
    for test in (standing, off, small):
        assert test.eigenvalue == 0.0
        assert test.stays.all()


def test_poses_behind_a_closed_door_stay_where_they_cannot_be_judged() -> None:
    cells = TWO_ROOMS.cells.copy()
    cells[:, round(5.35 / 0.05) : round(5.45 / 0.05)] = OCCUPIED
    test = examine(*driven(GridMap(cells, 0.05), (3.0, 1.95), (7.5, 1.95)), DEFAULT)
    left = test.poses[:, 0] < 5.2
    assert not test.reached[left].any()
    assert test.reached[test.poses[:, 0] > 5.6].all()
    assert test.stays[left].all()


def stored(poses: list[Pose2]) -> KeyframeStore:
    """Keyframes that see a wall all round, nearer from keyframe to keyframe."""
    turn("segmentation", split_step_m=0.25, split_step_rad=0.5)
    store, bearings = KeyframeStore(), np.linspace(-np.pi, np.pi, 90, endpoint=False)
    for number, pose in enumerate(poses):
        scan = PlanarScan(number, bearings, np.full(90, 3.0 - 0.05 * number), 20.0, True)
        store.append(keyframe(scan, pose, number=number))
    return store


@pytest.fixture
def drive() -> Iterator[KeyframeStore]:
    """1.25 m in steps of 0.125 m, then half a turn on the spot in steps of 0.2 rad."""
    way = [Pose2(0.125 * step, 0.0, 0.0) for step in range(11)]
    with stored(way + [Pose2(1.25, 0.0, 0.2 * turn) for turn in range(1, 16)]) as store:
        yield store


def same(one: GridMap, other: GridMap) -> bool:
    return one.origin == other.origin and np.array_equal(one.cells, other.cells)


def test_keyframes_enter_the_grid_when_the_robot_moved_or_turned(drive: KeyframeStore) -> None:
    submap = submap_of(drive, range(26))
    assert submap.keyframes == tuple(range(26))
    np.testing.assert_array_equal(submap.poses, drive.poses)
    mapped = [0, 2, 4, 6, 8, 10, 13, 16, 19, 22, 25]  # every 0.25 m, then every 0.6 rad
    whole = integrate_keyframes(drive, mapped, drive.poses_of(mapped), ONE_GRID).snapshot()
    assert same(submap.grid(), whole.near(submap.poses, DEFAULT.path_band_m + PATH_MARGIN_M))


def test_where_nodes_lie_anywhere_the_grid_is_whole(drive: KeyframeStore) -> None:
    far = GRID.model_copy(update={"max_range_m": 2.0})
    grids = []
    for band in (0.0, 0.5):
        turn("segmentation", path_margin_m=0.25)
        config = DEFAULT.model_copy(update={"path_band_m": band})
        grids.append(submap_of(drive, [0], config, far).grid())
    whole, near = grids
    assert set(near.cells.shape) <= {15, 16}  # 0.75 m to each side
    assert same(near, whole.near(drive.poses[:1], 0.75))
    assert min(whole.cells.shape) > 40


@pytest.mark.parametrize(("cell", "fine", "expected"), [(0.1, 0.05, 0.1), (0.1, 0.2, 0.2)])
def test_cells_are_no_finer_than_the_working_grid_s(
    drive: KeyframeStore, cell: float, fine: float, expected: float
) -> None:
    turn("segmentation", split_cell_m=cell)
    assert submap_of(drive, [0], grid=GridConfig(resolution_m=fine)).grid().resolution == expected


def everywhere(drive: KeyframeStore, numbers: Iterable[int]) -> CoarseSubmap:
    turn("segmentation", split_step_m=0.0)
    return submap_of(drive, numbers, EVERYWHERE)


def counted_once(submap: CoarseSubmap, drive: KeyframeStore) -> bool:
    """Whether the grid is that of the keyframes, each counted once."""
    whole = integrate_keyframes(drive, submap.keyframes, submap.poses, ONE_GRID).snapshot()
    found, whole = submap.grid().cropped(), whole.cropped()
    return np.allclose(found.origin, whole.origin) and np.array_equal(found.cells, whole.cells)


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize("last", [3, 20])
def test_a_split_counts_each_on_its_side(drive: KeyframeStore, last: int, asked: bool) -> None:
    submap = everywhere(drive, range(26))
    if asked:
        submap.grid()
    stays = np.arange(26) >= last
    stays[1] = True
    rest, left = submap.split(stays)
    assert rest.keyframes == (1, *range(last, 26))
    assert left.keyframes == (0, *range(2, last))
    np.testing.assert_array_equal(left.poses, drive.poses_of(left.keyframes))
    assert counted_once(rest, drive)
    assert counted_once(left, drive)
    assert submap.keyframes == tuple(range(26))
    assert counted_once(submap, drive)
    rest, _ = everywhere(drive, range(12)).split(np.arange(12) >= 8)  # and goes on
    assert rest.add(12) == 0.0  # turned on the spot
    assert rest.keyframes == (8, 9, 10, 11, 12)
    assert counted_once(rest, drive)


def test_what_is_joined_is_counted_once(drive: KeyframeStore) -> None:
    one, other = everywhere(drive, range(15, 26)), everywhere(drive, range(9))
    one.grid()
    both = one.joined(other)
    assert both.keyframes == (*range(15, 26), *range(9))
    np.testing.assert_array_equal(both.poses, drive.poses_of(both.keyframes))
    assert counted_once(both, drive)
    assert counted_once(one, drive)


@pytest.mark.parametrize(("away", "near"), [(3.9, True), (4.1, False)])
def test_submaps_are_near_when_their_bands_overlap(away: float, near: bool) -> None:
    with stored([Pose2(-9.0, 0.0, 0.0), Pose2(0.0, 0.0, 0.0), Pose2(away, 0.0, 2.0)]) as store:
        config = SegmentationConfig(path_band_m=2.0)
        one, other = (submap_of(store, numbers, config) for numbers in ([0, 1], [2]))
        assert one.near(other) == near
        assert everywhere(store, [0]).near(everywhere(store, [2]))  # nodes lie anywhere


def apart(numbers: list[int], xs: list[float], reached: set[int], band: float = 2.0) -> list[int]:
    """Which keyframes of a submap lie apart from those reached; `xs` is where each one is."""
    with stored([Pose2(x, 0.0, 0.0) for x in xs]) as store:
        submap = submap_of(store, numbers, SegmentationConfig(path_band_m=band))
        found = submap.apart(np.array([number in reached for number in numbers]))
        return [numbers[k] for k in np.flatnonzero(found)]


def test_a_stretch_apart_is_one_that_shares_no_node_with_what_is_reached() -> None:
    xs = [0.0, 1.0, 2.0, 3.1, 6.1, 7.0]
    assert apart([0, 1, 2, 5], xs, {5}) == [0, 1, 2]
    assert apart([0, 1, 3, 5], xs, {5}) == [0, 1]  # 3 is less than four metres away
    assert apart([0, 1, 2, 3, 5], xs, {5}) == []  # a stretch is apart as a whole
    assert apart([0, 1, 2, 5], xs, {1, 5}) == []
    assert apart([0, 1, 2, 5], xs, {0, 1, 2, 5}) == []
    assert apart([0, 1, 2, 5], xs, {5}, band=0.0) == []  # nodes lie anywhere


@given(st.sets(st.integers(0, 25)))
def test_the_way_of_some_keyframes_leaves_out_what_lies_between(numbers: set[int]) -> None:
    poses = [Pose2(0.1 * k**1.5, 0.3 * (k % 3), 0.0) for k in range(26)]
    expected = sum(
        float(np.hypot(poses[k + 1].x - poses[k].x, poses[k + 1].y - poses[k].y))
        for k in numbers
        if k + 1 in numbers
    )
    with stored(poses) as store:
        assert way_driven(store, sorted(numbers)) == pytest.approx(expected)

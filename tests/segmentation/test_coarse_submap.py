"""The submap that is tested for a split: which keyframes it has, and its grid of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.segmentation.online import PATH_MARGIN_M, SPLIT_CELL_M, CoarseSubmap, way_driven
from tests.casting import keyframe
from tests.turning import turn

DEFAULT = SegmentationConfig()
EVERYWHERE = DEFAULT.model_copy(update={"path_band_m": 0.0})
GRID = GridConfig(resolution_m=0.05, footprint_m=0.2)
ONE_GRID = GRID.model_copy(update={"resolution_m": SPLIT_CELL_M})


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
    submap = submap_of(drive, [0], grid=GridConfig(resolution_m=fine))
    assert submap.grid().resolution == expected


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

"""The submap that is tested while the robot drives: what enters its grid, and the way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.segmentation.coarse_submap import CoarseSubmap, way_driven

CONFIG = SegmentationConfig(split_step_m=0.25, split_step_rad=0.5)
GRID = GridConfig(resolution_m=0.05, footprint_m=0.2)


def stored(poses: list[Pose2]) -> KeyframeStore:
    """Keyframes that see a wall all round, nearer from keyframe to keyframe."""
    store, bearings = KeyframeStore(), np.linspace(-np.pi, np.pi, 90, endpoint=False)
    for number, pose in enumerate(poses):
        scan = PlanarScan(number, bearings, np.full(90, 3.0 - 0.05 * number), 20.0, True)
        store.append(
            PosedScan(
                index=number,
                stamp_ns=number,
                map_from_base=pose,
                planar=scan,
                base_from_laser=IDENTITY,
            )
        )
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
    submap = CoarseSubmap(CONFIG, GRID, drive)
    for number in range(len(drive)):
        submap.add(number)
    assert submap.keyframes == tuple(range(26))
    np.testing.assert_array_equal(submap.poses, drive.poses)
    mapped = [0, 2, 4, 6, 8, 10, 13, 16, 19, 22, 25]  # every 0.25 m, then every 0.6 rad
    config = GRID.model_copy(update={"resolution_m": CONFIG.cell_m})
    expected = integrate_keyframes(drive, mapped, drive.poses_of(mapped), config)
    assert same(submap.grid(), expected.snapshot())


@pytest.mark.parametrize(("cell", "fine", "expected"), [(0.1, 0.05, 0.1), (0.1, 0.2, 0.2)])
def test_cells_are_no_finer_than_the_working_grid_s(
    drive: KeyframeStore, cell: float, fine: float, expected: float
) -> None:
    config = SegmentationConfig(cell_m=cell)
    submap = CoarseSubmap(config, GridConfig(resolution_m=fine), drive)
    submap.add(0)
    assert submap.grid().resolution == expected


def test_a_keyframe_says_how_far_the_robot_drove_to_it(drive: KeyframeStore) -> None:
    submap = CoarseSubmap(CONFIG, GRID, drive)
    assert submap.add(0) == 0.0
    assert submap.add(1) == pytest.approx(0.125)
    assert submap.add(2) == pytest.approx(0.125)
    assert submap.add(9) == 0.0  # what lies between was in another submap
    assert submap.add(10) == pytest.approx(0.125)
    assert submap.add(11) == 0.0  # turned on the spot


def test_a_rebuilt_submap_is_one_to_which_the_same_was_added(drive: KeyframeStore) -> None:
    first = CoarseSubmap(CONFIG, GRID, drive)
    first.add(0)
    again = first.rebuilt(range(3, 20))
    added = CoarseSubmap(CONFIG, GRID, drive)
    for number in range(3, 20):
        added.add(number)
    assert again.keyframes == added.keyframes == tuple(range(3, 20))
    assert same(again.grid(), added.grid())
    assert first.keyframes == (0,)
    again.add(20)
    assert again.keyframes[-1] == 20
    assert first.rebuilt(()).keyframes == ()


@pytest.mark.parametrize(("most", "every"), [(26, 1), (13, 2), (5, 5), (1, 26), (100, 1)])
def test_a_rebuilt_submap_maps_about_as_many_as_asked(
    drive: KeyframeStore, most: int, every: int
) -> None:
    dense = SegmentationConfig(split_step_m=0.0, split_step_rad=0.0)
    submap = CoarseSubmap(dense, GRID, drive).rebuilt(range(26), most)
    assert submap.keyframes == tuple(range(26))
    few = range(0, 26, every)
    config = GRID.model_copy(update={"resolution_m": dense.cell_m})
    expected = integrate_keyframes(drive, few, drive.poses_of(few), config)
    assert same(submap.grid(), expected.snapshot())


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

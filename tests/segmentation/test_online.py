"""Splitting while the robot moves, on tours with true poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest

from specmap_cli.core.config import GridConfig, SegmentationConfig, load_config
from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.drawing.split_tests import Picture, draw_test
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.ray_casting import cast_ranges
from specmap_cli.segmentation.online import OnlineSegmenter, Region
from specmap_cli.segmentation.sketch import Sketch, path_length
from specmap_cli.segmentation.splitting import SplitTest, examine

DEFAULT = SegmentationConfig()
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
    store, distance = KeyframeStore(), grid.obstacle_distance()
    for number, pose in enumerate(poses):
        ranges = cast_ranges(distance, grid, np.array([pose[:2]]), BEARINGS + pose.theta, RANGE_M)[
            0
        ]
        scan = PlanarScan(number, BEARINGS, ranges, RANGE_M, True)
        store.append(PosedScan(number, number, pose, scan, IDENTITY))
    return store


def run(segmenter: OnlineSegmenter, keyframes: int) -> list[Region]:
    regions = [region for number in range(keyframes) for region in segmenter.add(number)]
    return regions + segmenter.flush()


THERE_AND_BACK = waypoints_to_poses(
    (1.0, 3.4), (4.0, 3.4), (3.0, 1.95), (6.2, 1.95), (8.8, 3.6), (8.8, 1.0), (6.5, 1.95),
    (2.8, 1.95), (1.0, 1.0),
)  # fmt: skip


@pytest.fixture
def two_room_tour(two_rooms: GridMap) -> Iterator[KeyframeStore]:
    with record(two_rooms, THERE_AND_BACK) as store:
        yield store


def test_every_keyframe_ends_in_exactly_one_region(two_room_tour: KeyframeStore) -> None:
    regions = run(OnlineSegmenter(DEFAULT, GridConfig(), two_room_tour), len(two_room_tour))
    keyframes = sorted(number for region in regions for number in region.keyframes)
    assert keyframes == list(range(len(two_room_tour)))
    assert [region.number for region in regions] == list(range(len(regions)))


def test_two_rooms_are_two_and_the_first_goes_on_when_the_robot_is_back(
    two_room_tour: KeyframeStore,
) -> None:
    regions = run(OnlineSegmenter(DEFAULT, GridConfig(), two_room_tour), len(two_room_tour))
    assert [region.continues for region in regions] == [None, None, 0]
    room = [pose.x > 5.4 for pose in THERE_AND_BACK]
    wrong = sum(room[k] != (region.number == 1) for region in regions for k in region.keyframes)
    assert wrong <= 0.03 * len(room)


def test_without_regrowing_the_return_is_a_region_of_its_own(
    two_room_tour: KeyframeStore,
) -> None:
    config = DEFAULT.model_copy(update={"regrow": False})
    regions = run(OnlineSegmenter(config, GridConfig(), two_room_tour), len(two_room_tour))
    assert [region.continues for region in regions] == [None, None, None]


def test_a_loss_of_track_ends_the_region_and_joins_nothing(two_room_tour: KeyframeStore) -> None:
    segmenter = OnlineSegmenter(DEFAULT, GridConfig(), two_room_tour)
    first = [region for number in range(30) for region in segmenter.add(number)]
    first += segmenter.flush()
    assert [region.keyframes for region in first] == [list(range(30))]
    assert segmenter.flush() == []
    rest = [r for number in range(30, len(two_room_tour)) for r in segmenter.add(number)]
    rest += segmenter.flush()
    assert all(region.continues != 0 for region in rest)


def test_a_tail_too_short_to_stand_alone_is_appended(two_room_tour: KeyframeStore) -> None:
    split_at = next(
        number for number, segmenter in _running(two_room_tour) if segmenter.add(number)
    )
    longer = DEFAULT.model_copy(update={"region_min_m": 1.0})
    segmenter = OnlineSegmenter(longer, GridConfig(), two_room_tour)
    regions = [r for number in range(split_at + 1) for r in segmenter.add(number)]
    assert len(regions) == 1
    demanding = longer.model_copy(update={"region_min_m": 50.0})
    segmenter.config = demanding
    (tail,) = segmenter.flush()
    assert tail.continues == regions[0].number


def _running(store: KeyframeStore) -> Iterator[tuple[int, OnlineSegmenter]]:
    segmenter = OnlineSegmenter(DEFAULT, GridConfig(), store)
    for number in range(len(store)):
        yield number, segmenter


@pytest.mark.parametrize("width", [3.0, 12.0])
def test_a_hall_of_any_width_is_not_split(plan: Callable[..., GridMap], width: float) -> None:
    grid = plan(width + 0.6, 12.6, (0.3, 0.3, 0.3 + width, 12.3))
    poses = waypoints_to_poses(
        (1.0, 1.0), (1.0, 11.5), (width - 0.4, 11.5), (width - 0.4, 1.0), (1.5, 1.0)
    )
    with record(grid, poses) as store:
        regions = run(OnlineSegmenter(DEFAULT, GridConfig(), store), len(store))
    assert len(regions) == 1


def test_looking_into_a_room_does_not_split_the_corridor(office: GridMap) -> None:
    poses = waypoints_to_poses((1.0, 5.5), (14.0, 5.5), (1.0, 5.4))
    with record(office, poses) as store:
        assert len(run(OnlineSegmenter(DEFAULT, GridConfig(), store), len(store))) == 1
        assert len(run(OnlineSegmenter(PAPER, GridConfig(), store), len(store))) > 1


def test_tests_come_by_the_way_travelled_or_by_keyframes(two_room_tour: KeyframeStore) -> None:
    tests: list[SplitTest] = []
    count = len(two_room_tour)
    whole = path_length(two_room_tour, list(range(count)))
    run(OnlineSegmenter(DEFAULT, GridConfig(), two_room_tour, lambda t, _: tests.append(t)), count)
    assert len(tests) == pytest.approx(whole / DEFAULT.test_metres, abs=0.1 * whole)
    tests.clear()
    run(OnlineSegmenter(PAPER, GridConfig(), two_room_tour, lambda t, _: tests.append(t)), count)
    assert len(tests) == count // PAPER.test_keyframes


def test_the_paper_compares_the_second_eigenvalue(two_room_tour: KeyframeStore) -> None:
    tests: list[tuple[SplitTest, bool]] = []
    run(
        OnlineSegmenter(
            PAPER, GridConfig(), two_room_tour, lambda t, split: tests.append((t, split))
        ),
        len(two_room_tour),
    )
    for test, split in tests:
        assert test.chosen == 1
        assert test.eigenvalue == test.eigenvalues[1]
        if split:
            assert test.eigenvalue > 0.8


def test_the_outcome_of_a_test_does_not_depend_on_where_the_map_lies(
    two_room_tour: KeyframeStore,
) -> None:
    sketch = Sketch(GridConfig(resolution_m=0.1), two_room_tour)
    for number in range(90):
        sketch.add(number)
    here = examine(sketch.grid(), sketch.poses, DEFAULT)
    grid = sketch.grid()
    far = GridMap(grid.cells, grid.resolution, (grid.origin[0] + 512.0, grid.origin[1] - 256.0))
    there = examine(far, sketch.poses + (512.0, -256.0, 0.0), DEFAULT)
    assert here.eigenvalue == there.eigenvalue
    assert (here.stays != there.stays).sum() <= 1  # a pose on the line between two cells
    np.testing.assert_allclose(here.nodes + (512.0, -256.0), there.nodes)


def test_the_number_of_nodes_is_bounded(office: GridMap) -> None:
    poses = waypoints_to_poses((1.0, 5.5), (14.0, 5.5))
    few = DEFAULT.model_copy(update={"split_nodes": 20})
    with record(office, poses) as store:
        sketch = Sketch(GridConfig(resolution_m=0.1), store).rebuilt(list(range(len(store))))
        assert 3 <= len(examine(sketch.grid(), sketch.poses, few).nodes) <= 20
        assert len(examine(sketch.grid(), sketch.poses, DEFAULT).nodes) > 20


def test_a_map_too_small_for_a_graph_is_not_split(plan: Callable[..., GridMap]) -> None:
    grid = plan(1.0, 1.0, (0.3, 0.3, 0.7, 0.7))
    test = examine(grid, np.array([[0.5, 0.5, 0.0]]), DEFAULT)
    assert test.eigenvalue == 0.0
    assert test.stays.all()


def test_a_test_is_drawn(two_room_tour: KeyframeStore) -> None:
    pictures = []
    run(
        OnlineSegmenter(
            DEFAULT,
            GridConfig(),
            two_room_tour,
            lambda test, split: pictures.append((draw_test(test, 0.6, split), split)),
        ),
        len(two_room_tour),
    )
    orange, blue = (60, 110, 235), (200, 120, 30)
    assert any(split for _, split in pictures)
    for picture, split in pictures:
        assert picture.shape[2] == 3
        assert near_colour(picture, orange)
        assert near_colour(picture, blue) or not split


def near_colour(picture: Picture, colour: tuple[int, int, int]) -> bool:
    """Whether a pixel has the colour or a fainter one."""
    away = 255.0 - np.array(colour)
    strength = (255.0 - picture.reshape(-1, 3)) @ away / (away @ away)
    residual = np.abs(255.0 - picture.reshape(-1, 3) - strength[:, None] * away).max(axis=1)
    return bool(((strength > 0.2) & (residual < 3.0)).any())

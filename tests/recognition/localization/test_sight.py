"""Returns behind walls of the map: none in its own places, whole walls elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.recognition.localization.wall_fit import Sightlines
from tests.recognition.posed import posed

CELL_M = 0.05
REACH_M = 8.0
BEARINGS = np.radians(np.arange(-90.0, 90.0))


def box(width_m: float, height_m: float) -> GridMap:
    """A closed room of a given size with walls of two cells; its free space begins at (0, 0)."""
    cells = np.full((round(height_m / CELL_M) + 4, round(width_m / CELL_M) + 4), OCCUPIED, np.uint8)
    cells[2:-2, 2:-2] = FREE
    return GridMap(cells, CELL_M, (-2 * CELL_M, -2 * CELL_M))


def seen_in(width_m: float, height_m: float, pose: Pose2) -> PosedScan:
    """What half a circle sees in a room of that size, by geometry alone."""
    angles = BEARINGS + pose.theta
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(angles) > 0.0, width_m - pose.x, -pose.x) / np.cos(angles)
        y = np.where(np.sin(angles) > 0.0, height_m - pose.y, -pose.y) / np.sin(angles)
    planar = PlanarScan(0, BEARINGS, np.minimum(x, y), range_max=30.0, full_circle=False)
    return posed(planar, pose)


def share(scan: PosedScan, pose: Pose2, width_m: float = 5.0, height_m: float = 4.0) -> float:
    return Sightlines({3: box(width_m, height_m)}, REACH_M).behind(3, scan, pose)


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.08, -0.08, 0.0), (0.0, 0.05, 0.03)])
@pytest.mark.parametrize("place", [(2.5, 2.0, 0.3), (0.4, 0.4, 2.0), (4.7, 2.0, 1.5)])
def test_in_its_own_room_nothing_is_behind_walls_however_slightly_a_match_is_off(
    place: tuple[float, float, float], off: tuple[float, float, float]
) -> None:
    pose = Pose2(*place)
    matched = Pose2(pose.x + off[0], pose.y + off[1], pose.theta + off[2])
    assert share(seen_in(5.0, 4.0, pose), matched) <= 0.02


def test_the_far_wall_of_a_longer_room_is_behind_the_map_s_and_none_of_a_smaller_one() -> None:
    pose = Pose2(2.5, 2.0, 0.0)
    scan = seen_in(8.0, 4.0, pose)
    farther = np.cos(BEARINGS) * scan.planar.ranges > 2.5 + 0.3
    assert share(scan, pose) == pytest.approx(np.mean(farther), abs=0.06)
    assert share(scan, pose) > 0.3
    assert share(seen_in(3.5, 3.0, pose), pose) == 0.0


def test_a_wall_beyond_reach_stops_nothing_and_without_a_return_nothing_is_behind_it() -> None:
    pose = Pose2(1.0, 2.0, 0.0)
    scan = seen_in(29.0, 4.0, pose)
    near, far = (Sightlines({3: box(12.0, 4.0)}, r).behind(3, scan, pose) for r in (8.0, 15.0))
    assert near == 0.0 < far
    for reading in (math.inf, math.nan):
        ranges = np.full(len(BEARINGS), reading)
        assert share(replace(scan, planar=replace(scan.planar, ranges=ranges)), pose) == 0.0


def test_the_laser_looks_from_where_it_is_mounted() -> None:
    pose, mounting = Pose2(3.5, 2.0, 0.0), Pose2(0.3, 0.1, math.pi)
    seen = seen_in(5.0, 4.0, pose @ mounting)
    scan = posed(seen.planar, pose, base_from_laser=mounting)
    assert share(scan, pose) <= 0.02
    turned = Pose2(pose.x, pose.y, math.pi)
    assert share(scan, turned) > 0.05


def test_furnished_rooms_hide_nothing_from_their_own_scans(building: Any) -> None:
    for room in range(4):
        grid, first = building.walk(room, 0, "pairs").grid, building.frame(room)
        sight = Sightlines({1: grid}, REACH_M)
        for scan in building.posed(building.path(room, 3)[::8]):
            assert sight.behind(1, scan, first.inverse() @ scan.map_from_base) < 0.05

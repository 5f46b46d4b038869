"""Virtual scans: of the window behind the robot, cast from a grid, and from beside the way."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.features.virtual import (
    RecentScans,
    all_round,
    cast_circles,
    circle,
    nearest_returns,
    outline,
    seen_from,
)
from tests.strategies import poses, seeds
from tests.turning import turn

WALL = np.array([[0.0, 1.0]])


def recent_scans(**settings: float) -> RecentScans:
    """A window of 2 m, scans 0.2 m apart, 36 beams up to 10 m."""
    chosen = {"window_m": 2.0, "virtual_beams": 36, "virtual_range_m": 10.0} | settings
    turn("recognition", **chosen)
    return RecentScans()


def add(recent: RecentScans, points: FloatArray, pose: Pose2) -> None:
    """Take in what a scan saw from a pose."""
    (x, y) = points.T
    seen = PlanarScan(0, np.arctan2(y, x), np.hypot(x, y), 20.0, full_circle=False)
    recent.add(pose, IDENTITY, lambda: seen)


def drive(recent: RecentScans, metres: float, step: float = 0.25) -> Pose2:
    """Drive straight on; each scan sees one point, a metre to the left of the robot."""
    pose = IDENTITY
    for k in range(round(metres / step) + 1):
        pose = Pose2(step * k, 0.0, 0.0)
        add(recent, WALL, pose)
    return pose


@pytest.mark.parametrize("beams", [1, 2, 37, 360])
def test_the_bearings_of_a_circle_are_even_and_end_before_they_begin_again(beams: int) -> None:
    bearings = circle(beams)
    assert bearings[0] == -math.pi
    assert np.diff(bearings) == pytest.approx(2.0 * math.pi / beams)
    assert bearings[-1] < math.pi
    assert all_round(np.ones(beams), 5.0).bearings.tolist() == bearings.tolist()


@given(seeds, st.integers(0, 60), st.integers(4, 72))
def test_the_nearest_return_is_taken_at_each_bearing(seed: int, count: int, beams: int) -> None:
    points = np.random.default_rng(seed).normal(0.0, 2.0, (count, 2))
    scan = nearest_returns(points, beams, 4.0, stamp_ns=7)
    expected = np.full(beams, math.inf)
    for x, y in points.tolist():
        distance, half = math.hypot(x, y), math.pi / beams
        for k, bearing in enumerate(scan.bearings.tolist()):
            off = math.remainder(math.atan2(y, x) - bearing, 2.0 * math.pi)
            if 0.05 < distance < 4.0 and -half <= off < half:
                expected[k] = min(expected[k], distance)
    assert scan.ranges == pytest.approx(expected, abs=1e-6)
    assert scan.full_circle
    assert (scan.stamp_ns, scan.range_max) == (7, 4.0)


@given(seeds, poses)
def test_a_virtual_scan_sees_the_same_points_from_anywhere(seed: int, origin: Pose2) -> None:
    """What one scan saw, seen from the place where it was taken, is that scan."""
    ranges = np.random.default_rng(seed).uniform(0.5, 9.0, 36)
    bearings = circle(36)
    mounting = Pose2(0.3, -0.1, 0.4)
    planar = PlanarScan(0, bearings, ranges, range_max=20.0, full_circle=True)
    recent = recent_scans()
    recent.add(origin, mounting, lambda: planar)
    assert recent.scan(3, origin @ mounting).ranges == pytest.approx(ranges)


@pytest.mark.parametrize(("share", "far_m"), [(1.0, 2.0), (0.5, 1.0), (0.1, 0.0)])
def test_a_share_of_the_window_is_what_was_seen_last(share: float, far_m: float) -> None:
    recent = recent_scans(virtual_beams=360)
    here = drive(recent, 7.25)
    assert recent.filled == 1.0
    seen = recent.scan(0, here, share).ranges
    assert seen.min() == pytest.approx(1.0)
    assert seen[np.isfinite(seen)].max() == pytest.approx(math.hypot(far_m, 1.0))
    assert np.isinf(recent_scans().scan(0, here, share).ranges).all()


def test_scans_too_near_to_the_last_are_left_out_but_their_way_counts() -> None:
    recent = recent_scans(virtual_spacing_m=0.5)
    for k in range(5):  # 0.1 m apart, each with another point
        add(recent, np.array([[0.0, 1.0 + k]]), Pose2(0.1 * k, 0.0, 0.0))
    assert recent.filled == pytest.approx(0.2)
    assert np.isfinite(recent.scan(0, IDENTITY).ranges).sum() == 1
    add(recent, np.array([[1.0, 0.0]]), Pose2(0.5, 0.0, 0.0))
    assert np.isfinite(recent.scan(0, IDENTITY).ranges).sum() == 2


def test_after_a_restart_nothing_of_before_is_seen_and_the_window_fills_anew() -> None:
    recent = recent_scans()
    drive(recent, 3.0)
    recent.clear()
    assert recent.filled == 0.0
    add(recent, WALL, Pose2(100.0, 0.0, 0.0))
    assert recent.filled == 0.0  # the leap between the two poses is no way driven
    add(recent, WALL, Pose2(101.0, 0.0, 0.0))
    assert recent.filled == pytest.approx(0.5)


def test_a_cast_scan_is_what_the_walls_of_the_grid_show(flat: GridMap) -> None:
    origin = np.array([[1.6, 4.0]])
    cast = cast_circles(flat, origin, 90, 12.0)[0]
    walls: FloatArray = flat.centres_of(np.argwhere(flat.occupied))
    seen = nearest_returns(walls - origin, 90, 12.0)
    assert cast.bearings.tolist() == seen.bearings.tolist()
    assert np.median(np.abs(seen.ranges - cast.ranges)) < 0.06


HALF_M = 3.0  # of the side of a room around the origin


def walls_seen(pose: Pose2, bearings: FloatArray) -> FloatArray:
    """(B,) ranges in an empty square room."""
    angles = bearings + pose.theta
    with np.errstate(divide="ignore"):
        along_x = (np.copysign(HALF_M, np.cos(angles)) - pose.x) / np.cos(angles)
        along_y = (np.copysign(HALF_M, np.sin(angles)) - pose.y) / np.sin(angles)
    return np.minimum(along_x, along_y)


def scan_at(pose: Pose2, beams: int, full_circle: bool) -> PlanarScan:
    half = math.pi if full_circle else 0.5 * math.pi
    bearings = np.linspace(-half, half, beams, endpoint=not full_circle)
    return PlanarScan(0, bearings, walls_seen(pose, bearings), 20.0, full_circle)


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi, -2.5])
def test_a_room_seen_all_round_looks_from_a_step_aside_as_it_does_there(heading: float) -> None:
    here, there = Pose2(0.5, -1.0, heading), Pose2(0.3, -0.7, heading + 0.4)
    scan = scan_at(here, 720, full_circle=True)
    ranges = seen_from(outline(scan, here, 20.0), there, scan.bearings, 20.0)
    seen = np.isfinite(ranges)
    assert seen.mean() > 0.99  # the gap where the circle closes
    off = np.abs(ranges - walls_seen(there, scan.bearings))[seen]
    assert off.max() < 0.02  # corners are cut between two beams
    assert np.median(off) < 1e-5


def test_what_lies_behind_a_narrow_laser_is_not_made_up() -> None:
    here, there = Pose2(0.0, 0.0, 0.0), Pose2(0.0, 0.0, math.radians(30.0))
    scan = scan_at(here, 181, full_circle=False)
    lines = outline(scan, here, 20.0)
    ranges = seen_from(lines, there, scan.bearings, 20.0)
    assert np.isfinite(ranges[:150]).all()
    assert np.isinf(ranges[152:]).all()
    both = np.vstack([lines, outline(scan_at(there, 181, full_circle=False), there, 20.0)])
    assert np.isfinite(seen_from(both, there, scan.bearings, 20.0)).all()


def test_the_nearest_surface_hides_those_behind_it() -> None:
    near, far = [1.0, -1.0, 1.0, 1.0], [2.0, -4.0, 2.0, 4.0]
    bearings = np.radians([-50.0, 0.0, 50.0])
    ranges = seen_from(np.array([far, near]), Pose2(0.0, 0.0, 0.0), bearings, 20.0)
    behind = 2.0 / np.cos(bearings)
    assert ranges == pytest.approx([behind[0], 1.0, behind[2]], abs=1e-6)
    assert np.isinf(seen_from(np.array([far]), Pose2(0.0, 0.0, 0.0), bearings, 1.5)).all()


def test_no_line_joins_two_surfaces_or_a_return_with_none() -> None:
    ranges = np.array([2.0, 2.0, 4.0, 4.0, np.inf, 4.0, np.nan, 4.0, 4.0, 9.0])
    scan = PlanarScan(0, np.radians(np.arange(10.0)), ranges, 20.0, full_circle=False)
    pose = Pose2(1.0, 2.0, 0.3)
    lines = outline(scan, pose, 20.0)
    assert len(lines) == 3
    assert np.hypot(*(lines[:, :2] - [1.0, 2.0]).T) == pytest.approx([2.0, 4.0, 4.0])
    assert len(outline(scan, pose, 3.0)) == 1
    assert seen_from(np.zeros((0, 4)), pose, scan.bearings, 20.0).tolist() == [np.inf] * 10

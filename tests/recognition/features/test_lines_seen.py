"""What a laser would have seen from another place: against the walls that it saw."""

from __future__ import annotations

import math

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features.virtual import outline, seen_from

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
    return PlanarScan(
        stamp_ns=0,
        bearings=bearings,
        ranges=walls_seen(pose, bearings),
        range_max=20.0,
        full_circle=full_circle,
    )


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
    turned = scan_at(there, 181, full_circle=False)
    both = np.vstack([lines, outline(turned, there, 20.0)])
    assert np.isfinite(seen_from(both, there, scan.bearings, 20.0)).all()


def test_the_nearest_surface_hides_those_behind_it() -> None:
    near, far = [1.0, -1.0, 1.0, 1.0], [2.0, -4.0, 2.0, 4.0]
    bearings = np.radians([-50.0, 0.0, 50.0])
    ranges = seen_from(np.array([far, near]), Pose2(0.0, 0.0, 0.0), bearings, 20.0)
    assert ranges == pytest.approx(
        [2.0 / math.cos(bearings[0]), 1.0, 2.0 / math.cos(bearings[2])], abs=1e-6
    )
    assert np.isinf(seen_from(np.array([far]), Pose2(0.0, 0.0, 0.0), bearings, 1.5)).all()


def test_no_line_joins_two_surfaces_or_a_return_with_none() -> None:
    ranges = np.array([2.0, 2.0, 4.0, 4.0, np.inf, 4.0, np.nan, 4.0, 4.0, 9.0])
    scan = PlanarScan(
        stamp_ns=0,
        bearings=np.radians(np.arange(10.0)),
        ranges=ranges,
        range_max=20.0,
        full_circle=False,
    )
    pose = Pose2(1.0, 2.0, 0.3)
    lines = outline(scan, pose, 20.0)
    assert len(lines) == 3
    assert np.hypot(*(lines[:, :2] - [1.0, 2.0]).T) == pytest.approx([2.0, 4.0, 4.0])
    assert len(outline(scan, pose, 3.0)) == 1
    assert seen_from(np.zeros((0, 4)), pose, scan.bearings, 20.0).tolist() == [np.inf] * 10

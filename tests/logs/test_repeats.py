"""A driver that repeats one scan while the robot drives on."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.logs.planar import Repeats

SEEN = np.array([1.0, np.nan, 2.0, np.inf, 3.0])


def sweep(ranges: np.ndarray, pose: Pose2 | None) -> Sweep:
    bearings = np.linspace(-1.0, 1.0, len(ranges))
    planar = PlanarScan(0, bearings, ranges, 8.0, False)
    return Sweep(index=0, stamp_ns=0, planar=planar, base_from_laser=IDENTITY, odom_from_base=pose)


@pytest.mark.parametrize(
    ("ranges", "pose", "stale"),
    [
        (SEEN, Pose2(0.1, 0.0, 0.0), True),
        (SEEN, Pose2(0.0, 0.0, 0.1), True),
        (SEEN, Pose2(0.005, 0.0, 0.001), False),  # it stands still
        (SEEN, None, False),
        (SEEN + 0.001, Pose2(0.1, 0.0, 0.0), False),
        (SEEN[:-1], Pose2(0.1, 0.0, 0.0), False),
    ],
)
def test_only_a_scan_that_repeats_another_while_the_robot_moves_is_stale(
    ranges: np.ndarray, pose: Pose2 | None, stale: bool
) -> None:
    repeats = Repeats()
    assert not repeats.stale(sweep(SEEN, IDENTITY))
    assert repeats.stale(sweep(ranges.copy(), pose)) is stale


def test_motion_counts_from_the_first_of_the_scans_alike() -> None:
    repeats = Repeats()
    poses = [Pose2(0.008 * number, 0.0, 0.0) for number in range(5)]
    assert [repeats.stale(sweep(SEEN, pose)) for pose in poses] == [False] * 3 + [True] * 2


def test_blank_scans_are_no_repeats() -> None:
    repeats, blank = Repeats(), np.full(5, np.inf)
    assert not repeats.stale(sweep(blank, IDENTITY))
    assert not repeats.stale(sweep(blank, Pose2(1.0, 0.0, 0.0)))

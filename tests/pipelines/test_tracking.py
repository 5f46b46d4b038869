"""Scan matching a whole log: what is left out of it, and how that is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import Config
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from specmap_cli.pipelines.tracking import Tracking, track

SECOND = 1_000_000_000
HUNG = range(12, 30)
BEARINGS = np.linspace(-np.pi, np.pi, 240, endpoint=False)


def in_a_room(x: float) -> np.ndarray:
    """Ranges to the walls of a room of 12 m by 6 m, seen from (x, 0)."""
    with np.errstate(divide="ignore"):
        across = np.where(np.cos(BEARINGS) > 0, 7.0 - x, -5.0 - x) / np.cos(BEARINGS)
        along = np.where(np.sin(BEARINGS) > 0, 3.0, -3.0) / np.sin(BEARINGS)
    return np.minimum(across, along)


def write_hanging(path: Path) -> None:
    """A robot that drives 3.2 m; the driver of its laser hangs for 1.8 s."""
    rng = np.random.default_rng(2)
    held = np.zeros(0)
    with LogWriter(path) as log:
        for number in range(40):
            stamp, x = 100 * SECOND + number * SECOND // 10, 0.08 * number
            log.odometry("/odom", "odom", "base_link", stamp, Pose2(x, 0.0, 0.0))
            seen = in_a_room(x) + rng.normal(0.0, 0.01, len(BEARINGS))
            held = held if number in HUNG[1:] else seen
            step = float(BEARINGS[1] - BEARINGS[0])
            log.scan("/scan", "base_link", stamp, -np.pi, step, held, range_max=20.0)


def test_scans_that_a_hanging_driver_repeats_are_left_out_and_told(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_hanging(path)
    scans, done = [], None
    with open_log([path]) as log:
        tracking = track(SweepStream(log, Config().log), Config().registration)
        while done is None:
            try:
                scans.append(next(tracking))
            except StopIteration as end:
                done = end.value
    assert isinstance(done, Tracking)
    assert [scan.index for scan in scans] == [k for k in range(40) if k not in HUNG[1:]]
    errors = [abs(scan.map_from_base.x - 0.08 * scan.index) for scan in scans]
    assert max(errors) < 0.03
    assert not any(scan.lost for scan in scans)
    assert done.counts["stale_scans"] == len(HUNG) - 1
    assert done.warnings == (
        "17 scans repeat the one before although odometry says that the robot moved, and were left "
        "out: the driver of the laser hung",
    )

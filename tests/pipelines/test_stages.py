"""Stages of a build by themselves: tracking, regions compared again, tracks tied, time taken."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock, call

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import IDENTITY, Pose2, wrap_angles
from specmap_cli.core.records import PlanarScan, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.passes import METRES_A_RADIAN
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from specmap_cli.pipelines import exploration as module
from specmap_cli.pipelines.exploration import Exploration
from specmap_cli.pipelines.laying_out import nearest_pair
from specmap_cli.pipelines.session import Session, Stopwatch
from specmap_cli.pipelines.tracking import TrajectoryRecorder, track
from specmap_cli.pipelines.worker import Ahead
from specmap_cli.segmentation.online import Region
from tests.casting import keyframe
from tests.house import closure

SECOND = 1_000_000_000
HUNG = range(12, 30)
BEARINGS = np.linspace(-np.pi, np.pi, 240, endpoint=False)


def in_a_room(x: float) -> np.ndarray:
    """Ranges to the walls of a room of 12 m by 6 m, seen from (x, 0)."""
    with np.errstate(divide="ignore"):
        across = np.where(np.cos(BEARINGS) > 0, 7.0 - x, -5.0 - x) / np.cos(BEARINGS)
        along = np.where(np.sin(BEARINGS) > 0, 3.0, -3.0) / np.sin(BEARINGS)
    return np.minimum(across, along)


def test_scans_that_a_hanging_driver_repeats_are_left_out_and_told(tmp_path: Path) -> None:
    """Of a robot that drives 3.2 m; the driver of its laser hangs for 1.8 s."""
    rng, held = np.random.default_rng(2), np.zeros(0)
    with LogWriter(tmp_path / "log.mcap") as written:
        for number in range(40):
            stamp, x = 100 * SECOND + number * SECOND // 10, 0.08 * number
            written.odometry("/odom", "odom", "base_link", stamp, Pose2(x, 0.0, 0.0))
            seen = in_a_room(x) + rng.normal(0.0, 0.01, len(BEARINGS))
            held = held if number in HUNG[1:] else seen
            step = float(BEARINGS[1] - BEARINGS[0])
            written.scan("/scan", "base_link", stamp, -np.pi, step, held, range_max=20.0)
    with open_log([tmp_path / "log.mcap"]) as log:
        tracking = Ahead(track(SweepStream(log, Config().log), Config().registration))
        scans, done = list(tracking), tracking.result
    assert [scan.index for scan in scans] == [k for k in range(40) if k not in HUNG[1:]]
    assert max([abs(scan.map_from_base.x - 0.08 * scan.index) for scan in scans]) < 0.03
    assert not any(scan.lost for scan in scans)
    assert done.counts["stale_scans"] == len(HUNG) - 1
    assert done.warnings == (
        "17 scans repeat the one before although odometry says that the robot moved, and were left "
        "out: the driver of the laser hung",
    )


@pytest.mark.parametrize("rolls", [{}, {1: (0.1, -0.2, 0.5), 3: (-0.3, 0.05, 2.0)}])
def test_tilt_is_kept_from_the_first_3d_pose(rolls: dict[int, tuple[float, float, float]]) -> None:
    """Scans before it, and planar ones between, are level; a planar trajectory has no tilt."""
    recorder = TrajectoryRecorder()
    for k in range(5):
        matrix = None
        if k in rolls:
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_euler("xyz", rolls[k]).as_matrix()
            matrix[:3, 3] = (k, 0.0, 0.25 * k)
        scan = PlanarScan(k, np.zeros(0), np.zeros(0), 1.0, False)
        posed = keyframe(scan, Pose2(k, 2.0 * k, 0.1 * k), IDENTITY, k)
        recorder.append(replace(posed, map_from_base_3d=matrix))
    found = recorder.trajectory()
    assert len(recorder) == 5
    assert found.stamps_ns.tolist() == [0, 1, 2, 3, 4]
    assert found.poses[3].tolist() == pytest.approx([3.0, 6.0, 0.3])
    if not rolls:
        assert found.tilt is None
        return
    assert found.tilt is not None
    assert found.tilt.shape == (5, 3)
    for k, (roll, pitch, _) in rolls.items():
        assert found.tilt[k] == pytest.approx([0.25 * k, roll, pitch])
    assert np.abs(found.tilt[[0, 2, 4]]).max() == 0.0


def test_a_region_that_grew_is_compared_again_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "online_labels", Mock(return_value=np.zeros(0, dtype=np.int64)))
    monkeypatch.setattr(Exploration, "_stay", lambda self, number: list(self.regions[number]))
    with KeyframeStore() as store:
        exploration = Exploration(Session(load_config(), store))
        closer = exploration.closer = Mock()
        closer.consider.side_effect = [[], [closure(0, 1)]]
        closer.consider_again.return_value = [closure(1, 0, merged=True)]
        exploration.recognise([Region(0, (0, 1), None), Region(1, (2,), None), Region(2, (3,), 1)])
        exploration.recognise_again()
        assert closer.grow.mock_calls == [call([2, 3])]
        assert closer.consider_again.mock_calls == [call(1)]
        explored = exploration.explored(Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3))))
        assert explored.closures == (closure(1, 0, merged=True),)
        assert explored.regions == {0: (0, 1), 1: (2, 3)}
        closer.merge.assert_called_once_with(1, 0)


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_poses_of_two_tracks_are_those_of_all_pairs(seed: int) -> None:
    """There two tracks are tied: where they saw most alike."""
    rng = np.random.default_rng(seed)
    old, new = (rng.uniform(-3.0, 3.0, (count, 3)) for count in (40, 70))
    gaps = old[:, None] - new[None]
    apart = np.hypot(gaps[..., 0], gaps[..., 1])
    apart = apart + METRES_A_RADIAN * np.abs(wrap_angles(gaps[..., 2]))
    i, j = nearest_pair(old, new)
    assert i * len(new) + j == apart.argmin()
    row = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.0], [2.0, 0.0, 0.0]])
    assert nearest_pair(row, row + (0.0, 1.0, 0.0)) == (0, 0), "of those as near the first"


def test_each_stage_is_counted_once_though_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where each look at the clock takes a second."""
    ticks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(ticks)))
    clock = Stopwatch()  # tick 0
    with clock.stage("outer"):  # tick 1
        time.perf_counter()  # tick 2: work of its own
        with clock.stage("inner"):  # tick 3
            pass  # tick 4
    # tick 5
    with clock.stage("outer"):  # tick 6
        pass  # tick 7
    assert clock.seconds == {"outer": 2.0 + 1.0 + 1.0, "inner": 1.0}
    with pytest.raises(RuntimeError), clock.stage("work"):
        raise RuntimeError
    assert clock.seconds["work"] == 1.0

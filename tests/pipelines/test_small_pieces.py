"""What only the pipelines need: the trajectory as it grows, the seconds of the stages."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.pipelines.session import Stopwatch
from specmap_cli.pipelines.tracking import TrajectoryRecorder

SCAN = PlanarScan(0, np.zeros(0), np.zeros(0), 1.0, False)


def posed(stamp: int, pose: Pose2, in_space: np.ndarray | None = None) -> PosedScan:
    return PosedScan(
        index=stamp,
        stamp_ns=stamp,
        map_from_base=pose,
        planar=SCAN,
        base_from_laser=Pose2(0.0, 0.0, 0.0),
        map_from_base_3d=in_space,
    )


def test_a_planar_trajectory_has_no_tilt() -> None:
    recorder = TrajectoryRecorder()
    for k in range(5):
        recorder.append(posed(k, Pose2(k, 2.0 * k, 0.1 * k)))
    found = recorder.trajectory()
    assert len(recorder) == 5
    assert found.stamps_ns.tolist() == [0, 1, 2, 3, 4]
    assert found.poses[3].tolist() == pytest.approx([3.0, 6.0, 0.3])
    assert found.tilt is None


def test_height_roll_and_pitch_are_kept_from_the_first_3d_pose_on() -> None:
    """Scans before it, and planar ones between, are level."""
    recorder = TrajectoryRecorder()
    rolls = {1: (0.1, -0.2, 0.5), 3: (-0.3, 0.05, 2.0)}
    for k in range(5):
        matrix = None
        if k in rolls:
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_euler("xyz", rolls[k]).as_matrix()
            matrix[:3, 3] = (k, 0.0, 0.25 * k)
        recorder.append(posed(k, Pose2(k, 0.0, 0.0), matrix))
    tilt = recorder.trajectory().tilt
    assert tilt is not None
    assert tilt.shape == (5, 3)
    for k, (roll, pitch, _) in rolls.items():
        assert tilt[k] == pytest.approx([0.25 * k, roll, pitch])
    assert np.abs(tilt[[0, 2, 4]]).max() == 0.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Stopwatch:
    """A stopwatch in whose time each look at the clock takes a second."""
    ticks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(ticks)))
    return Stopwatch()  # tick 0


def test_a_stage_inside_another_is_counted_once(clock: Stopwatch) -> None:
    with clock.stage("outer"):  # tick 1
        time.perf_counter()  # tick 2: work of its own
        with clock.stage("inner"):  # tick 3
            pass  # tick 4
    # tick 5
    with clock.stage("outer"):  # tick 6
        pass  # tick 7
    assert clock.seconds == {"outer": 2.0 + 1.0 + 1.0, "inner": 1.0}


def test_a_stage_that_fails_is_counted(clock: Stopwatch) -> None:
    with pytest.raises(RuntimeError), clock.stage("work"):
        raise RuntimeError
    assert clock.seconds == {"work": 1.0}

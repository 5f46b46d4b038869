"""The front end on simulated drives: accurate, honest about what is lost, always bounded."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.config import load_config
from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.registration.frontend import Track
from specmap_cli.registration.local_map import Fit
from specmap_cli.registration.trust import Judgement
from tests.registration.drives import (
    circle,
    odometry_of,
    path,
    run,
    sweeps,
    with_clouds,
    with_odometry,
    with_ranges,
    worst,
)
from tests.registration.street import STEP_M, drive, way
from tests.strategies import few, poses


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize(
    ("view", "beams", "reach"),
    [(np.pi, 180, 10.0), (1.5 * np.pi, 720, 10.0), (2 * np.pi, 240, 10.0), (2 * np.pi, 360, 4.0)],
)
def test_tracks_lasers_of_all_kinds(
    world: GridMap, view: float, beams: int, reach: float, odometry: bool
) -> None:
    truth = path()
    front_end, scans = run(sweeps(world, truth, view, beams, reach, odometry))
    assert np.less(worst(scans, truth), (0.08, 0.03)).all()
    assert front_end.counts["registered"] == len(scans)
    assert front_end.counts["lost"] == front_end.counts["breaks"] == 0
    assert front_end.warnings == []
    assert not any(scan.restarted for scan in scans)
    assert min(scan.score for scan in scans) > 0.5


def test_a_kidnapped_robot_is_noticed_and_goes_on_from_a_guess(world: GridMap) -> None:
    there = path()[:40]
    elsewhere = np.column_stack([np.linspace(26, 29, 30), np.full(30, 2.0), np.zeros(30)])
    items = sweeps(world, np.vstack([there, elsewhere]))
    # odometry knows nothing of the move
    back = odometry_of(items[39]) @ odometry_of(items[40]).inverse()
    items[40:] = [with_odometry(sweep, lambda odom: back @ odom) for sweep in items[40:]]
    front_end, scans = run(items)
    assert [scan.index for scan in scans if scan.lost] == [40, 41, 42, 43, 44]
    assert [scan.index for scan in scans if scan.restarted] == [45]
    assert front_end.counts["breaks"] == 1
    assert worst(scans[45:], np.array(elsewhere[5:]))[0] < 0.08
    jumps = np.hypot(*np.diff([scan.map_from_base[:2] for scan in scans], axis=0).T)
    assert jumps.max() < 0.3


@pytest.mark.parametrize(("reading", "lost"), [(np.nan, [10, 11]), (np.inf, [])])
def test_blank_scans_keep_odometry_s_pose(world: GridMap, reading: float, lost: list[int]) -> None:
    """Without a valid reading nothing was seen; without a return, that there are no walls."""
    items = sweeps(world, path()[:30])
    for k in (10, 11):
        items[k] = with_ranges(items[k], np.full(240, reading))
    front_end, scans = run(items)
    assert [scan.index for scan in scans if scan.lost] == lost
    assert worst(scans, path()[:30])[0] < 0.1
    assert front_end.counts["breaks"] == 0


def test_random_scans_never_make_the_pose_fly_off() -> None:
    rng = np.random.default_rng(3)
    _, scans = run([circle(k, rng.uniform(0.2, 9, 120)) for k in range(30)])
    poses = np.array([scan.map_from_base for scan in scans])
    assert np.isfinite(poses).all()
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 3.0


def test_an_odometry_reset_is_no_motion_and_wrong_headings_are_survived(world: GridMap) -> None:
    """Wheels and laser out of step: one increment 15 degrees too far, the next back."""
    truth = path()
    items = sweeps(world, truth)
    for k in (30, 50, 70):
        items[k] = with_odometry(items[k], lambda odom: odom @ Pose2(0.0, 0.0, 0.26))
    items[20:] = [with_odometry(s, lambda odom: Pose2(500.0, 0.0, 0.0) @ odom) for s in items[20:]]
    front_end, scans = run(items)
    assert front_end.counts["odometry_jumps"] == 1
    assert worst(scans, truth)[0] < 0.08
    assert front_end.counts["lost"] == 0


@pytest.mark.parametrize("jump_rad", [1.4, -1.8])
def test_a_heading_of_odometry_that_jumps_is_no_turn(world: GridMap, jump_rad: float) -> None:
    """A laser of 180 degrees sees mostly new space where such a turn would have led."""
    truth = path()[:60]
    items = sweeps(world, truth, np.pi, 181)
    before = odometry_of(items[29])
    jump = before @ Pose2(0.0, 0.0, jump_rad) @ before.inverse()
    items[30:] = [with_odometry(sweep, lambda odom: jump @ odom) for sweep in items[30:]]
    front_end, scans = run(items)
    assert np.less(worst(scans, truth), (0.08, 0.03)).all()
    assert front_end.counts["lost"] == 0


def test_stamps_in_bursts_and_backwards_do_not_matter(world: GridMap) -> None:
    truth = path()[:50]
    items = sweeps(world, truth, odometry=False)
    stamps = [10**9 + k // 3 * 10**8 + k % 3 - (0 if k % 7 else 5 * 10**7) for k in range(50)]
    items = [dataclasses.replace(s, stamp_ns=t) for s, t in zip(items, stamps, strict=True)]
    assert worst(run(items)[1], truth)[0] < 0.08


def test_a_resting_robot_without_odometry_does_not_begin_to_swing(world: GridMap) -> None:
    """Each error of the estimated motion comes back through de-skewing, and must die out."""
    truth = np.tile(path()[10], (60, 1))
    items = sweeps(world, truth, odometry=False)
    for k, sweep in enumerate(items):
        timed = dataclasses.replace(sweep.planar, beam_times_s=np.linspace(0.0, 0.1, 240))
        items[k] = dataclasses.replace(sweep, planar=timed)
    assert worst(run(items)[1], truth)[0] < 0.03


def test_a_3d_lidar_is_tracked_in_space(world: GridMap) -> None:
    truth = path()[::3]
    _, scans = run(with_clouds(world, truth))
    assert np.less(worst(scans, truth), (0.1, 0.03)).all()
    for scan in scans:
        assert scan.map_from_base_3d is not None
        assert Pose2.from_matrix(scan.map_from_base_3d) == scan.map_from_base
        assert abs(scan.map_from_base_3d[2, 3]) < 0.15  # six rings say little about height
        assert scan.map_from_base_3d[2, 2] > np.cos(0.05)


@few(8)
@given(poses)
def test_the_frame_of_odometry_does_not_matter(world: GridMap, frame: Pose2) -> None:
    items = sweeps(world, path()[:6])
    moved = [with_odometry(sweep, lambda odom: frame @ odom) for sweep in items]
    found = [[scan.map_from_base for scan in run(each)[1]] for each in (items, moved)]
    assert np.abs(np.diff(found, axis=0)).max() < 1e-3


@pytest.mark.parametrize("odometry", [True, False])
def test_a_map_begins_at_the_first_sweep_and_records_go_on(world: GridMap, odometry: bool) -> None:
    items = sweeps(world, path()[:5], odometry=odometry)
    _, scans = run(items)
    first = scans[0]
    assert first.map_from_base == IDENTITY
    assert (first.score, first.agrees, first.lost, first.restarted) == (1.0, True, False, False)
    for sweep, scan in zip(items, scans, strict=True):
        assert (scan.index, scan.stamp_ns) == (sweep.index, sweep.stamp_ns)
        assert scan.base_from_laser == sweep.base_from_laser
        assert scan.planar is sweep.planar  # its beams share one time: nothing to de-skew
        assert scan.map_from_base_3d is None
        assert 0.0 <= scan.score <= 1.0


TURNING = np.column_stack([np.full((13, 2), (2.0, 2.4)), 0.44 * np.clip(np.arange(13) - 4, 0, 5)])
HOLE = np.repeat([[2.0, 2.4, 0.0], [2.6, 2.9, 0.87]], 6, axis=0)


@pytest.mark.parametrize(
    ("truth", "search"),
    [
        (TURNING, "searched"),  # by 25 degrees a scan, which no motion before tells of
        (HOLE, "wide_searched"),  # in it the robot drove 0.8 m and turned by 50 degrees
    ],
)
def test_what_no_odometry_tells_is_searched(world: GridMap, truth: FloatArray, search: str) -> None:
    front_end, scans = run(sweeps(world, truth, odometry=False))
    assert np.less(worst(scans, truth), (0.08, 0.03)).all()
    assert front_end.counts[search] > 0
    assert front_end.counts["lost"] == 0


@pytest.mark.parametrize(("key", "value"), [("min_points", 0), ("max_tilt_rad", 2.0)])
def test_settings_that_cannot_work_are_refused(key: str, value: float) -> None:
    with pytest.raises(UsageError, match=rf"registration\.{key}"):
        load_config(overrides={"registration": {key: value}})


@pytest.mark.parametrize("bias", [-0.05, 0.05])
@pytest.mark.parametrize("every", [6, 12])  # steps of some 0.5 and 1 m
def test_a_sparse_log_with_odometry_loses_no_scan(world: GridMap, every: int, bias: float) -> None:
    truth = path()
    items = sweeps(world, truth, reach=4.0)[::every]
    for k, (x, y, theta) in enumerate(truth[::every].tolist()):
        biased = Pose2((1.0 + bias) * x, (1.0 + bias) * y, theta)
        items[k] = dataclasses.replace(items[k], odom_from_base=biased)
    front_end, scans = run(items)
    assert front_end.counts["lost"] == front_end.counts["breaks"] == 0
    metres, radians = worst(scans, truth[::every])
    assert metres < 0.25  # odometry alone ends 0.37 m off
    assert radians < 0.03


def test_a_fast_vehicle_is_followed_without_odometry() -> None:
    truth = way(32)
    _, scans = run(drive(truth))
    assert sum(scan.lost for scan in scans) <= 2
    assert not any(scan.restarted for scan in scans)
    for k in range(22, len(truth)):
        step = scans[k - 1].map_from_base.inverse() @ scans[k].map_from_base
        true = truth[k - 1].inverse() @ truth[k]
        assert true.x == pytest.approx(STEP_M, abs=0.02)
        assert (true.inverse() @ step).distance < 0.1
    away = (truth[0].inverse() @ truth[-1]).inverse() @ scans[-1].map_from_base
    assert away.distance < 0.08 * truth[-1].x
    assert abs(away.theta) < 0.02


def test_wheels_that_slip_are_noticed_or_mended(world: GridMap) -> None:
    """Odometry drives on by 0.5 m that the robot does not: no scan is believed 0.3 m off."""
    truth = path()
    items = sweeps(world, truth)
    items[40:] = [with_odometry(s, lambda odom: odom @ Pose2(0.5, 0.0, 0.0)) for s in items[40:]]
    _, scans = run(items)
    kept = [k for k, scan in enumerate(scans) if not scan.lost]
    assert len(kept) > 85
    assert worst([scans[k] for k in kept], truth[kept])[0] < 0.3


def test_the_motion_carried_on_is_the_usual_one_straight_on() -> None:
    """The last ones before a bare corridor, which registration makes too short, do not count."""
    here = Pose2(2.0, 1.0, np.pi / 2)
    track = Track(pose=here.matrix())
    assert track.carried_on == pytest.approx(here), "without a motion that walls fixed it stands"
    steady = [Pose2(forward_m, 0.02, 0.3) for forward_m in (*[0.5] * 10, *[0.1] * 5)]
    track = dataclasses.replace(track, steady=tuple(steady))
    assert here.inverse() @ track.carried_on == pytest.approx(Pose2(0.5, 0.02, 0.0))
    assert Track().carried_on == IDENTITY


def test_what_was_guessed_adds_up_and_says_little_of_the_next_motion() -> None:
    """A metre at a time along x; walls fix two fifths of the first one, and nearly all later."""
    track = Track()
    for x, loose in ((1.0, 0.6), (2.0, 0.0), (3.0, 0.1)):
        fit = Fit(pose=Pose2(x, 0.0, 0.0).matrix(), score=0.9)
        judgement = Judgement(fit=fit, loose=np.array([loose, 0.0]))
        track = track.guessing(judgement, Pose2(x, 0.0, 0.0))
        track = dataclasses.replace(track, pose=fit.pose)
    assert track.guessed_m == pytest.approx((0.2 * (0.36 + 0.01), 0.0))
    assert track.steady == (Pose2(2.0, 0.0, 0.0), Pose2(3.0, 0.0, 0.0))
    assert track.guessing(Judgement(fit=fit), None).steady == track.steady, "too few walls"

"""The front end on simulated drives and a real log: accurate, honest about losses and limits."""

import dataclasses
import itertools
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.odometry import SIGMAS, UNMEASURED
from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import LogConfig, RegistrationConfig
from specmap_cli.evaluation.trajectories import read_relations, relation_errors
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.registration import FrontEnd, SensorKind
from specmap_cli.registration.frontend import COUNTS, Track
from specmap_cli.registration.guess import SEARCH_RAD, Reliance
from specmap_cli.registration.local_map import Fit
from specmap_cli.registration.trust import Judgement
from tests.registration.aligners import ToldAligner, offer
from tests.registration.drives import (
    circle,
    odometry_of,
    path,
    run,
    sweeps,
    turned,
    with_clouds,
    with_odometry,
    with_ranges,
    worst,
)
from tests.registration.street import STEP_M, drive, way
from tests.strategies import few, poses
from tests.turning import turned as constants


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize(
    ("view", "beams", "reach"),
    [(np.pi, 180, 10.0), (1.5 * np.pi, 720, 10.0), (2 * np.pi, 240, 10.0), (2 * np.pi, 360, 4.0)],
)
def test_all_lasers(world: GridMap, view: float, beams: int, reach: float, odometry: bool) -> None:
    front_end, scans = run(sweeps(world, truth := path(), view, beams, reach, odometry))
    assert np.less(worst(scans, truth), (0.08, 0.03)).all()
    assert front_end.counts["registered"] == len(scans)
    assert front_end.counts["lost"] == front_end.counts["breaks"] == 0
    assert front_end.warnings == []
    assert not any(scan.restarted for scan in scans)
    assert min(scan.score for scan in scans) > 0.5
    assert all((scan.odometry_slacks != UNMEASURED) == odometry for scan in scans[1:])


def test_what_a_depth_camera_leaves_open_odometry_tells(world: GridMap) -> None:
    draws = [sweeps(world, truth := path(), 1.0, 160, 4.0, seed=seed) for seed in range(3)]
    errors = np.mean([worst(run(items)[1], truth) for items in draws], axis=0)
    assert np.less(errors, (0.15, 0.04)).all()
    with constants("registration.local_map", _NARROW_RAD=0.0, _FEW_RAD=0.0):
        errors = np.mean([worst(run(items)[1], truth) for items in draws], axis=0)
    assert np.greater(errors, (0.25, 0.1)).all()


def test_along_a_bare_corridor_a_depth_camera_does_not_stand_still() -> None:
    """Centimetres from scan to scan: odometry, 5 % off, tells more than walls that look alike."""
    cells = np.full((60, 400), OCCUPIED, dtype=np.uint8)
    cells[10:50, 10:390] = FREE
    x = np.arange(2.0, 8.0, 0.025)
    truth = np.column_stack([x, np.full(len(x), 1.5), np.zeros(len(x))])
    _, scans = run(sweeps(GridMap(cells, 0.05), truth, 1.5, 200, 6.0))
    assert np.less(worst(scans, truth), (0.6, 0.03)).all()


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
    config = front_end.config
    assert scans[45].bridge == (config.max_shift_m / SIGMAS, SEARCH_RAD / SIGMAS)
    assert worst(scans[45:], np.array(elsewhere[5:]))[0] < 0.08
    assert np.hypot(*np.diff([scan.map_from_base[:2] for scan in scans], axis=0).T).max() < 0.3


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


def test_blank_scans_that_end_a_map_do_not_contradict_odometry(world: GridMap) -> None:
    items = sweeps(world, path()[:30])
    items[10:18] = [with_ranges(sweep, np.full(240, np.nan)) for sweep in items[10:18]]
    (bridge,) = (scan.bridge for scan in run(items)[1] if scan.restarted)
    assert bridge is not None
    assert np.less(bridge, (0.2, 0.1)).all()


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


def test_after_a_hole_in_the_log_a_new_map_begins_where_odometry_led(world: GridMap) -> None:
    """Six metres on a laser sees nothing that it saw before, and odometry has turned meanwhile."""
    truth = np.zeros((40, 3)) + (25.6, 1.4, 0.0) + np.arange(40)[:, None] * (0.05, 0.0, 0.0)
    truth[30:] += (4.5, 2.6, 0.0)
    items = sweeps(world, truth, reach=2.0)
    turn = odometry_of(items[29]) @ Pose2(0.0, 0.0, 0.1) @ odometry_of(items[29]).inverse()
    for k in range(30, 40):
        late = with_odometry(items[k], lambda odom: turn @ odom)
        items[k] = dataclasses.replace(late, stamp_ns=late.stamp_ns + 10**11)
    front_end, scans = run(items)
    assert [scan.index for scan in scans if scan.bridge] == [30]
    assert worst(scans, truth)[0] < 0.9
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
    track = Track(measured=False)
    for x, loose in ((1.0, 0.6), (2.0, 0.0), (3.0, 0.1)):
        fit = Fit(pose=Pose2(x, 0.0, 0.0).matrix(), score=0.9)
        track = track.guessing(Judgement(fit=fit, loose=np.array([loose, 0.0])), Pose2(x, 0.0, 0.0))
        track = dataclasses.replace(track, pose=fit.pose)
    assert track.guessed_m == pytest.approx((0.2 * (0.36 + 0.01), 0.0))
    assert track.steady == (Pose2(2.0, 0.0, 0.0), Pose2(3.0, 0.0, 0.0))
    assert track.guessing(Judgement(fit=fit), None).steady == track.steady, "too few walls"


def test_what_wheels_measured_along_open_walls_errs_as_they_do() -> None:
    moved_on = Fit(pose=Pose2(1.0, 0.0, 0.0).matrix(), score=0.9)
    judgement = Judgement(fit=moved_on, loose=np.array([1.0, 0.0]))
    good = Reliance(along=(0.01,) * 60)
    for track, sigma_m in ((Track(), 0.2 / SIGMAS), (Track(reliance=good), 0.1 / SIGMAS)):
        assert track.guessing(judgement, None).guessed_m == pytest.approx((sigma_m, 0.0))


def test_what_is_said_of_a_limit() -> None:
    front_end = FrontEnd(RegistrationConfig(min_points=12))
    assert set(front_end.counts) == set(COUNTS)
    assert front_end.warnings == []
    sentences = [
        "registration carried the motion before on to 2,000 scans only in part: raise "
        "registration.carried_forward_m, carried_sideways_m and carried_rad for a fast robot",
        "registration met 3 scans with fewer than 12 wall points (registration.min_points): "
        "they are placed by odometry that is trusted, or lost",
    ]
    front_end.counts.update(shortened_motions=2000, few_points=3)
    assert front_end.warnings == sentences
    front_end.counts.update(dict.fromkeys(COUNTS, 1))
    named = re.findall(r"\w+_\w+", " ".join(front_end.warnings))
    assert len(named) == 9
    assert set(named) <= set(RegistrationConfig.model_fields), "settings that exist"


def straight(step_m: float, count: int) -> FloatArray:
    """A drive straight on through the first room."""
    return np.column_stack([1.0 + step_m * np.arange(count), np.full(count, 2.4), np.zeros(count)])


def test_a_robot_too_fast_for_the_motion_to_be_carried_on_is_told(world: GridMap) -> None:
    items = sweeps(world, straight(0.6, 6), odometry=False)
    front_end, scans = run(items)
    assert front_end.counts["shortened_motions"] == 1  # then walls have confirmed two such motions
    assert worst(scans, straight(0.6, 6))[0] < 0.1
    assert "registration.carried_forward_m" in front_end.warnings[0]
    assert run(items, carried_forward_m=1.0)[0].counts["shortened_motions"] == 0


@pytest.mark.parametrize("odometry", [True, False])
def test_odometry_carries_on_where_too_few_walls_are_seen(world: GridMap, odometry: bool) -> None:
    """A drive on which the scans 4 and 7 see next to nothing."""
    items = sweeps(world, path()[:10], odometry=odometry)
    for k in (4, 7):
        ranges = np.where(np.arange(240) < 9, items[k].planar.ranges, np.inf)
        items[k] = with_ranges(items[k], ranges)
    front_end, scans = run(items)
    assert front_end.counts["few_points"] == 2
    assert len(front_end.warnings) == 1
    assert [scan.index for scan in scans if scan.score == 0.0] == [4, 7]
    assert [scan.index for scan in scans if scan.lost] == ([] if odometry else [4, 7])
    if odometry:
        assert worst(scans, path()[:10])[0] < 0.05
    else:
        assert all(scan.agrees for scan in scans if scan.lost)
        assert run(items, min_points=3)[0].counts["few_points"] == 0


@pytest.mark.parametrize(("way_m", "lost"), [(3.0, False), (12.0, True)])
def test_odometry_carries_only_so_far(world: GridMap, way_m: float, lost: bool) -> None:
    """An odometry of which nothing is known errs by 5 cm and a fifth of the way: 1.5 m in 5 m."""
    seen = sweeps(world, np.tile(path()[0], (3, 1)))
    blind, base = with_ranges(seen[-1], np.full(240, np.inf)), odometry_of(seen[-1])
    for k, step_m in enumerate(np.arange(0.5, way_m + 0.1, 0.5).tolist(), start=3):
        led = base @ Pose2(step_m, 0.0, 0.0)
        later = (k - 2) * 10**8 + blind.stamp_ns
        seen.append(dataclasses.replace(blind, index=k, stamp_ns=later, odom_from_base=led))
    _, scans = run(seen)
    assert scans[-1].lost == lost
    assert not scans[3].lost


def test_so_many_lost_sweeps_in_a_row_end_a_map_but_for_the_first() -> None:
    limit, walls, blank = 5, np.random.default_rng(5).uniform(2.0, 4.0, 90), np.full(90, np.inf)
    pattern = [walls, *[blank] * (limit - 1), walls, *[blank] * (limit + 2), walls]
    front_end, scans = run([circle(k, r) for k, r in enumerate(pattern)])
    assert front_end.counts["breaks"] == 1
    assert [scan.restarted for scan in scans] == [False] * (len(scans) - 1) + [True]
    assert front_end.counts["lost"] == 2 * limit + 1
    # blank of readings: lost as well, and survived where the map begins
    unread = np.full(90, np.nan)
    front_end, scans = run([*(circle(k, unread) for k in range(8)), circle(8, walls)])
    assert front_end.counts["breaks"] == 0
    assert [scan.lost for scan in scans] == [True] * 8 + [False]
    assert all(scan.map_from_base == IDENTITY for scan in scans)
    assert not scans[-1].restarted


def test_keyframes_lie_where_scans_lie(world: GridMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also the first one of a new map, at a tilt that is partly taken back."""
    aligner = ToldAligner(lambda guess: guess @ turned(0.0, 0.0, 0.02))
    items = with_clouds(world, path()[:30:2])
    items[6:11] = [with_ranges(sweep, np.full(240, np.nan)) for sweep in items[6:11]]
    method = offer(monkeypatch, aligner)
    front_end, scans = run(items, method=method, cloud_voxel_m=0.15, cloud_range_m=12.0)
    kind = SensorKind(in_space=True, voxel_m=0.15, range_m=12.0)
    assert aligner.sensors == [kind]  # one aligner for all sweeps
    assert front_end.counts["breaks"] == aligner.cleared == 1
    assert [scan.index for scan in scans if scan.restarted] == [11]
    handed_on = [scan.map_from_base_3d for scan in scans]
    for _, pose in aligner.inserted:
        assert any(other is not None and np.array_equal(pose, other) for other in handed_on)
    upright = [float(pose[2, 2]) for pose in handed_on if pose is not None]
    assert upright[5] == pytest.approx(upright[7], abs=1e-12)  # what is lost keeps its guess
    assert upright[7] < upright[11] < 1.0 - 1e-5


def test_keyframes_come_by_way_or_by_turn(world: GridMap, monkeypatch: pytest.MonkeyPatch) -> None:
    turns = np.column_stack([np.full(10, 2.0), np.full(10, 2.4), 0.1 * np.arange(10)])
    cases = ((straight(0.08, 12), 3), (straight(0.02, 12), 1), (turns, 4))  # after 4 and 8 steps
    for truth, expected in cases:
        aligner = ToldAligner()
        exact = [
            dataclasses.replace(sweep, odom_from_base=Pose2(*pose))
            for sweep, pose in zip(sweeps(world, truth), truth.tolist(), strict=True)
        ]
        run(exact, method=offer(monkeypatch, aligner))
        assert len(aligner.inserted) == expected
        assert np.array_equal(aligner.inserted[0][1], IDENTITY.matrix())


def test_walls_beyond_the_score_field_are_counted(world: GridMap) -> None:
    items = sweeps(world, path()[:10])
    assert run(items, max_range_m=4.0)[0].counts["walls_left_out"] == 0
    narrow, _ = run(items, max_range_m=4.0, field_ranges=1.0)
    assert narrow.counts["walls_left_out"] == 9  # all but the first, which is scored on nothing


DATA = Path(os.environ.get("SPECMAP_DATA", "../shared/data"))


@pytest.mark.skipif(
    not (DATA / "logs" / "fr079.mcap").exists(),
    reason=f"no fr079.mcap in {DATA}/logs; SPECMAP_DATA names the folder",
)
@pytest.mark.parametrize("odometry", [True, False])
def test_relations_of_fr079_hold(odometry: bool) -> None:
    config = LogConfig(use_odometry=odometry)
    front_end = FrontEnd(RegistrationConfig())
    with open_log([DATA / "logs" / "fr079.mcap"]) as log:
        sweeps = itertools.islice(SweepStream(log, config), 700)
        scans = [front_end.register(sweep) for sweep in sweeps]
    trajectory = Trajectory(
        np.array([scan.stamp_ns for scan in scans]),
        np.array([scan.map_from_base for scan in scans]),
    )
    found = relation_errors(trajectory, read_relations(DATA / "truth" / "fr079.relations"))
    assert found.matched > 150
    assert found.translation_m.mean < 0.045
    assert found.rotation_deg.mean < 0.7
    assert front_end.counts["lost"] <= 1

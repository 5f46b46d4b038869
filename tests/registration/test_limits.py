"""Every limit of the front end that is hit is counted, and said in plain words if it matters."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.registration import FrontEnd, SensorKind
from specmap_cli.registration.frontend import COUNTS
from tests.registration.aligners import ToldAligner, offer
from tests.registration.drives import (
    circle,
    odometry_of,
    path,
    run,
    sweeps,
    turned,
    with_clouds,
    with_ranges,
    worst,
)


def test_what_is_said_of_a_limit() -> None:
    front_end = FrontEnd(RegistrationConfig(min_points=12))
    assert set(front_end.counts) == set(COUNTS)
    assert front_end.warnings == []
    sentences = [
        "registration met 1 jump of odometry beyond registration.odometry_jump_m and "
        "odometry_jump_mps: the motion before was carried on instead",
        "registration carried the motion before on to 2,000 scans only in part: raise "
        "registration.carried_forward_m, carried_sideways_m and carried_rad for a fast robot",
        "registration met 3 scans with fewer than 12 wall points (registration.min_points): "
        "they are placed by odometry that is trusted, or lost",
        "registration refused 2 alignments that ended farther from the guess, or tilted more, "
        "than registration.max_shift_m, max_shift_rad and max_tilt_rad allow",
    ]
    front_end.counts.update(
        odometry_jumps=1, shortened_motions=2000, few_points=3, refused_alignments=2
    )
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
    truth = path()[:30:2]
    items = with_clouds(world, truth)
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
    for truth, expected in (
        (straight(0.08, 12), 3),  # after 4 and 8 steps
        (straight(0.02, 12), 1),
        (turns, 4),
    ):
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

"""Scans and clouds made planar, against direct geometry in space; readings that are no walls."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.clouds import CloudFlattener
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.messages import BadMessageError, ScanLayout, ScanRecord
from specmap_cli.logs.planar import Ceiling, OwnBody, Repeats, ScanLeveller
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import sweeps_of
from tests.strategies import few
from tests.turning import configured


def record(
    ranges: ArrayLike,
    angle_min: float = -1.0,
    step: float = 0.1,
    *,
    angle_max: float = 0.0,
    time_increment: float = 0.0,
    range_max: float = 8.0,
) -> ScanRecord:
    values = np.asarray(ranges, dtype=np.float32)
    layout = ScanLayout(
        angle_min=angle_min,
        angle_max=angle_max,
        angle_increment=step,
        time_increment=time_increment,
        beams=len(values),
    )
    return ScanRecord(
        stamp_ns=7, frame="laser", layout=layout, range_min=0.1, range_max=range_max, ranges=values
    )


def levelled(scan: ScanRecord) -> PlanarScan:
    return ScanLeveller(np.eye(4)).level(scan, 5)


def mounted(roll: float, pitch: float, yaw: float, x: float, y: float, z: float) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    matrix[:3, 3] = x, y, z
    return matrix


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_of_too_many_beams_every_so_manieth_is_read(turned: float) -> None:
    count, step = 50_001, 1e-4
    ranges = 2.0 + np.sin(-2.5 + step * np.arange(count))
    angles = -2.5 * turned, step * turned
    found = levelled(record(ranges[:: round(turned)], *angles, time_increment=1e-6))
    assert 1000 < len(found.ranges) <= 3600
    np.testing.assert_allclose(np.diff(found.bearings), np.diff(found.bearings)[0], atol=1e-9)
    np.testing.assert_allclose(found.ranges, 2.0 + np.sin(found.bearings), atol=1e-3)
    assert found.beam_times_s is not None
    late = (found.bearings + 2.5) / step * 1e-6
    expected = late if turned > 0 else (count - 1) * 1e-6 - late
    np.testing.assert_allclose(found.beam_times_s, expected, atol=1e-5)


@few(30)
@given(
    flip=st.sampled_from([(0.0, 0.0), (math.pi, 0.0), (0.0, math.pi), (math.pi, math.pi)]),
    yaw=st.floats(-3.1, 3.1),
    x=st.floats(-1.0, 1.0),
    step=st.sampled_from([0.05, -0.05]),
    beams=st.integers(2, 60),
)
def test_returns_are_where_the_mounted_laser_saw_them(
    flip: tuple[float, float], yaw: float, x: float, step: float, beams: int
) -> None:
    base_from_laser = mounted(*flip, yaw, x, -0.2, 0.4)
    ranges = np.linspace(1.0, 3.0, beams).astype(np.float32)
    angles = 0.3 + step * np.arange(beams)
    in_laser = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    flat = np.column_stack([in_laser, np.zeros(beams), np.ones(beams)])
    expected = (flat @ base_from_laser.T)[:, :2]
    leveller = ScanLeveller(base_from_laser)
    scan = leveller.level(record(ranges, 0.3, step), 5)
    found = leveller.mount.apply(scan.hits())
    assert (np.diff(scan.bearings) > 0.0).all()
    order = np.argsort(expected[:, 0] + 10.0 * expected[:, 1])
    again = np.argsort(found[:, 0] + 10.0 * found[:, 1])
    np.testing.assert_allclose(found[again], expected[order], atol=1e-4)


@pytest.mark.parametrize("step_deg", [0.25, 0.5, 1.0, 360.0 / 1024.0])
def test_the_same_beams_make_the_same_scan_however_they_are_written(step_deg: float) -> None:
    """From either end and upside down: to the bit."""
    ranges = np.random.default_rng(0).uniform(0.5, 7.0, 301)
    step, low = (float(np.float32(math.radians(each))) for each in (step_deg, -115.0))
    high, hanging = float(np.float32(low + 300 * step)), ScanLeveller(np.diag([1.0, -1, -1, 1]))
    first = levelled(record(ranges, low, step))
    for other in (
        levelled(record(ranges[::-1], high, -step)),
        hanging.level(record(ranges[::-1], -high, step), 5),
        hanging.level(record(ranges, -low, -step), 5),
    ):
        np.testing.assert_array_equal(other.bearings, first.bearings)
        np.testing.assert_array_equal(other.ranges, first.ranges)


def test_readings_that_differ_by_a_micrometre_are_the_same() -> None:
    ranges = np.round(np.random.default_rng(0).uniform(0.5, 7.0, 50), 3)
    near = ranges + np.random.default_rng(1).uniform(-1e-6, 1e-6, 50)
    assert levelled(record(near)).ranges.tolist() == np.float32(ranges).tolist()


def test_codes_of_no_return_and_of_invalid_readings() -> None:
    scan = levelled(record([0.0, 0.05, -1.0, 1.0, 7.99, 8.0, 9.5, math.inf, math.nan, -math.inf]))
    inf, nan = math.inf, math.nan
    expected = [inf, nan, nan, 1.0, 7.99, inf, inf, inf, nan, nan]
    np.testing.assert_allclose(scan.ranges, expected, rtol=1e-6)
    limitless = levelled(record([1.0, 500.0], range_max=0.0))
    assert limitless.ranges.tolist() == [1.0, 500.0]
    assert limitless.range_max == math.inf


@pytest.mark.parametrize("beams", [720, 721, 361, 541, 701])
def test_a_full_circle_counts_each_direction_once(beams: int) -> None:
    scan = levelled(record(np.ones(beams), -math.pi, math.radians(0.5)))
    assert scan.full_circle is (beams >= 720)
    assert len(scan.bearings) == len(scan.ranges) == min(beams, 720)


def test_beam_times_follow_the_beams() -> None:
    for step, times in ((0.1, [0.0, 0.01, 0.02]), (-0.1, [0.02, 0.01, 0.0])):
        scan = levelled(record([1.0, 2.0, 3.0], step=step, time_increment=0.01))
        assert scan.beam_times_s is not None
        np.testing.assert_allclose(scan.beam_times_s, times)
        assert scan.ranges.tolist() == sorted([1.0, 2.0, 3.0], reverse=step < 0)


def test_a_missing_increment_is_found_from_the_angles_and_one_beam_takes_no_time() -> None:
    scan = levelled(record([1.0, 1.0, 1.0], -1.0, 0.0, angle_max=1.0))
    np.testing.assert_allclose(scan.bearings, [-1.0, 0.0, 1.0])
    single = levelled(record([1.5], 0.3, 0.0, time_increment=0.5))
    assert single.bearings.tolist() == pytest.approx([0.3], abs=1e-6)
    assert single.beam_times_s is None


@pytest.mark.parametrize(
    "bad",
    [
        record([]),
        record([1.0, 1.0], math.nan),
        record([1.0, 1.0], 0.0, 0.0),
        record([1.0, 1.0], 0.0, math.nan, angle_max=math.inf),
        record([1.0, 1.0], 0.0, 100.0),
        record([1.0, 1.0], 1e308),
        record([1.0, 1.0], 0.0, -6.3),
    ],
)
def test_scans_without_beams_or_angles_are_refused(bad: ScanRecord) -> None:
    with pytest.raises(BadMessageError):
        levelled(bad)


@pytest.mark.parametrize("step", [0.0, 6.2, -100.0])
def test_one_beam_is_no_circle_whatever_its_increment(step: float) -> None:
    found = levelled(record([2.0], 0.5, step))
    assert not found.full_circle
    assert found.bearings.tolist() == pytest.approx([0.5], abs=1e-6)


def brute_force(clouds: list[FloatArray], beams: int, band: FloatArray, reach: float) -> FloatArray:
    """Nearest return of the last cloud per bearing, point by point; NaN where none had a point."""
    ranges = np.full(beams, np.nan)
    for cloud in clouds:
        ranges[~np.isnan(ranges)] = np.inf
        for x, y, z in cloud:
            cell, metres = int((math.atan2(y, x) / (2 * math.pi) + 0.5) * beams), math.hypot(x, y)
            inside = band[0] <= z <= band[1] and metres <= reach
            ranges[cell] = np.fmin(ranges[cell], metres if inside else np.inf)
    return ranges


def flattener(floor_m: float | None, **options: object) -> CloudFlattener:
    return CloudFlattener(np.eye(4), floor_m, configured(LogConfig, "logs", options))


@pytest.mark.parametrize(("view", "full"), [(2 * math.pi, True), (math.pi, False)])
def test_a_cloud_is_flattened_to_the_nearest_return_in_the_band(view: float, full: bool) -> None:
    """A bearing is empty where the lidar looks or looked before; at others the scan ends."""
    rng = np.random.default_rng(3)
    angles, metres, heights = rng.uniform((0.0, 0.5, 0.0), (view, 7.0, 3.0), (4000, 3)).T
    cloud = np.column_stack([metres * np.cos(angles), metres * np.sin(angles), heights])
    clouds, band = [cloud, cloud[:50]], {"band_min_m": 0.5, "band_max_m": 1.0}
    one = flattener(0.25, cloud_beams=90, cloud_range_max_m=6.0, **band)
    for number, given_cloud in enumerate(clouds):
        scan = one.flatten(np.vstack([given_cloud, [[0.05, 0.0, 1.0]]]), 9)  # and of the lidar
        expected = brute_force(clouds[: number + 1], 90, np.array([0.75, 1.25]), 6.0)
        np.testing.assert_allclose(scan.ranges, expected[~np.isnan(expected)])
        assert scan.full_circle is full
        assert (scan.stamp_ns, scan.range_max) == (9, 6.0)
        nearest = np.abs(scan.hits()[:, None] - given_cloud[None, :, :2]).max(axis=2).min(axis=1)
        assert nearest.max() < 6.0 * math.radians(2.0), "hits lie at returns, but for the bearing"


@pytest.mark.parametrize("first", [0, 1, 2, 3, 10])
def test_a_first_cloud_with_hardly_a_return_says_nothing_of_the_beams(first: int) -> None:
    flat = CloudFlattener(np.eye(4), None, LogConfig(), planar=True)
    angles = np.linspace(-2.0, 2.0, 400)
    cloud = np.column_stack([3.0 * np.cos(angles), 3.0 * np.sin(angles), np.zeros(400)])
    start = cloud[: 2 * first : 2] if first % 2 == 0 else cloud[:: 399 // max(1, first - 1)][:first]
    assert np.isfinite(flat.flatten(start, 1).ranges).sum() == first
    assert np.isfinite(flat.flatten(cloud, 2).ranges).sum() == 400
    assert len(flat.flatten(cloud[:first], 3).ranges) > 400, "settled once"


@pytest.mark.parametrize("beams", [45, 140, 360, 682, 1400])
def test_clouds_of_a_planar_laser_keep_its_beams_though_many_meet_nothing(beams: int) -> None:
    """The first cloud of a recorded one had a third of its returns: it was read at two degrees."""
    rng = np.random.default_rng(beams)
    bearings = np.linspace(-2.1, 2.1, beams)
    ranges = 2.0 + 0.1 * np.arange(beams) % 3.0
    flat = CloudFlattener(np.eye(4), None, LogConfig(), planar=True)
    for _ in range(3):
        first = rng.integers(0, beams // 2)
        back = np.arange(first, first + beams // 3)
        away = ranges[back, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])[back]
        scan = flat.flatten(np.column_stack([away, np.full(len(back), 0.2)]), 9)
        seen = np.isfinite(scan.ranges)
        assert seen.sum() == len(back)
        np.testing.assert_allclose(scan.ranges[seen], ranges[back])
        np.testing.assert_allclose(scan.bearings[seen], bearings[back], atol=math.radians(0.5))


@pytest.mark.parametrize(
    ("settings_", "floor"),
    [
        ({}, -1.0),
        ({"floor_radius_m": 30.0}, -3.0),
        ({"floor_radius_m": 3.0}, -0.5),
        ({"floor_percentile": 75.0}, -0.5),
    ],
)
def test_the_settings_say_where_a_floor_of_unknown_height_is_sought(
    settings_: dict[str, float], floor: float
) -> None:
    angles = np.linspace(0, 6, 100)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.ones(100)])
    cloud = np.vstack([ring * scale for scale in ((2, 2, -0.5), (6, 6, -1.0), (20, 20, -3.0))])
    mast = np.array([[1.0, 1.0, floor + 1.0]])
    band = {"band_min_m": 0.99, "band_max_m": 1.01}
    one = flattener(None, cloud_beams=16, **band, **settings_)
    one.flatten(cloud[:29] + 0.7, 0)  # a first cloud that shows too little to tell
    scan = one.flatten(np.vstack([cloud, mast]), 1)
    assert scan.hits() == pytest.approx(np.array([[1.0, 1.0]]), abs=0.3)


Tour = list[tuple[Sweep, Pose2]]
REACH_M, CODE_M, CLAIMED_M = 2.5, 2.8, 30.0


def room(number: int, noise: np.random.Generator) -> np.ndarray:
    """Readings (60,) from one of the places along a wall, none of them alike."""
    distances = (1.0 + 0.2 * number) / np.sin(np.linspace(0.3, 2.8, 60))
    return distances + noise.normal(0.0, 0.01, 60)


def cleared(scans: Sequence[np.ndarray]) -> list[int]:
    """How many readings of each scan become no return."""
    ceiling = Ceiling()
    counts = []
    for ranges in scans:
        ceiling.clear(ranges)
        counts.append(int(np.isinf(ranges).sum()))
    return counts


def test_the_longest_distance_of_all_read_from_four_places_is_no_return() -> None:
    noise = np.random.default_rng(0)
    scans = [np.minimum(room(number, noise), 2.0) for number in range(6)]
    alike = [int((ranges == 2.0).sum()) for ranges in scans]
    assert min(alike) >= 3
    assert cleared(scans) == [0, 0, 0, *alike[3:]]


def test_walls_that_share_their_longest_distance_by_chance_stay() -> None:
    """Nor does a robot that stands before one learn anything of it."""
    noise = np.random.default_rng(1)
    assert not any(cleared([np.round(room(number % 7, noise), 2) for number in range(200)]))
    assert not any(cleared([np.minimum(room(0, noise), 2.0) for _ in range(50)]))


def has_code(sweep: Sweep) -> bool:
    """Whether a scan has returns from where the laser does not reach."""
    ranges = sweep.planar.ranges
    return bool((np.isfinite(ranges) & (ranges > REACH_M)).any())


def write(path: Path, tour: Tour, scans: list[np.ndarray], range_max: float) -> None:
    """A log of other readings from the places of a tour."""
    with LogWriter(path) as log:
        for (sweep, _), ranges in zip(tour, scans, strict=True):
            first, second = map(float, sweep.planar.bearings[:2])
            step = second - first
            log.scan("/scan", "laser", sweep.stamp_ns, first, step, ranges, range_max=range_max)


def test_no_scan_has_a_return_there_and_the_distance_is_told(flat_tour: Tour, path: Path) -> None:
    """The flat seen by a laser of 2.5 m that says 2.8 m for no return and claims 30 m."""
    seen = [sweep.planar.ranges for sweep, _ in flat_tour[:300]]
    coded = [np.where(ranges < REACH_M, ranges, CODE_M) for ranges in seen]
    write(path, flat_tour[:300], coded, CLAIMED_M)
    sweeps, stream = sweeps_of(path)
    assert not any(has_code(sweep) for sweep in sweeps)
    assert any("readings of exactly 2.8 m" in warning for warning in stream.warnings)
    with open_log(path) as log:
        assert any("2.8 m" in warning for warning in summarize(log).warnings)
    shown = [has_code(sweep) for sweep in sweeps_of(path, look_scans=3)[0]]
    assert any(shown[:3])
    assert not any(shown[len(shown) // 2 :]), "it is found after the first look too"


POST = slice(13, 19)  # beams that see a post of the robot
POST_M = 0.4


def scans(tour: Tour, seed: int, *, post: bool = True) -> list[np.ndarray]:
    """The readings of a tour, with the post before some beams."""
    noise = np.random.default_rng(seed)
    found = []
    for sweep, _ in tour:
        ranges = sweep.planar.ranges.copy()
        if post:
            ranges[POST] = POST_M + noise.normal(0.0, 0.01, POST.stop - POST.start)
        found.append(ranges)
    return found


def marked(given: list[np.ndarray]) -> np.ndarray:
    """(n, B) which readings are taken for the robot."""
    body = OwnBody()
    marks = []
    for ranges in given:
        before = np.isnan(ranges)
        body.clear(ranges)
        marks.append(np.isnan(ranges) & ~before)
    return np.array(marks)


def test_a_post_that_goes_along_is_left_out_once_the_robot_has_moved(flat_tour: Tour) -> None:
    marks = marked(scans(flat_tour, 0))
    late = marks[len(marks) // 2 :]
    assert late[:, POST].all()
    assert not np.delete(late, np.arange(POST.start - 1, POST.stop + 1), axis=1).any()
    assert not marks[0].any()
    assert not marked(scans(flat_tour, 1, post=False)).any(), "walls are not"


def test_nothing_is_learned_of_walls_near_a_robot_that_stands(flat_tour: Tour) -> None:
    noise = np.random.default_rng(2)
    first = np.minimum(flat_tour[0][0].planar.ranges, 3.0)
    first[POST] = POST_M
    assert not marked([first + noise.normal(0.0, 0.01, len(first)) for _ in range(200)]).any()


def test_lost_returns_and_beams_at_its_edge_that_flicker_change_nothing(flat_tour: Tour) -> None:
    noise = np.random.default_rng(3)
    given = scans(flat_tour, 3)
    edge = POST.stop
    for ranges in given:
        ranges[noise.random(len(ranges)) < 0.1] = np.inf
        if noise.random() < 0.5:
            ranges[edge] = POST_M
    expected = np.array(given)[:, POST] < 1.0
    flickers = np.array(given)[:, edge] == POST_M
    marks = marked(given)
    half = len(marks) // 2
    assert np.array_equal(marks[half:, POST], expected[half:])
    assert np.array_equal(marks[half:, edge], flickers[half:])


def test_a_beam_that_reads_farther_once_has_seen_a_wall(flat_tour: Tour) -> None:
    given = scans(flat_tour, 4)
    half = len(given) // 2
    for ranges in given[half:]:
        ranges[POST] = 1.5
    given += scans(flat_tour[:20], 5)
    marks = marked(given)
    assert marks[half - 1, POST].all()
    assert not marks[-20:].any()


def test_the_scans_of_a_log_are_without_it_and_a_warning_tells(flat_tour: Tour, path: Path) -> None:
    write(path, flat_tour, scans(flat_tour, 6), range_max=12.0)
    sweeps, stream = sweeps_of(path)
    (told,) = [warning for warning in stream.warnings if "the robot itself: 6" in warning]
    assert np.isnan(sweeps[-1].planar.ranges[POST]).all()
    assert float(told.split()[5]) == pytest.approx(POST_M, abs=0.05)
    flat = CloudFlattener(np.eye(4), None, LogConfig(), planar=True)
    for (sweep, _), ranges in zip(flat_tour, scans(flat_tour, 6), strict=True):
        b, r = sweep.planar.bearings, np.where(np.isfinite(ranges), ranges, 0.0)
        flat.flatten(np.column_stack([r * np.cos(b), r * np.sin(b), 0.0 * r]), 0)
    assert flat.own_body.notes


SEEN = np.array([1.0, np.nan, 2.0, np.inf, 3.0])


def sweep(ranges: np.ndarray, pose: Pose2 | None) -> Sweep:
    planar = PlanarScan(0, np.linspace(-1.0, 1.0, len(ranges)), ranges, 8.0, False)
    return Sweep(index=0, stamp_ns=0, planar=planar, base_from_laser=IDENTITY, odom_from_base=pose)


AT, BLANK = IDENTITY, np.full(5, np.inf)
STEPS = [Pose2(0.008 * number, 0.0, 0.0) for number in range(5)]


@pytest.mark.parametrize(
    ("scans", "poses", "stale"),
    [
        ([SEEN, SEEN], [AT, Pose2(0.1, 0.0, 0.0)], [False, True]),
        ([SEEN, SEEN], [AT, Pose2(0.0, 0.0, 0.1)], [False, True]),
        ([SEEN, SEEN], [AT, Pose2(0.005, 0.0, 0.001)], [False, False]),  # it stands still
        ([SEEN, SEEN], [AT, None], [False, False]),
        ([SEEN, SEEN + 0.001], [AT, Pose2(0.1, 0.0, 0.0)], [False, False]),
        ([SEEN, SEEN[:-1]], [AT, Pose2(0.1, 0.0, 0.0)], [False, False]),
        ([BLANK, BLANK], [AT, Pose2(1.0, 0.0, 0.0)], [False, False]),
        ([SEEN] * 5, STEPS, [False] * 3 + [True] * 2),  # motion counts from the first of them
    ],
)
def test_only_a_scan_that_repeats_another_while_the_robot_moves_is_stale(
    scans: list[np.ndarray], poses: list[Pose2 | None], stale: list[bool]
) -> None:
    repeats = Repeats()
    found = [repeats.stale(sweep(each.copy(), at)) for each, at in zip(scans, poses, strict=True)]
    assert found == stale

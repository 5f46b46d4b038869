"""The stream of sweeps: odometry, frames, stamps, counts, and memory."""

import math
import tracemalloc
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.opening import Log, open_log
from specmap_cli.logs.readers.encoding import LASER_SCAN, ODOMETRY, odometry_cdr, scan_cdr
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import SECOND, START, Told, sweeps_of
from tests.turning import configured


def scan(stamp: int, beams: int = 10, time: int | None = None, topic: str = "/scan") -> Message:
    data = scan_cdr("laser", stamp, -1.0, 2.0 / beams, np.full(beams, 2.0), range_max=8.0)
    return Message(topic, LASER_SCAN, stamp if time is None else time, data)


def odometry(stamp: int, x: float, time: int | None = None) -> Message:
    data = odometry_cdr("odom", "base", stamp, Pose2(x, 0.0, 0.0))
    return Message("/odom", ODOMETRY, stamp if time is None else time, data)


def stream_of(messages: list[Message], **options: object) -> SweepStream:
    log = Log([Told("spy", lambda: messages)], [Path("spy")])
    return SweepStream(log, configured(LogConfig, "logs", options))


def test_scans_of_99_999_beams_cost_what_those_of_a_dense_laser_do() -> None:
    """A log of 24 kB with 61 of them took 3.7 GB: all beams of all scans went on to the map."""
    count = 61
    messages = [scan(START + each * SECOND // 10, beams=99_999) for each in range(count)]
    kept = [sweep.planar for sweep in list(stream_of(messages))]
    assert len(kept) == count
    assert max(len(planar.ranges) for planar in kept) <= 3600
    own = sum(planar.ranges.nbytes for planar in kept)
    shared = {id(planar.bearings): planar.bearings.nbytes for planar in kept}
    assert own + sum(shared.values()) <= (count + 1) * 3600 * 8  # the bearings are there once


def test_odometry_is_interpolated_to_the_stamps_of_the_scans_or_left_out(drive: Path) -> None:
    sweeps, stream = sweeps_of(drive)
    assert [s.index for s in sweeps] == list(range(30))
    for sweep in sweeps[:-1]:
        assert sweep.odom_from_base is not None
        assert sweep.odom_from_base.x == pytest.approx((sweep.stamp_ns - START) / SECOND)
        assert sweep.base_from_laser == (0.2, 0.0, 0.0)
    assert stream.counts["scans"] == 30
    assert stream.counts["odometry"] == 60
    assert stream.warnings == []
    sweeps, stream = sweeps_of(drive, use_odometry=False)
    assert all(s.odom_from_base is None for s in sweeps)
    assert stream.selection.odometry is None
    assert stream.counts["without_odometry"] == 0


def test_waiting_ends_when_log_time_goes_on() -> None:
    late = [scan(START + SECOND // 100), scan(START + SECOND + SECOND // 100)]
    stream = stream_of([odometry(START, 0.0), *late])
    iterator = iter(stream)
    assert next(iterator).odom_from_base == (0.0, 0.0, 0.0), "held for a moment"
    assert next(iterator).odom_from_base is None
    assert stream.counts["without_odometry"] == 1
    assert stream.warnings[-1] == (
        "scans without odometry near their stamp: 1; scan matching alone places them: is the "
        "odometry of the same clock, and of the whole drive?"
    )


@pytest.mark.parametrize(("every", "late_s", "said"), [(10, 0.0, 0), (1, 0.7, 1), (1, 0.3, 0)])
def test_slow_and_late_odometry_measures_every_scan(every: int, late_s: float, said: int) -> None:
    """Scans waited for half a second: odometry at 1 Hz, or over a radio, was not used."""
    step = SECOND // 10
    messages = [scan(START + number * step) for number in range(101)]
    for number in range(0, 101, every):
        stamp = START + number * step
        messages.append(odometry(stamp, 0.1 * number, stamp + round(late_s * SECOND)))
    stream = stream_of(sorted(messages, key=lambda message: message.time_ns))
    for number, sweep in enumerate(stream):
        assert sweep.odom_from_base is not None
        assert sweep.odom_from_base.x == pytest.approx(0.1 * number)
    told = [line for line in stream.warnings if "its clock is wrong" in line]
    assert len(told) == said
    assert all(line.startswith("the stamps of the odometry are 0.7") for line in told)


@pytest.mark.parametrize(
    ("late_s", "every", "with_odometry", "sorted_"),
    [
        (0.3, 3, True, True),
        (0.3, 3, False, True),
        (1.9, 3, True, True),
        (2.1, 3, True, False),
        (0.3, 40, True, False),
    ],
)
def test_scans_recorded_out_of_order_are_sorted_by_their_stamps(
    late_s: float, every: int, with_odometry: bool, sorted_: bool
) -> None:
    """Each third one is late; by two seconds or more, or once or twice, the clock was set back."""
    messages = []
    for number in range(60):
        stamp = START + number * SECOND // 10
        messages.append(scan(stamp, time=stamp + (number % every == 0) * round(late_s * SECOND)))
        messages += [odometry(stamp, 0.1 * number)] * with_odometry
    stream = stream_of(sorted(messages, key=lambda message: message.time_ns))
    sweeps = list(stream)
    stamps = [sweep.stamp_ns for sweep in sweeps]
    assert len(stamps) == len(set(stamps)) == 60
    assert (stamps == sorted(stamps)) is sorted_
    assert (stream.counts["backward_stamps"] == 0) is sorted_
    for sweep in sweeps if with_odometry else []:
        assert sweep.odom_from_base is not None
        assert sweep.odom_from_base.x == pytest.approx((sweep.stamp_ns - START) / SECOND)


def test_scans_that_come_out_of_order_after_minutes_are_sorted_from_the_third_on() -> None:
    stamps = [START + number * SECOND // 10 for number in range(400)]
    times = [stamp + (k > 200 and k % 9 == 0) * SECOND // 2 for k, stamp in enumerate(stamps)]
    messages = [scan(stamp, time=time) for stamp, time in zip(stamps, times, strict=True)]
    stream = stream_of(sorted(messages, key=lambda message: message.time_ns))
    found = [sweep.stamp_ns for sweep in stream]
    assert sorted(found) == stamps
    assert stream.counts["backward_stamps"] == 3
    assert found[240:] == stamps[240:]


@pytest.mark.parametrize("range_max", [12_000.0, 12.0])
@pytest.mark.parametrize(("ranges_m", "told"), [(2.0, False), (90.0, False), (3400.0, True)])
def test_ranges_in_millimetres_are_told_of(ranges_m: float, range_max: float, told: bool) -> None:
    ranges = np.array([np.inf, np.nan, 0.0, *[ranges_m] * 9])
    data = scan_cdr("laser", START, -1.0, 0.2, ranges, range_max=range_max)
    warnings = stream_of([Message("/scan", LASER_SCAN, START, data)]).warnings
    assert [line for line in warnings if "millimetres" in line] == [
        "half of the returns of the first scan on /scan are farther than 3,400 m: are they in "
        "millimetres or centimetres? They must be in metres"
    ] * told


@pytest.mark.parametrize(("step", "told"), [(0.5, False), (-2.0, False), (-2.6, True), (6.0, True)])
def test_angles_in_degrees_are_told_of(step: float, told: bool) -> None:
    """Beams that go round twice, as of a driver that puts two turns together, are none."""
    data = scan_cdr("laser", START, -3.0, step, np.full(6, 2.0), range_max=10.0)
    warnings = stream_of([Message("/scan", LASER_SCAN, START, data)]).warnings
    assert [line for line in warnings if "degrees" in line] == [
        f"the angles of the first scan on /scan span {abs(5 * step):.0f} radians, more than a "
        "turn: are they in degrees? They must be in radians"
    ] * told


def test_a_scan_outside_the_odometry_is_counted_and_no_warning() -> None:
    """A drive begins and ends with one: one of two hundred is worth no word."""
    messages = [scan(START - SECOND)]
    for number in range(200):
        stamp = START + number * SECOND // 10
        messages += [odometry(stamp, 0.0), scan(stamp)]
    stream = stream_of(messages)
    assert sum(sweep.odom_from_base is None for sweep in stream) == 1
    assert stream.counts["without_odometry"] == 1
    assert not any("without odometry" in warning for warning in stream.warnings)


def peak(log: Log, scans: int) -> int:
    """The most memory that is taken while all scans of a log are read."""
    stream = SweepStream(log, LogConfig())
    tracemalloc.start()
    assert sum(1 for _ in stream) == scans
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return used


def test_memory_does_not_grow_with_the_log() -> None:
    def make(scans: int) -> Iterator[Message]:
        for number in range(scans):
            stamp = START + number * SECOND // 10
            yield odometry(stamp, 0.1 * number)
            yield scan(stamp + 1, beams=40_000)

    _, short, long = (
        peak(Log([Told("spy", partial(make, scans))], [Path("spy")]), scans)
        for scans in (3, 10, 100)
    )
    assert long < 1.1 * short


def test_files_are_read_with_one_chunk_in_memory(path: Path) -> None:
    rng = np.random.default_rng(1)
    with LogWriter(path) as log:
        for number in range(400):
            ranges = rng.uniform(1.0, 5.0, 20_000)
            stamp = START + number * SECOND // 10
            log.scan("/scan", "laser", stamp, -1.0, 1e-4, ranges, range_max=8.0)
    sweeps_of(path)
    with open_log(path) as whole:
        assert peak(whole, 400) < 0.3 * 400 * 20_000 * 4


def test_odometry_comes_from_transforms_too(path: Path) -> None:
    with LogWriter(path) as log:
        for i in range(20):
            stamp = START + i * SECOND // 10
            log.transform("map", "odom", stamp, Pose2(5.0, 5.0, 1.0))
            log.transform("odom", "base_footprint", stamp, Pose2(0.1 * i, 0.0, 0.0))
            log.transform("arm", "hand", stamp, Pose2(9.0, 9.0, 9.0))
            ranges = np.full(10, 2.0)
            log.scan("/scan", "laser", stamp + 50_000_000, -1.0, 0.2, ranges, range_max=8.0)
        late = START + 2 * SECOND
        log.static_transform("base_footprint", "base_link", (0.0, 0.5, 0.1), stamp_ns=late)
        log.static_transform("base_link", "laser", (0.2, 0.0, 0.3), stamp_ns=late)
    sweeps, stream = sweeps_of(path)
    assert stream.selection.note == (
        "scans from /scan (LaserScan, 20), odometry from transforms odom -> base_link, "
        "base frame base_link"
    )
    assert sweeps[3].odom_from_base == pytest.approx((0.35, 0.5, 0.0))
    assert sweeps[3].base_from_laser == (0.2, 0.0, 0.0)
    footprint, _ = sweeps_of(path, base_frame="base_footprint")
    assert footprint[3].odom_from_base == pytest.approx((0.35, 0.0, 0.0))
    assert footprint[3].base_from_laser == (0.2, 0.5, 0.0)


def test_odometry_of_another_frame_is_carried_to_the_base(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "wheel", (0.5, 0.0, 0.0), stamp_ns=START)
        log.static_transform("base_link", "laser", (0.2, 0.0, 0.0), stamp_ns=START)
        log.odometry("/odom", "odom", "wheel", START, Pose2(0.0, 0.0, math.pi / 2))
        log.scan("/scan", "laser", START, -1.0, 0.2, np.full(10, 2.0), range_max=8.0)
    (sweep,), _ = sweeps_of(path, base_frame="base_link")
    assert sweep.odom_from_base == pytest.approx((0.0, -0.5, math.pi / 2))


@pytest.mark.parametrize(
    ("later", "told"),
    [
        (("odom", "wheel"), None),  # which a transform joins: it is carried over
        (("odom", "base_2"), "'odom' -> 'base_2'"),
        (("odom_2", "base_link"), "'odom_2' -> 'base_link'"),
    ],
)
def test_odometry_that_changes_its_frames_in_the_middle_is_told(
    path: Path, later: tuple[str, str], told: str | None
) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "wheel", (0.0, 0.0, 0.0), stamp_ns=START)
        log.static_transform("base_link", "laser", (0.2, 0.0, 0.0), stamp_ns=START)
        for number in range(6):
            frames = ("odom", "base_link") if number < 4 else later
            log.odometry("/odom", *frames, START + number, Pose2(0.0, 0.0, 0.0))
            log.scan("/scan", "laser", START + number, -1.0, 0.2, np.full(10, 2.0), range_max=8.0)
    sweeps, stream = sweeps_of(path)
    assert len(sweeps) == 6
    assert [line for line in stream.warnings if "other frames" in line] == (
        [
            "the odometry moves 'odom' -> 'base_link', but in 2 later messages other frames, "
            f"such as {told}: they are taken to be the same"
        ]
        if told
        else []
    )


def test_strange_stamps_and_scans_are_survived_and_counted() -> None:
    """Of a topic that changed its type, as when a driver was exchanged, as well."""
    stamps = [1, 2, 2, 5, 4, 6]
    blank = scan_cdr("laser", START + 7 * SECOND, -1.0, 0.2, np.full(10, np.nan), range_max=8.0)
    empty = scan_cdr("laser", START + 8 * SECOND, -1.0, 0.2, [], range_max=8.0)
    one = np.float64(1.0).tobytes()  # of a quaternion that turns nothing
    stream = stream_of(
        [
            *(scan(START + s * SECOND, time=START + i) for i, s in enumerate(stamps)),
            Message("/scan", LASER_SCAN, START + 8, blank),
            Message("/scan", LASER_SCAN, START + 9, b"\x00\x01\x00\x00rubbish"),
            Message("/odom", ODOMETRY, START + 10, b"rubbish"),
            Message("/scan", LASER_SCAN, START + 11, empty),
            Message("/scan", "geometry_msgs/msg/Twist", START + 12, bytes(100)),
            Message("/odom", "geometry_msgs/msg/Twist", START + 13, bytes(100)),
            Message("/odom", ODOMETRY, START + 14, odometry(0, 0.0).data.replace(one, bytes(8))),
        ]
    )
    assert len(list(stream)) == 7
    counts = {"scans": 7, "unusable_scans": 3, "unusable_odometry": 3, "blank_scans": 1}
    counts |= {"backward_stamps": 1, "repeated_stamps": 1, "without_odometry": 7}
    assert {k: n for k, n in stream.counts.items() if n} == counts
    assert len(stream.warnings) == 6
    assert "scans that could not be read and were left out: 3" in stream.warnings


def test_a_cloud_becomes_points_in_the_base_frame_and_a_planar_scan(path: Path) -> None:
    rng = np.random.default_rng(8)
    points = rng.uniform((-4, -4, -0.5), (4, 4, 2.0), (3000, 3)).astype(np.float32)
    points[:5] = np.nan
    half = math.sqrt(0.5)
    with LogWriter(path) as log:
        log.static_transform("base_footprint", "base_link", (0.0, 0.0, 0.1), stamp_ns=START)
        yaw = (0.0, 0.0, half, half)
        log.static_transform("base_link", "lidar", (0.3, 0.0, 0.5), yaw, START)
        for i, seen in enumerate((points, np.full_like(points, np.nan), points)):
            times = np.linspace(0.0, 0.1, 3000)
            log.cloud("/points", "lidar", START + i * SECOND // 10, seen, times)
    sweeps, stream = sweeps_of(path, cloud_beams=180)
    assert "height band 0.15 to 1.5 m above the floor" in stream.selection.note
    assert [sweep.index for sweep in sweeps] == [0, 1], "none of the cloud without a usable point"
    sweep = sweeps[1]
    assert sweep.cloud is not None
    assert sweep.cloud_times_s is not None
    assert len(sweep.cloud) == len(sweep.cloud_times_s) == 2995
    good = points[5:]
    expected = np.column_stack([-good[:, 1] + 0.3, good[:, 0], good[:, 2] + 0.5])
    np.testing.assert_allclose(sweep.cloud, expected, atol=1e-6)
    assert sweep.base_from_laser == (0.3, 0.0, 0.0)
    band = expected[(expected[:, 2] >= 0.05) & (expected[:, 2] <= 1.4)]
    nearest = np.hypot(band[:, 0] - 0.3, band[:, 1]).min()
    assert np.nanmin(sweep.planar.ranges) == pytest.approx(nearest)
    assert stream.warnings == ["scans that could not be read and were left out: 1"]


@pytest.mark.parametrize(("longest_s", "counted"), [(10.0, 0), (0.05, 2)])
def test_times_too_far_are_counted_and_said(path: Path, longest_s: float, counted: int) -> None:
    with LogWriter(path) as log:
        for stamp in (START, START + SECOND):
            far = {"range_max": 8.0, "time_increment": 0.15}
            log.scan("/scan", "lidar", stamp, -1.0, 0.2, np.full(11, 2.0), **far)
            log.cloud("/points", "lidar", stamp, np.eye(3), times_s=[0.0, 0.05, 0.1])
    limits = {"scan_time_max_s": longest_s, "cloud_time_max_s": longest_s}
    for topic in ("/scan", "/points"):
        sweeps, stream = sweeps_of(path, scan_topic=topic, **limits)
        times = [s.planar.beam_times_s if topic == "/scan" else s.cloud_times_s for s in sweeps]
        assert [each is None for each in times] == [counted > 0] * 2
        assert stream.counts["far_times"] == counted
        said = "scans whose point times reach farther than a sweep lasts and were not used: 2"
        assert (said in stream.warnings) is (counted > 0)


def test_a_stream_can_be_read_again_and_counts_are_of_the_iteration_so_far(drive: Path) -> None:
    with open_log(drive) as log:
        stream = SweepStream(log, LogConfig())
        assert set(stream.counts.values()) == {0}
        iterator = iter(stream)
        for _ in range(3):
            next(iterator)
        assert stream.counts["scans"] == 3
        assert stream.counts["odometry"] >= 3
        first, second = ([s.odom_from_base for s in stream] for _ in range(2))
        assert first == second
        assert len(first) == stream.counts["scans"] == 30


def test_an_unstamped_odometry_message_is_taken_when_it_was_recorded() -> None:
    messages = [scan(START), odometry(0, 1.0, START), odometry(0, 3.0, START + SECOND)]
    first, second = stream_of([*messages, scan(START + SECOND // 2, time=START + SECOND)])
    assert first.odom_from_base == (1.0, 0.0, 0.0)
    assert second.odom_from_base == pytest.approx((2.0, 0.0, 0.0))


def test_transforms_of_other_frames_and_rubbish_are_no_odometry(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.2, 0.0, 0.3), stamp_ns=START)
        for i in range(5):
            stamp = START + i * SECOND // 10
            log.transform("odom", "base_link", stamp, Pose2(float(i), 0.0, 0.0))
            log.transform("odom", "other_robot", stamp, Pose2(9.0, 9.0, 9.0))
            log.transform("odom", "base_link", stamp, Pose2(math.nan, 0.0, 0.0))
            log.scan("/scan", "laser", stamp, -1.0, 0.2, np.full(10, 2.0), range_max=8.0)
        log.raw("/tf", "tf2_msgs/msg/TFMessage", b"rubbish", START + SECOND)
    sweeps, stream = sweeps_of(path)
    assert [s.odom_from_base and s.odom_from_base.x for s in sweeps] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert (stream.counts["odometry"], stream.counts["unusable_odometry"]) == (5, 6)
    assert stream.warnings[:2] == [
        "the transform 'odom' -> 'base_link' is not finite or absurd, and was left out",
        "messages of transforms that could not be read: 1",
    ]


def test_a_topic_of_transforms_may_carry_another_type(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.2, 0.0, 0.3), stamp_ns=START)
        log.odometry("/tf_static", "odom", "base_link", START, Pose2(0.0, 0.0, 0.0))
        log.scan("/scan", "laser", START, -1.0, 0.2, np.full(10, 2.0), range_max=8.0)
    (sweep,), _ = sweeps_of(path)
    assert sweep.base_from_laser == (0.2, 0.0, 0.0)

"""Stamps that say nothing, odometry by another clock, and odometry between stamps."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.logs.clocks import Clock, StampPair, choose_clock
from specmap_cli.logs.readers.encoding import LASER_SCAN, ODOMETRY, odometry_cdr, scan_cdr
from specmap_cli.logs.stream import MAX_POSES, OdometryBuffer
from specmap_cli.logs.writer import LogWriter, convert
from tests.logs.recordings import SECOND, sweeps_of
from tests.turning import turn

TODAY = 1_700_000_000 * SECOND
MS = 1_000_000


def glimpses(stamps: list[int], times: list[int]) -> list[tuple[int, int]]:
    return list(zip(stamps, times, strict=True))


def tenths(count: int, start: int = TODAY) -> list[int]:
    return [start + n * SECOND // 10 for n in range(count)]


@pytest.mark.parametrize(
    ("stamps", "times", "source"),
    [
        (tenths(9), tenths(9), "header"),
        (tenths(9, 0), tenths(9), "header"),  # a simulated clock
        ([0] * 9, tenths(9), "recorder"),
        ([0], [0], "recorder"),
        ([TODAY] * 9, tenths(9), "recorder"),
        ([TODAY] * 2, tenths(2), "header"),  # a scan that was sent twice
        ([t // SECOND * SECOND for t in tenths(30)], tenths(30), "recorder"),  # whole seconds
        ([t // (SECOND // 5) for t in tenths(30)], tenths(30), "header"),  # each sent twice
        ([0] * 9, [0] * 9, "order"),
        ([TODAY] * 9, [5] * 9, "order"),
        (tenths(9)[::-1], tenths(9), "recorder"),
    ],
)
def test_stamps_count_while_they_say_when(stamps: list[int], times: list[int], source: str) -> None:
    assert choose_clock(glimpses(stamps, times), []).source == source


@pytest.mark.parametrize("before_s", [0, 10])
def test_scans_in_a_burst_behind_one_message_say_nothing_about_its_clock(before_s: int) -> None:
    """Nor are stamps shifted that go on for seconds while the recorder hears all scans at once."""
    at_once = [TODAY + 9 * SECOND + n * MS for n in range(90)]
    scans = glimpses(tenths(90), at_once)
    before = TODAY - before_s * SECOND, at_once[0] - before_s * SECOND
    pairs = [StampPair(before, scan) for scan in scans]
    assert choose_clock(scans, pairs) == choose_clock(scans, [])


def test_a_zero_among_stamps_of_the_recorders_clock_was_never_set() -> None:
    assert choose_clock(glimpses([0, *tenths(9)[1:]], tenths(9)), []).scan_ns(0, 0, TODAY) == TODAY
    assert choose_clock(glimpses(tenths(9, 0), tenths(9)), []).scan_ns(0, 0, TODAY) == 0
    assert Clock(odometry_shift_ns=5).odometry_ns(0, TODAY) == TODAY


Stamp = Callable[[int], int]


def write(path: Path, scan_ns: Stamp, odometry_ns: Stamp, time_ns: Stamp, count: int = 20) -> None:
    """A robot that drives 1 m a scan; odometry between the scans, each at x = n + 0.5."""
    with LogWriter(path) as log:
        for n in range(count):
            data = odometry_cdr("odom", "base", odometry_ns(2 * n), Pose2(n, 0.0, 0.0))
            log.raw("/odom", ODOMETRY, data, time_ns(2 * n))
            stamp, ranges = scan_ns(2 * n + 1), np.full(9, 2.0)
            data = scan_cdr("base", stamp, -1.0, 0.25, ranges, range_max=8.0)
            log.raw("/scan", LASER_SCAN, data, time_ns(2 * n + 1))


def tick(start: int) -> Stamp:
    return lambda n: start + n * SECOND // 20


def places(sweeps: list[Sweep]) -> list[float | None]:
    return [None if s.odom_from_base is None else s.odom_from_base.x for s in sweeps]


NOW, UNSET, SAME = tick(TODAY), lambda _: 0, lambda _: TODAY
SHIFTED = (
    "the stamps of the odometry are 1700000000.000 s {} those of the scans recorded beside it: "
    "it has another clock, and is shifted to theirs"
)
RECORDERS = "/scan: header stamps {}: the recorder's times are used"
BY_ORDER = (
    "/scan: header stamps are zero, and the recorder's times do not ascend: scans are stamped "
    "by their order, 2 s apart"
)


@pytest.mark.parametrize(
    ("scan", "odometry", "time", "stamps", "said"),
    [
        (NOW, tick(0), NOW, NOW, SHIFTED.format("behind")),
        (tick(5), NOW, NOW, tick(5), SHIFTED.format("ahead of")),
        (UNSET, tick(77), NOW, NOW, RECORDERS.format("are zero")),
        (SAME, tick(77), NOW, NOW, RECORDERS.format("do not ascend")),
        (tick(77), SAME, NOW, NOW, RECORDERS.format("of the odometry are all the same")),
        (
            *(lambda n: NOW(n) if n > 3 else 0, NOW, NOW, NOW),
            "scans stamped zero, for which the recorder's times are used: 2",
        ),
        (UNSET, UNSET, UNSET, lambda n: (n - 1) * SECOND, BY_ORDER),
    ],
)
def test_scans_and_odometry_get_one_clock(
    path: Path, scan: Stamp, odometry: Stamp, time: Stamp, stamps: Stamp, said: str
) -> None:
    write(path, scan, odometry, time)
    sweeps, stream = sweeps_of(path)
    assert [s.stamp_ns for s in sweeps] == [stamps(2 * n + 1) for n in range(20)]
    beside = 0.0 if said == BY_ORDER else 0.5  # a line's own odometry, or between two
    assert places(sweeps)[:-1] == pytest.approx([n + beside for n in range(19)])
    assert stream.warnings == [said]


TO_AND_FRO = [5.0, 6.0, 5.5, 7.0, 7.0, 3.0, 60.0, 8.0]


def carmen(path: Path, stamps: list[float]) -> None:
    """A line a metre; behind each an ODOM line of other odometry whose stamp is 0."""
    with path.open("w", encoding="ascii") as file:
        for n, stamp in enumerate(stamps):
            ranges = " ".join(["2.0"] * 181)
            file.write(f"FLASER 181 {ranges} {n} 0 0 {n} 0 0 {stamp:.6f} robot {stamp:.6f}\n")
            file.write(f"ODOM {n + 100} 0 0 0 0 0 0.000000 robot 0.000000\n")


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        pytest.param([0.0] * 30, [n * 2 * SECOND for n in range(30)], id="zero"),
        pytest.param([5.0] * 30, [(5 + 2 * n) * SECOND for n in range(30)], id="constant"),
        pytest.param([float(n // 10) for n in range(31)], tenths(31, 0), id="whole"),
        pytest.param(TO_AND_FRO, [round(s * SECOND) for s in TO_AND_FRO], id="to and fro"),
    ],
)
@pytest.mark.parametrize("converted", [False, True])
def test_the_odometry_of_a_line_stays_with_it(
    tmp_path: Path, stamps: list[float], expected: list[int], converted: bool
) -> None:
    """Whatever the stamps are, also when the log was converted to MCAP, which sorts by time."""
    path = tmp_path / "robot.log"
    carmen(path, stamps)
    if converted:
        convert(path, tmp_path / "log.mcap")
        path = tmp_path / "log.mcap"
    sweeps, _ = sweeps_of(path)
    assert places(sweeps) == [float(n) for n in range(len(stamps))]
    assert [s.stamp_ns for s in sweeps] == expected


def test_memory_is_bounded() -> None:
    buffer = OdometryBuffer()
    for number in range(20_000):
        buffer.add(number * MS, Pose2(float(number), 0.0, 0.0))
    assert len(buffer) <= MAX_POSES
    assert buffer.at(19_990 * MS) == (19_990.0, 0.0, 0.0)
    assert buffer.at(0) is None


@given(
    st.lists(st.tuples(st.integers(0, 400), st.floats(-9, 9), st.floats(-1.5, 1.5)), min_size=1),
    st.integers(0, 300),
    st.integers(0, 90),
)
def test_poses_are_those_of_linear_interpolation_as_far_as_the_settings_say(
    found: list[tuple[int, float, float]], gap_ms: int, hold_ms: int
) -> None:
    """Whatever the order of arrival; the last of a repeated stamp counts. They turn across pi."""
    turn("logs", odometry_gap_s=gap_ms / 1000, odometry_hold_s=hold_ms / 1000)
    buffer = OdometryBuffer()
    known: dict[int, tuple[float, float]] = {}
    for stamp, x, theta in found:
        buffer.add(stamp * MS, Pose2(x, -x, math.pi + theta))
        known[stamp] = x, theta
    stamps = sorted(known)
    assert len(buffer) == len(stamps)
    for asked in [*range(stamps[0] - 95, stamps[-1] + 96, 19), *stamps]:
        before, after = ([s for s in stamps if (s - asked) * side >= 0] for side in (-1, 1))
        if before and after:
            reached = after[0] - before[-1] <= gap_ms
        else:
            reached = min(abs(s - asked) for s in stamps) <= hold_ms
        pose = buffer.at(asked * MS)
        assert (pose is not None) is reached
        if pose is not None:
            x, theta = (np.interp(asked, stamps, [known[s][i] for s in stamps]) for i in (0, 1))
            assert (pose.x, pose.y) == pytest.approx((x, -x), abs=1e-5)
            turned = math.remainder(pose.theta - math.pi - theta, 2 * math.pi)
            assert turned == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("reset_s", "kept"), [(5.0, 1), (6.0, 2)])
def test_the_settings_say_what_is_late_and_what_a_clock_set_back(reset_s: float, kept: int) -> None:
    turn("logs", clock_reset_s=reset_s)
    buffer = OdometryBuffer()
    buffer.add(10_000 * MS, Pose2(0.0, 0.0, 0.0))
    buffer.add(4_500 * MS, Pose2(1.0, 0.0, 0.0))
    assert len(buffer) == kept

"""CARMEN logs: laser and odometry lines, their stamps, mountings and damage."""

import math
import random
from collections import Counter
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.carmen import CarmenFile, flaser_angles, parse_line
from tests.logs.recordings import read_rest, refusal, sweeps_of

RANGES = " ".join(f"{1 + i / 100:.2f}" for i in range(178))
BASE = "1.0 2.0 0.0"  # a pose of the robot
AHEAD = "1.1 2.0 0.0"  # of its laser


def flaser(stamp: float, laser: str = BASE, base: str = BASE, name: str = "FLASER") -> str:
    return f"{name} 180 {RANGES} 81.83 80.00 {laser} {base} {stamp:.6f} nohost {stamp:.6f}\n"


def robotlaser(stamp: float) -> str:
    head = "ROBOTLASER1 4 -1.000000 2.000000 0.500000 30.000000 0.010000 0"
    tail = "0.2 0.0 0.1 0.0 0.0 0.1 0.0 0.0 0.4 0.3 1000000.0"
    return f"{head} 5 1.0 2.0 30.0 31.0 5.0 2 7 7 {tail} {stamp:.6f} nohost {stamp:.6f}\n"


@pytest.fixture
def front(tmp_path: Path) -> Path:
    path = tmp_path / "log.clf"
    path.write_text(
        "# message_name [message contents]\n"
        "PARAM robot_length 0.5 nohost 0.0\n"
        "SYNC run\n"
        "ODOM 0.9 2.0 0.5 0.1 0.0 0.0 9.950000 nohost 9.95\n"
        + flaser(10.000001, AHEAD)
        + flaser(10.2, f"2.0 2.1 {math.pi / 2}", f"2.0 2.0 {math.pi / 2}")
    )
    return path


def test_flaser_lines_become_sweeps(front: Path) -> None:
    sweeps, stream = sweeps_of(front)
    assert stream.warnings == []
    assert [s.stamp_ns for s in sweeps] == [10_000_001_000, 10_200_000_000]
    first = sweeps[0]
    np.testing.assert_allclose(first.planar.bearings, np.radians(np.arange(180) - 90.0), atol=1e-6)
    np.testing.assert_allclose(first.planar.ranges[:178], 1 + np.arange(178) / 100, rtol=1e-6)
    assert np.isposinf(first.planar.ranges[178:]).all()
    assert first.odom_from_base == (1.0, 2.0, 0.0)
    assert first.base_from_laser == pytest.approx((0.1, 0.0, 0.0))
    assert sweeps[1].odom_from_base == pytest.approx((2.0, 2.0, math.pi / 2))
    with open_log(front) as log:
        counted = Counter(m.topic for m in log.messages())
        assert {t.name: t.count for t in log.topics()} == counted
        assert counted == {"/flaser": 2, "/odom": 3, "/tf_static": 1}
        assert log.format == "CARMEN log"


@pytest.mark.parametrize(
    ("beams", "first", "step"),
    [(180, -90.0, 1.0), (181, -90.0, 1.0), (360, -90.0, 0.5), (361, -90.0, 0.5)]
    + [(541, -135.0, 0.5), (1081, -135.0, 0.25), (401, -90.0, 0.45), (1, -90.0, 180.0)]
    + [(720, -90.0, 0.25), (721, -90.0, 0.25), (682, -119.705, 239.41 / 681)],
)
def test_flaser_angles(beams: int, first: float, step: float) -> None:
    start, increment = flaser_angles(beams)
    assert math.degrees(start) == pytest.approx(first)
    assert math.degrees(increment) == pytest.approx(step)


def test_robotlaser_lines_say_their_own_angles_and_ranges(path: Path) -> None:
    path.write_text(robotlaser(3.5))
    (sweep,), _ = sweeps_of(path)
    np.testing.assert_allclose(sweep.planar.bearings, [-1.0, -0.5, 0.0, 0.5, 1.0], atol=1e-6)
    assert sweep.planar.ranges.tolist() == [1.0, 2.0, math.inf, math.inf, 5.0]
    assert sweep.planar.range_max == 30.0
    assert sweep.stamp_ns == 3_500_000_000
    mount = (0.2 * math.cos(0.1), -0.2 * math.sin(0.1), 0.0)
    assert sweep.base_from_laser == pytest.approx(mount)


def test_a_scan_of_two_lasers_that_the_other_took_by_its_mounting_is_told(path: Path) -> None:
    front, rear = (AHEAD, BASE, "FLASER"), (f"0.9 2.0 {math.pi}", BASE, "RLASER")
    order = [front, rear, front, rear, (*rear[:2], "FLASER"), front]
    path.write_text("".join(flaser(1.0 + n, *said) for n, said in enumerate(order)))
    sweeps, stream = sweeps_of(path, scan_topic="/flaser")
    assert [sweep.base_from_laser.x for sweep in sweeps] == pytest.approx([0.1] * 4)
    assert stream.log.damage == [
        f"{path}: the scan on /flaser at 5.000 s has the mounting of another laser: its keyword "
        "is damaged, and one scan of that laser is missing"
    ]
    for sweep in sweeps_of(path, scan_topic="/rlaser")[0]:
        assert sweep.base_from_laser.x == pytest.approx(-0.1)
        assert abs(sweep.base_from_laser.theta) == pytest.approx(math.pi)


def odom(stamp: str, logger: str = "7.5", pose: str = "1.0 2.0 0.5") -> str:
    return f"ODOM {pose} 0.1 0.0 0.0 {stamp} nohost {logger}\n"


@pytest.mark.parametrize(
    ("written", "stamp_ns"),
    [
        ("10.000001", 10_000_001_000),
        ("1700000000.123456789", 1_700_000_000_123_456_789),
        ("1700000000.1234567891", 1_700_000_000_123_456_789),
        ("12", 12_000_000_000),
        ("-1.5", -1_500_000_000),
        ("-0.25", -250_000_000),
        ("1.5e3", 1_500_000_000_000),
        ("0.000000", 7_500_000_000),
        ("0", 7_500_000_000),
    ],
)
def test_stamps_are_exact(written: str, stamp_ns: int) -> None:
    line = parse_line("ODOM", odom(written).encode().split())
    assert line.stamp_ns == stamp_ns
    assert line.odom_from_base == (1.0, 2.0, 0.5)
    assert line.ranges is None


@pytest.mark.parametrize(
    "line",
    [
        "ODOM 1.0 2.0",
        "ODOM 1.0 2.0 0.5 0 0 0 17.067 1.631 1.380 1.255 0 1.5 nohost 1700000003.2",
        *map(odom, ("inf", "nan", "1e400", "9e18")),
        *(odom("1.0", pose=far) for far in ("1.0 2.0 inf", "nan 2.0 0.5", "1.0 1e300 0.5")),
        "FLASER",
        "FLASER -3 1.0 2.0 0.0 1.0 2.0 0.0 1.0 nohost 1.0 9 9 9 9",
        "FLASER 0 1.0 2.0 0.0 1.0 2.0 0.0 1.0 nohost 1.0",
        "FLASER 99999999999999999999 1.0 2.0",
        "FLASER 180 1.0 oops",
        flaser(1.0)[:400],
        *(flaser(1.0).replace("1.50", wrong) for wrong in ("1.5O", "1e99")),
        flaser(1.0, "1.1 2.0 inf"),
        robotlaser(1.0).replace(" 5 ", " 50 "),
        robotlaser(1.0).replace("0.500000", "nan"),
        robotlaser(1.0).replace("-1.000000", "1e39"),
        robotlaser(1.0).replace("30.000000", "inf"),
    ],
)
def test_a_line_that_is_not_whole_costs_only_itself(path: Path, line: str) -> None:
    """Each is passed by every stage of reading: the survey, the mountings, the messages."""
    sound = flaser(0.5, AHEAD)
    path.write_text(sound + line.rstrip() + "\n" + sound)
    sweeps, stream = sweeps_of(path)
    assert len(sweeps) == 2
    keyword = line.split()[0]
    assert stream.log.damage == [
        f"{path}: line 2 (byte {len(sound)}) is damaged: one {keyword} after 0.500 s is lost"
    ]


def test_random_damage_is_survived(path: Path) -> None:
    lines = (flaser(t, AHEAD) + robotlaser(t) + odom(f"{t}.1") for t in range(1, 5))
    sound = "".join(lines).encode()
    for seed in range(40):
        rng, data = random.Random(seed), bytearray(sound)
        for _ in range(rng.randrange(1, 40)):
            data[rng.randrange(20, len(data))] = rng.choice(b"0123456789 .-e\nxF\x00\t")
        path.write_bytes(data)
        with open_log(path) as log:
            messages = list(log.messages())
            assert {m.topic for m in messages} <= {"/odom", "/flaser", "/robotlaser1", "/tf_static"}
            assert log.contents.messages == len(messages)
            assert all("\n" not in line for line in log.damage)


@pytest.mark.parametrize(("comments", "known"), [(40_000, True), (80_000, False)])
def test_data_may_come_after_many_comments(path: Path, comments: int, known: bool) -> None:
    path.write_text("# parameters of a robot, one a line, and so on\n" * 2 * comments + odom("1.0"))
    assert CarmenFile.sniff(path.read_bytes()[:4096], path) is known
    if not known:
        assert "a text file, not a recording" in refusal(path)


def test_80_m_are_no_return_and_a_line_without_ipc_time_takes_the_loggers(path: Path) -> None:
    path.write_text("FLASER 3 79.99 80.00 81.83 1.0 2.0 0.0 1.0 2.0 0.0 0.000000 nohost 7.25\n")
    (sweep,), _ = sweeps_of(path)
    assert sweep.planar.ranges.tolist() == pytest.approx([79.99, math.inf, math.inf])
    assert sweep.planar.range_max == 80.0
    assert sweep.stamp_ns == 7_250_000_000


@pytest.mark.parametrize("line", [robotlaser(1.0), flaser(1.0), odom("1.0")])
def test_a_line_whose_keyword_is_damaged_is_told(path: Path, line: str) -> None:
    """Its keyword comes once, unlike another sensor's."""
    for place in range(len(line.split()[0])):
        for put, cut in (("", 1), ("", 2), ("7", 0), ("7", 1), (" ", 1), ("\n" * (place > 0), 1)):
            damaged = line[:place] + put + line[place + cut :]
            path.write_text(flaser(0.5) + damaged + flaser(1.5))
            _, told = read_rest(path)
            assert told, damaged
            assert all("after 0.500 s is lost" in one for one in told), damaged


HOLE = "\0" * 50 + " 1.0 robot 1.0\n"  # it swallowed the end of a line and the lines after it
NO_TEXT = "one piece that is no text after 1.500 s is lost"
LATER_LASERS = robotlaser(2.0).replace("SER1", "SER2") * 2  # another digit is another laser
NO_BREAK = flaser(2.0).replace("FLASER ", "FLASER\u00a0")  # which has two bytes
TWO_LEFT = "OD0" + flaser(2.0)[30:].replace(BASE, "1.0 2\x7f0 0.0") + flaser(2.5)
OVER_A_BREAK = "ODOM 0 0 0 0 0 0 2.0 fuzz 2.0" + "\0\0\0\0" + robotlaser(2.5)[3:]
CUT_WITHIN = robotlaser(2.0).replace(" 0.4 0.3 ", " ").replace(" nohost 2.", " nohost 3.")


@pytest.mark.parametrize(
    ("line", "scans", "told"),
    [
        pytest.param(NO_BREAK, 1, "one FLASER after 1.500 s", id="a no-break space for a blank"),
        *(
            (robotlaser(2.0).replace("ROBOTLASER1", word), 1, "one ROBOTLASER1 after 1.500 s")
            for word in ("ROBOLASER1", "ROBOTLASER", "ROBOTTLASER1", "ROBOTLASER1x")
        ),
        (robotlaser(1.0).replace("SER1", "SERq") + LATER_LASERS, 1, "one ROBOTLASER1 after 1.500"),
        *((start + HOLE + flaser(2.5) + "\0" * 20, 2, NO_TEXT) for start in ("# a c", "0.12 ")),
        ("FL\x1f2.67 " + HOLE + flaser(2.5), 2, NO_TEXT),
        pytest.param(TWO_LEFT, 2, NO_TEXT, id="a control sign in what is left of two lines"),
        pytest.param(OVER_A_BREAK, 1, NO_TEXT, id="zeros over the end of a whole line"),
        pytest.param(CUT_WITHIN, 1, "one ROBOTLASER1 after 1.500 s", id="numbers cut out"),
    ],
)
def test_a_scan_that_damage_hides_is_told(path: Path, line: str, scans: int, told: str) -> None:
    """Some were lost in silence, or had the logger's time for their stamp."""
    known = robotlaser(1.5) if "ROBOT" in told or line is OVER_A_BREAK else flaser(1.5)
    path.write_text(known + line, encoding="utf-8")
    found, (said,) = read_rest(path)
    assert sum("laser" in message.topic for message in found) == scans
    assert "line 2 (byte " in said
    assert told in said


@pytest.mark.parametrize("cut", [3, 5, 16])
def test_a_log_cut_inside_its_last_stamp_has_no_scan_of_another_time(path: Path, cut: int) -> None:
    sound, behind = flaser(1_700_000_000.5, AHEAD), len(" nohost 1700000000.500000\n")
    path.write_text((sound + sound)[: -behind - cut])
    sweeps, stream = sweeps_of(path)
    assert [sweep.stamp_ns for sweep in sweeps] == [1_700_000_000_500_000_000]
    assert len(stream.log.damage) == 1


@pytest.mark.parametrize("method", ["seek", "readline"])
def test_a_failing_disk_is_told(method: str, front: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(BytesIO):
        pass

    def fail(*_: int) -> int:
        raise OSError(5, "Input/output error")

    setattr(Failing, method, fail)
    content = front.read_bytes()
    monkeypatch.setattr(Path, "open", lambda *_: Failing(content))
    assert refusal(front) == f"{front}: cannot read: Input/output error"


def test_a_mounting_may_differ_by_rounding(path: Path) -> None:
    """By more where the poses of the laser were corrected and those of the robot were not."""
    for laser, known in (("1.109 2.0 0.0", True), ("1.12 2.0 0.0", False), ("5.9 5.1 0", False)):
        path.write_text(flaser(1.0, AHEAD) + flaser(1.1, laser))
        sweeps, stream = sweeps_of(path)
        mounts = [sweep.base_from_laser.x for sweep in sweeps]
        assert mounts == pytest.approx([0.1 * known] * 2, abs=0.01)
        said = "no transform from 'base_link'"
        assert any(said in line for line in stream.warnings) is not known


@pytest.mark.parametrize("word", ["", "ODOM ", "PARAM ", "1.2.3 ", "word ", "-inf "])
@pytest.mark.parametrize("line", [flaser(2.0), robotlaser(2.0)])
def test_a_laser_line_without_its_keyword_is_told(path: Path, line: str, word: str) -> None:
    first = flaser(1.0)
    path.write_text(first + word + line.partition(" ")[2] + odom("3.0"))
    place = f"line 2 (byte {len(first)})"
    with open_log(path) as log:
        assert [m.topic for m in log.messages()] == ["/tf_static", "/odom", "/flaser", "/odom"]
        assert log.damage == [f"{path}: {place} is damaged: one laser line after 1.000 s is lost"]
        assert log.missing == {}


@pytest.mark.parametrize(
    "line",
    [
        robotlaser(2.0).replace("SER1", "SER2"),
        robotlaser(2.0).replace("SER1", "SER10"),
        flaser(2.0, name="FLASER3"),
        odom("2.0").replace("ODOM", "ODOM2"),
        robotlaser(2.0).replace("ROBOTLASER1", "RAWLASER1"),
        flaser(2.0, name="SONAR"),
        "IMU 0.1 0.2 9.8 1 0 0 0 0.2 0.3 2.0 nohost 2.0\n",
        "TRUEPOS 1 2 0.5 1 2 0.5 2.0 nohost 2.0\n",
        "TRUEPOS 0.1 2 0.5 1 2 0.5 2.0 nohost 2.0\n",
        "PARAM laser_front_laser_resolution 0.5 nohost 0.0\n",
        "SYNC 3 nohost 0.0\n",
        "NMEAGGA 1 102030.5 4758.1 N 734.2 E 1 8 0.9 263.0 1 47.9 0.0 2.0 nohost 2.0\n",
        "2 words\n",
        "ODOMETRY 1\n",
        "\n",
    ],
)
def test_lines_of_other_kinds_are_no_damage(path: Path, line: str) -> None:
    """They come again and again."""
    path.write_text(flaser(1.0) + line + odom("3.0") + line)
    found, said = read_rest(path)
    assert [m.topic for m in found] == ["/tf_static", "/odom", "/flaser", "/odom"]
    assert said == []


@pytest.mark.parametrize("line", [flaser(2.5), robotlaser(2.5)])
@pytest.mark.parametrize(
    "into",
    [
        odom("2.0").replace("7.5\n", "7.5"),
        flaser(2.0)[:-3],
        *(whole.rsplit("ost", 1)[0] for whole in (odom("2.0"), flaser(2.0), robotlaser(2.0))),
    ],
)
def test_a_line_that_ran_into_the_one_before_is_told(path: Path, into: str, line: str) -> None:
    """Some bytes were cut out across the end of a line: a scan was lost in silence."""
    path.write_text(flaser(1.5) + into + line[20:])
    found, (told,) = read_rest(path)
    assert [m.time_ns for m in found if m.topic == "/odom"] == [1_500_000_000, 2_000_000_000]
    assert "line 2 (byte " in told
    assert "one other line (but for its end) after 1.500 s is lost" in told


@pytest.mark.parametrize("line", [odom("2.5"), flaser(2.5), robotlaser(2.5)])
@pytest.mark.parametrize(
    "into", ["", "# a log of ", "PARAM robot_front", "FLAS0", "ROBOT1.", "ROBOTLASER?~"]
)
def test_a_line_without_its_beginning_is_told(path: Path, into: str, line: str) -> None:
    """Some bytes were cut out before its end, in the line itself or across the one before."""
    numbers = line if line.startswith("ODOM") else line.split(" ", 2)[2]
    path.write_text(flaser(1.5) + into + numbers.removeprefix("ODOM "))
    found, (told,) = read_rest(path)
    assert [m.time_ns for m in found if m.topic == "/odom"] == [1_500_000_000]
    assert "line 2 (byte " in told
    assert "after 1.500 s is lost" in told

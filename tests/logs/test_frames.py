"""Choosing topics, frames and one of several lasers, from what there is; the tree of frames."""

import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.messages import TransformRecord
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers import encoding
from specmap_cli.logs.selection import Selection, TransformTree, odometry_ancestor, select
from specmap_cli.logs.sensors import SeveralSensorsError
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import SECOND, START, sweeps_of
from tests.turning import configured


def write(path: Path, scans: list[str], odometry: list[str]) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.0), stamp_ns=START)
        for topic in scans:
            if "points" in topic:
                log.cloud(topic, "laser", START, [[1.0, 2.0, 0.5], [2.0, 1.0, 0.5]])
            else:
                log.scan(topic, "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
        for topic in odometry:
            log.odometry(topic, "odom", "base_link", START, Pose2(0.0, 0.0, 0.0))


def write_scan(log: LogWriter, stamp_ns: int = START, frame: str = "laser") -> None:
    log.scan("/scan", frame, stamp_ns, -1.0, 1.0, [1.0, 1.0], range_max=8.0)


def choose(path: Path, **options: object) -> Selection:
    with open_log(path) as log:
        return select(log, configured(LogConfig, "logs", options))


def test_a_log_without_scans_says_what_it_has(path: Path) -> None:
    write(path, [], ["/odom"])
    held = "/odom (nav_msgs/msg/Odometry), /tf_static (tf2_msgs/msg/TFMessage)"
    none = f"{path}: no LaserScan, MultiEchoLaserScan or PointCloud2 in it"
    with pytest.raises(LogError, match=f"^{re.escape(f'{none}; it has {held}')}$"):
        choose(path)
    LogWriter(path).close()
    with pytest.raises(LogError, match="it has no messages at all"):
        choose(path)


def test_several_topics_are_listed_ready_to_paste(path: Path) -> None:
    write(path, ["/front", "/points"], [])
    with pytest.raises(UsageError) as caught:
        choose(path)
    assert str(caught.value) == (
        f"{path}: 2 topics carry scans: choose `--scan-topic /front` (LaserScan, 1 message) "
        "or `--scan-topic /points` (PointCloud2, 1 message)"
    )
    points = choose(path, scan_topic="/points", band_min_m=0.5, band_max_m=2.0)
    assert (points.topic.name, points.band_m) == ("/points", (0.5, 2.0))
    assert points.note == (
        "scans from /points (PointCloud2, 1), height band 0.5 to 2 m above the floor, "
        "no odometry, base frame base_link"
    )
    assert choose(path, scan_topic="front").topic.name == "/front"
    write(path, ["/scan"], ["/odom", "/visual"])
    with pytest.raises(UsageError, match=r"`--odom-topic /odom` .* or `--odom-topic /visual`"):
        choose(path)
    assert choose(path, odom_topic="/visual").odom_topics == ("/visual",)
    assert choose(path, use_odometry=False).odometry is None


def test_an_unknown_name_is_refused_with_those_there_are(path: Path) -> None:
    write(path, ["/scan"], ["/odom"])
    for option in ("scan", "odom"):
        said = f"--{option}-topic /x: no .* topics with .*: /{option} "
        with pytest.raises(UsageError, match=said):
            choose(path, **{f"{option}_topic": "/x"})
    none = "--base-frame body: no transform joins it to the laser's frame 'laser'"
    with pytest.raises(UsageError, match=f"^{none}; choose from base_link, laser$") as caught:
        choose(path, base_frame="body")
    assert caught.value.hint == "choose from base_link, laser"
    chosen = choose(path, base_frame="/laser")
    assert chosen.base_frame == "laser"
    assert chosen.base_from_laser[0, 3] == 0.0


@pytest.mark.parametrize(
    ("after_s", "both_s"), [(0, 10), (7, 3), (8, None), (10, None), (20, None)]
)
def test_two_recordings_as_one_are_said(tmp_path: Path, after_s: int, both_s: int | None) -> None:
    paths = [tmp_path / "first.mcap", tmp_path / "second.mcap"]
    for path, begins_s in zip(paths, (0, after_s), strict=True):
        with LogWriter(path) as log:
            log.static_transform("base_link", "laser", (0.1, 0.0, 0.0), stamp_ns=START)
            for number in range(11):
                write_scan(log, START + (begins_s + number) * SECOND)
    with open_log(paths) as both:
        warnings = select(both, LogConfig()).warnings
    said = [line.partition(": ")[0] for line in warnings if "not parts of one" in line]
    both_hold = f"{paths[0]} and {paths[1]} both hold /scan for the same {both_s} s"
    assert said == ([] if both_s is None else [both_hold])


def test_the_settings_say_how_long_readable_scans_and_odometry_are_looked_for(path: Path) -> None:
    with LogWriter(path) as log:
        for _ in range(3):
            log.raw("/scan", "sensor_msgs/msg/LaserScan", b"rubbish", START)
        write_scan(log)
    assert choose(path, tried_messages=4).sensor.frame == "laser"
    with pytest.raises(
        LogError, match=r"/scan: no usable scan: not a sensor_msgs/msg/LaserScan: .*; tried 3 mess"
    ):
        choose(path, tried_messages=3)
    with LogWriter(path) as log:
        for _ in range(3):
            log.raw("/odom", "nav_msgs/msg/Odometry", b"rubbish", START)
        log.odometry("/odom", "odom", "robot", START, Pose2(0.0, 0.0, 0.0))
        write_scan(log)
    assert choose(path, tried_messages=3).base_frame == "laser"
    assert choose(path, tried_messages=4).base_frame == "robot"


@pytest.mark.parametrize(("most", "found"), [(2_500, False), (3_001, True)])
def test_settings_say_how_long_a_laser_is_searched(path: Path, most: int, found: bool) -> None:
    with LogWriter(path) as log:
        for i in range(3000):
            log.transform("odom", "base_link", START + i, Pose2(0.001 * i, 0.0, 0.0))
        write_scan(log)
        log.transform("base_link", "laser", START + 4000, Pose2(0.3, 0.0, 0.0))
    chosen = choose(path, transform_messages=most)
    assert chosen.base_frame == "base_link"
    assert bool(chosen.base_from_laser[0, 3] == 0.3) is found
    said = (
        f"the laser's place was searched in the first {most:,} messages of transforms only: "
        "log.transform_messages says how many"
    )
    assert (said in chosen.warnings) is not found
    assert len(chosen.warnings) == (0 if found else 2)


def test_a_base_that_is_asked_for_is_searched_on_its_own(path: Path) -> None:
    """Another base that is joined early must not end the search."""
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.0), stamp_ns=START)
        for i in range(2500):
            log.transform("odom", "base_link", START + i, Pose2(0.001 * i, 0.0, 0.0))
        write_scan(log)
        log.transform("trailer", "odom", START + 4000, Pose2(0.0, 0.0, 0.0))
    assert choose(path, base_frame="trailer").base_frame == "trailer"


AT_THE_ORIGIN = "the laser is taken to sit at the origin of 'base_link'"
MOVES_ANOTHER = "the odometry moves 'body', which no transform joins to 'base_link'"


@pytest.mark.parametrize(
    ("transforms", "moves", "base", "floor", "said"),
    [
        (["base_footprint base_link 0.1", "base_link laser 0.3"], "", "base_link", -0.1, ""),
        (["base_link laser 0.3"], "", "base_link", 0.0, ""),
        (["base_link laser 0.3"], "body", "base_link", 0.0, MOVES_ANOTHER),
        (["base laser 0.3"], "", "base", 0.0, ""),
        (["base_footprint laser 0.3"], "", "base_footprint", 0.0, ""),
        (["body laser 0.3"], "", "body", None, ""),
        (["base_link camera 0.3"], "", "base_link", None, ""),
        ([], "", "laser", None, ""),
        ([], "base_link", "base_link", None, AT_THE_ORIGIN),
    ],
)
def test_the_base_is_the_first_usual_frame_that_is_joined_to_the_laser(
    path: Path, transforms: list[str], moves: str, base: str, floor: float | None, said: str
) -> None:
    with LogWriter(path) as log:
        for parent, child, z in map(str.split, transforms):
            log.static_transform(parent, child, (0.0, 0.0, float(z)), stamp_ns=START)
        if moves:
            log.odometry("/odom", "odom", moves, START, Pose2(0.0, 0.0, 0.0))
        write_scan(log, frame="laser" if transforms or not moves else "of_optical_frame")
    chosen = choose(path)
    assert chosen.base_frame == base
    assert chosen.floor_m == pytest.approx(floor)
    assert said in "".join(chosen.warnings[:1])
    assert said != AT_THE_ORIGIN or len(chosen.warnings) == 1


@pytest.mark.parametrize(
    ("static", "moving", "laser", "base", "from_odom"),
    [
        (["robot1/base_link robot1/laser"], ["robot1/odom robot1/base_link"], "robot1/laser", 0, 1),
        (["base robot1/laser"], [], "robot1/laser", 0, None),
        (["robot1/base_link robot1/front/laser"], [], "robot1/front/laser", 0, None),
        # of another robot, which the map joins to this one
        (["map robot2/base_link", "map robot1/body", "robot1/body robot1/laser"], [],
         "robot1/laser", 2, None),
        (["chassis mast", "mast laser"], ["odom chassis"], "laser", 0, 1),
        (["chassis mast", "mast laser"], [], "laser", 0, None),
        (["mast laser"], ["chassis mast"], "laser", 0, None),
        (["map chassis", "chassis laser"], [], "laser", 1, None),
    ],
)  # fmt: skip
def test_a_base_is_found_by_its_namespace_or_by_what_carries_the_laser(
    path: Path, static: list[str], moving: list[str], laser: str, base: int, from_odom: int | None
) -> None:
    """Upside down it must be: the map of a laser that is taken for its own base is mirrored."""
    with LogWriter(path) as log:
        for parent, child in map(str.split, static):
            roll = (1.0, 0.0, 0.0, 0.0) if child == laser else (0.0, 0.0, 0.0, 1.0)
            log.static_transform(parent, child, (0.1, 0.0, 0.0), roll, START)
        for parent, child in map(str.split, moving):
            log.transform(parent, child, START, Pose2(1.0, 0.0, 0.0))
        log.scan("/scan", laser, START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
    chosen = choose(path)
    assert chosen.base_frame == static[base].split()[0]
    assert chosen.base_from_laser[2, 2] == pytest.approx(-1.0)
    assert chosen.odom_frame == (None if from_odom is None else moving[0].split()[0])
    assert not chosen.warnings


def place(log: LogWriter, topic: str, x: float, at: int = START, child: str = "laser") -> None:
    """A transform of the laser from its base, on a topic."""
    there = encoding.Transform("base_link", child, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    log.raw(topic, encoding.TF_MESSAGE, encoding.transforms_cdr(at, [there]), at)


def test_of_two_robots_each_has_its_own_transforms_and_odometry(path: Path) -> None:
    with LogWriter(path) as log:
        for number in (1, 2):
            log.scan(f"/robot{number}/scan", "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
            place(log, f"/robot{number}/tf_static", 0.1 * number)
            here = Pose2(0.0, 0.0, 0.0)
            log.odometry(f"/robot{number}/odom", "odom", "base_link", START, here)
    for number in (1, 2):
        chosen = choose(path, scan_topic=f"/robot{number}/scan")
        assert chosen.base_from_laser[0, 3] == pytest.approx(0.1 * number)
        assert chosen.odom_topics == (f"/robot{number}/odom",)
        assert not chosen.warnings
    assert choose(path, scan_topic="/robot1/scan", odom_topic="/robot2/odom").odometry == "topic"
    with open_log(path) as log:
        told = summarize(log)
    assert told.next_command == f"specmap build {path} --scan-topic /robot1/scan"
    assert [frame.xyz_m[0] for frame in told.frames] == [0.1]


@pytest.mark.parametrize("topic", ["/tf_static", "/tf"])
@pytest.mark.parametrize(("second", "said"), [(0.102, False), (0.4, True)])
def test_a_changing_mounting_is_warned_of(
    path: Path, topic: str, second: float, said: bool
) -> None:
    with LogWriter(path) as log:
        write_scan(log)
        place(log, "/tf_static", 0.0, child="foot")
        for number, x in enumerate((0.1, second)):
            place(log, topic, x, START + number)
            log.transform("odom", "base_link", START + number, Pose2(x, 0.0, 0.0))
    chosen = choose(path, base_frame="foot")  # beside the laser's frame, not above it
    assert chosen.base_from_laser[0, 3] == pytest.approx(second)
    assert len(chosen.warnings) == said
    changes = "the transform 'base_link' -> 'laser' changes, by 0.30 m and 0 degrees"
    assert any(changes in line for line in chosen.warnings) is said


@pytest.mark.parametrize(
    ("degrees", "limit", "said"),
    [(8, {}, False), (12, {}, True), (12, {"tilt_max_rad": 0.3}, False), (172, {}, False)],
)
def test_a_tilt_is_warned_of(path: Path, degrees: float, limit: dict[str, Any], said: bool) -> None:
    half = math.radians(degrees) / 2
    with LogWriter(path) as log:
        roll = (math.sin(half), 0.0, 0.0, math.cos(half))
        log.static_transform("base_link", "laser", (0.0, 0.0, 1.0), roll, START)
        write_scan(log)
    warnings = choose(path, **limit).warnings
    assert any(f"is tilted by {degrees} degrees" in line for line in warnings) is said


@pytest.mark.parametrize(
    ("edges", "found"),
    [
        ([("odom", "base_link", True)], "odom"),
        ([("wheel_odom", "foot", True), ("foot", "base_link", False)], "wheel_odom"),
        ([("odom", "foot", True), ("foot", "base_link", True)], "odom"),
        ([("odom", "base_link", False)], None),
        ([("map", "base_link", True)], None),
        ([("map", "ODOM", True), ("ODOM", "base_link", True)], "ODOM"),
        ([], None),
    ],
)
def test_odometry_comes_from_a_moving_frame_of_that_name_above_the_base(
    edges: list[tuple[str, str, bool]], found: str | None
) -> None:
    tree = TransformTree()
    for parent, child, moving in edges:
        tree.add(TransformRecord(0, parent, child, np.eye(4)), dynamic=moving)
    assert odometry_ancestor(tree, "base_link") == found


def ahead(x: float, y: float = 0.0, z: float = 0.0) -> FloatArray:
    """The transform of a frame that is moved from its parent, not turned."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def test_any_two_frames_of_a_tree_are_joined() -> None:
    rng = np.random.default_rng(2)
    tree = TransformTree()
    root_from = {"root": np.eye(4)}
    for number in range(12):
        parent = sorted(root_from)[rng.integers(len(root_from))]
        turn = Rotation.from_rotvec(rng.normal(size=3))
        matrix = ahead(*rng.normal(size=3))
        matrix[:3, :3] = turn.as_matrix()
        tree.add(TransformRecord(0, parent, f"frame{number}", matrix), dynamic=False)
        root_from[f"frame{number}"] = root_from[parent] @ matrix
    for target, root_from_target in root_from.items():
        for source, root_from_source in root_from.items():
            expected = np.linalg.inv(root_from_target) @ root_from_source
            found = tree.lookup(target, source)
            assert found is not None
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert tree.lookup("root", "elsewhere") is None
    assert tree.frames == set(root_from)


def chain(length: int) -> TransformTree:
    """frame0 -> frame1 -> ..., each a metre ahead of its parent."""
    tree = TransformTree()
    for number in range(length):
        record = TransformRecord(0, f"frame{number}", f"frame{number + 1}", ahead(1.0))
        tree.add(record, dynamic=number % 2 == 1)
    return tree


def test_a_chain_of_frames_without_end_is_a_loop() -> None:
    assert chain(90).lookup("frame0", "frame90") is not None
    assert chain(200).lookup("frame0", "frame200") is None
    for length in (0, 1, 3):
        tree = chain(length)
        tree.add(TransformRecord(0, f"frame{length}", "frame0", np.eye(4)), dynamic=False)
        assert tree.lookup("frame0", "elsewhere") is None
    assert len(list(tree.ancestors("frame0"))) == 100


Laser = tuple[Any, ...]  # frame, bearings of the first and the last beam, beams if not 11


def write_lasers(path: Path, lasers: list[Laser]) -> None:
    """One scan of each on /scan, ten a second."""
    with LogWriter(path) as log:
        log.static_transform("base_link", "front", (0.2, 0.0, 0.0), stamp_ns=START)
        log.static_transform("base_link", "rear", (-0.2, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), START)
        for number, laser in enumerate(lasers):
            frame, low, high, beams = (*laser, 11)[:4]
            stamp, step = START + number * SECOND // 10, (high - low) / (beams - 1)
            log.scan("/scan", frame, stamp, low, step, np.full(beams, 2.0), range_max=8.0)


FRONT, REAR = ("front", -1.5, 1.5), ("rear", -1.5, 1.5)
WIDE, NARROW = ("laser", -2.0, 2.0), ("laser", -0.5, 0.5)


@pytest.mark.parametrize(
    ("lasers", "options", "said"),
    [
        (
            [FRONT, REAR] * 15,
            {},
            "2 sensors on one topic: choose `--scan-frame front` (15 of the first 30 scans) or "
            "`--scan-frame rear` (15 of the first 30 scans)",
        ),
        (
            [WIDE, NARROW] * 10,
            {},
            "2 sensors on one topic: choose `--scan-frame 'laser#1'` (-115 to 115 degrees, 10 of "
            "the first 20 scans) or `--scan-frame 'laser#2'` (-29 to 29 degrees, 10 of the first "
            "20 scans)",
        ),
        (
            [FRONT, REAR, FRONT],
            {"scan_frame": "top"},
            "--scan-frame top: no scans of such a sensor; there are front (2 of the first 3 "
            "scans), rear (1 of the first 3 scans)",
        ),
    ],
    ids=["frames", "fields of view", "unknown"],
)
def test_one_of_several_sensors_must_be_chosen(
    path: Path, lasers: list[Laser], options: dict[str, str], said: str
) -> None:
    write_lasers(path, lasers)
    with pytest.raises(UsageError) as caught:
        sweeps_of(path, **options)
    assert str(caught.value) == f"{path}: /scan: {said}"


@pytest.mark.parametrize(
    ("lasers", "options", "kept"),
    [
        ([FRONT, REAR] * 15 + [FRONT], {"scan_frame": "front"}, range(0, 31, 2)),
        ([FRONT, REAR] * 15 + [FRONT], {"scan_frame": "/rear"}, range(1, 31, 2)),
        ([WIDE, NARROW] * 10, {"scan_frame": "laser#2"}, range(1, 20, 2)),
        ([FRONT] * 12 + [REAR] * 4, {"look_scans": 10}, range(12)),
        ([REAR] * 2 + [FRONT] * 28, {}, range(2, 30)),
    ],
    ids=["front", "rear", "field of view", "late", "rare"],
)
def test_only_the_sweeps_of_one_sensor_are_read(
    path: Path, lasers: list[Laser], options: dict[str, Any], kept: range
) -> None:
    write_lasers(path, lasers)
    sweeps, stream = sweeps_of(path, **options)
    assert [sweep.index for sweep in sweeps] == list(range(len(kept)))
    assert [(sweep.stamp_ns - START) * 10 // SECOND for sweep in sweeps] == list(kept)
    mount = {"front": 0.2, "rear": -0.2, "laser": 0.0}[stream.selection.sensor.frame]
    assert {sweep.base_from_laser.x for sweep in sweeps} == {mount}
    left_out = len(lasers) - len(kept)
    assert stream.counts["other_sensor"] == left_out
    said = f"scans of another sensor on the topic that were left out: {left_out}"
    assert [line for line in stream.warnings if "no transform" not in line] == [said]
    if "scan_frame" in options:
        sensor = options["scan_frame"].lstrip("/")
        note = f"scans from /scan (LaserScan, {len(lasers)}) of sensor {sensor}, "
        assert stream.selection.note.startswith(note)


def test_a_rare_sensor_is_left_out_without_a_question(path: Path) -> None:
    """As a scan whose frame was damaged; a tenth of the scans is no accident."""
    write_lasers(path, [REAR] * 3 + [FRONT] * 27)
    with pytest.raises(SeveralSensorsError) as caught:
        sweeps_of(path)
    assert caught.value.best == "front"
    sent = pickle.loads(pickle.dumps(caught.value))  # from a process that runs ahead
    assert (sent.best, str(sent)) == ("front", str(caught.value))
    assert caught.value.within("jobs.toml").hint == caught.value.hint


@pytest.mark.parametrize(
    "lasers",
    [
        pytest.param([("laser", -1.5, 1.5)] * 10 + [("laser", -0.5, 0.5)] * 10, id="set anew"),
        pytest.param([("laser", -1.5, 0), ("laser", 0, 1.5)] * 10, id="halves"),
        pytest.param([("laser", -1.5 + 0.004 * (n % 5), 1.5) for n in range(20)], id="jitter"),
        pytest.param([("laser", -math.pi + n, math.pi + n) for n in range(20)], id="any start"),
        pytest.param([("laser", -1.5, 1.5 + 0.1 * n) for n in range(20)], id="ever wider"),
        pytest.param([*[("laser", -1.5, 1.5)] * 18, *[("laser", 0, 9)] * 2], id="two damaged"),
        pytest.param([("laser", -1.5, 1.5), ("/laser", -1.5, 1.5)] * 10, id="slash"),
        pytest.param([("laser", -math.pi, math.pi, 355 + n % 7) for n in range(20)], id="beams"),
    ],
)
def test_one_laser_stays_one(path: Path, lasers: list[Laser]) -> None:
    write_lasers(path, lasers)
    sweeps, stream = sweeps_of(path)
    assert len(sweeps) == 20
    assert [sensor.name for sensor in stream.selection.sensors] == ["laser"]
    halves = lasers[0] == ("laser", -1.5, 0)
    assert any("the scans are 2 segments of a turn" in line for line in stream.warnings) == halves


def test_info_lists_the_sensors_and_the_command_that_chooses(path: Path) -> None:
    write_lasers(path, [FRONT, FRONT, REAR] * 10)
    with open_log(path) as log:
        summary = summarize(log)
        chosen = summarize(log, LogConfig(scan_frame="rear"))
    assert summary.problem is not None
    assert "2 sensors on one topic" in summary.problem
    assert summary.next_command == f"specmap build {path} --scan-frame front"
    assert chosen.next_command == f"specmap build {path} --scan-frame rear"
    assert "  several sensors on the topic: front (20 scans), rear (10 scans)" in chosen.lines()

"""Simulated recordings: what is written is what was simulated, and always the same."""

import shlex
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from specmap_cli.cli import main
from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.simulate import SimulationResult, simulate
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.simulation.worlds import RoomTruth
from tests.conftest import SAMPLE_LOGS
from tests.plugins import module_at

STORE = get_typestore(Stores.ROS2_HUMBLE)


def messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time and message of a recording, by readers that are not ours."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert schema is not None
            yield channel.topic, message.log_time, STORE.deserialize_cdr(message.data, schema.name)


def tum(path: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.loadtxt(path, ndmin=2)


def test_the_file_holds_the_scans_of_the_tour_in_order_and_odometry_that_encloses_them(
    flat_log: SimulationResult, flat_tour: list[tuple[Sweep, Pose2]]
) -> None:
    found = list(messages(flat_log.log))
    topics, times, _ = zip(*found, strict=True)
    assert topics[0] == "/tf_static"
    assert list(times[1:]) == sorted(times[1:])
    assert set(topics) == {"/tf_static", "/scan", "/odom"}
    scans = [message for topic, _, message in found if topic == "/scan"]
    assert len(scans) == len(flat_tour) == flat_log.scans
    for scan, (sweep, _) in zip(scans[::17], flat_tour[::17], strict=True):
        assert scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec == sweep.stamp_ns
        np.testing.assert_array_equal(scan.ranges, sweep.planar.ranges)
        bearings = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        np.testing.assert_allclose(bearings, sweep.planar.bearings, atol=1e-6)
        assert sweep.planar.full_circle
    odometry = [(t, m.pose.pose.position) for topic, t, m in found if topic == "/odom"]
    stamps = np.array([stamp for stamp, _ in odometry])
    places = np.array([[p.x, p.y] for _, p in odometry])
    sweeps = [sweep for sweep, _ in flat_tour]
    assert stamps[0] < sweeps[0].stamp_ns
    assert stamps[-1] > sweeps[-1].stamp_ns
    wanted = np.array([sweep.stamp_ns for sweep in sweeps])
    for axis in (0, 1):
        told = [sweep.odom_from_base[axis] for sweep in sweeps if sweep.odom_from_base]
        expected = np.interp(wanted - stamps[0], stamps - stamps[0], places[:, axis])
        np.testing.assert_allclose(told, expected, atol=1e-6)


def test_the_truth_has_a_line_a_scan_at_its_stamp(
    flat_log: SimulationResult, flat_tour: list[tuple[Sweep, Pose2]]
) -> None:
    lines = flat_log.truth.read_text().splitlines()
    assert len(lines) == len(flat_tour)
    for line, (sweep, pose) in zip(lines, flat_tour, strict=True):
        seconds, nanoseconds = line.split()[0].split(".")
        assert int(seconds) * 10**9 + int(nanoseconds.ljust(9, "0")) == sweep.stamp_ns
        _, x, y, z, qx, qy, qz, qw = map(float, line.split())
        assert [x, y] == pytest.approx([pose.x, pose.y], abs=1e-6)
        assert [z, qx, qy] == [0.0, 0.0, 0.0]
        assert np.cos(2 * np.arctan2(qz, qw) - pose.theta) == pytest.approx(1.0)


def test_the_same_options_give_the_same_bytes(
    flat: GridMap, flat_options: SimulationOptions, flat_log: SimulationResult, tmp_path: Path
) -> None:
    again = simulate(flat, flat_options, tmp_path / "again.mcap", tmp_path / "elsewhere.txt")
    assert again.log.read_bytes() == flat_log.log.read_bytes()
    assert again.truth == tmp_path / "elsewhere.txt"
    assert again.truth.read_bytes() == flat_log.truth.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["again.mcap", "elsewhere.txt"]


def test_a_robot_that_just_fits_records_where_it_stands(tmp_path: Path) -> None:
    cells = np.full((30, 30), OCCUPIED, dtype=np.uint8)
    cells[9:22, 9:22] = FREE
    made = simulate(GridMap(cells, 0.05), SimulationOptions(beams=16), tmp_path / "a.mcap")
    assert (made.scans, made.distance_m) == (1, 0.0)


def test_paths_may_be_text_and_the_advance_is_told(flat: GridMap, tmp_path: Path) -> None:
    progress = Mock(spec=Silent())
    options = SimulationOptions(max_duration_s=2.0, beams=8, rate_hz=5)
    made = simulate(flat, options, str(tmp_path / "a.mcap"), str(tmp_path / "b.tum"), progress)
    progress.start.assert_called_once_with("simulate", 11)
    poses = len((tmp_path / "b.tum").read_text().splitlines())
    assert progress.advance.call_count == made.scans == poses
    assert made.as_dict()["log"] == str(tmp_path / "a.mcap")
    metres, area = f"{made.distance_m:.0f}", f"{made.area_m2:.0f}"
    assert made.lines() == [
        f"{tmp_path}/a.mcap: 11 scans in 2 s over {metres} m through {area} m2",
        f"true poses in {tmp_path}/b.tum",
    ]


@pytest.mark.parametrize(
    ("log", "truth", "told"),
    [
        ("log.tum", None, r"log\.tum: the recording and the true poses would be one"),
        ("log.tum", "log.tum", r"log\.tum: the recording and the true poses would be one"),
        ("log.mcap", "no/truth.tum", r"truth.*cannot be written"),
    ],
)
def test_a_truth_that_has_no_place_leaves_no_recording(
    flat: GridMap, tmp_path: Path, log: str, truth: str | None, told: str
) -> None:
    options = SimulationOptions(max_duration_s=0.2, beams=8)
    with pytest.raises(UsageError, match=told):
        simulate(flat, options, tmp_path / log, None if truth is None else tmp_path / truth)
    assert list(tmp_path.iterdir()) == []


def test_the_plan_of_the_sample_logs_is_what_its_script_draws(office: GridMap) -> None:
    script = module_at(SAMPLE_LOGS / "draw_office.py")
    drawn = script.draw_plan(script.draw_rooms())
    np.testing.assert_array_equal(office.free, drawn[::-1] == script.FREE)
    np.testing.assert_array_equal(office.occupied, drawn[::-1] == script.OCCUPIED)


@pytest.mark.parametrize(("name", "visits"), [("office", 2), ("office_again", 1)])
def test_the_sample_logs_visit_every_room(office_rooms: RoomTruth, name: str, visits: int) -> None:
    rooms = office_rooms.at(tum(SAMPLE_LOGS / f"{name}.tum")[:, 1:3], reach_m=0.3)
    rooms = rooms[rooms > 0]
    stays = np.split(rooms, np.flatnonzero(np.diff(rooms)) + 1)
    counts = Counter(int(stay[0]) for stay in stays if len(stay) >= 20)
    assert set(counts) == set(range(1, office_rooms.count + 1))
    assert min(counts.values()) >= visits


def readme_lines() -> list[list[str]]:
    """The `specmap simulate` lines of the README of the sample logs, as arguments."""
    text = (SAMPLE_LOGS / "README.md").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.startswith("specmap simulate")]
    return [shlex.split(line)[1:] for line in lines]


@pytest.mark.parametrize("arguments", readme_lines(), ids=lambda a: Path(a[3]).stem)
def test_the_lines_of_the_readme_make_the_sample_logs(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sample = SAMPLE_LOGS.parent / arguments[3]
    arguments = [*arguments[:3], str(tmp_path / "made.mcap"), *arguments[4:]]
    monkeypatch.chdir(SAMPLE_LOGS.parent)
    assert main([*arguments, "--quiet"]) == 0
    # other versions of the libraries may round and compress otherwise
    assert (tum(tmp_path / "made.tum")[:, 0] == tum(sample.with_suffix(".tum"))[:, 0]).all()
    for (topic, time, made), (kept_topic, kept_time, kept) in zip(
        messages(tmp_path / "made.mcap"), messages(sample), strict=True
    ):
        assert (topic, time) == (kept_topic, kept_time)
        if topic == "/scan":
            np.testing.assert_allclose(made.ranges, kept.ranges, atol=0.0011)


def test_a_lidar_of_several_rings_is_recorded_as_clouds(flat: GridMap, tmp_path: Path) -> None:
    lidar = {"beams": 90, "rings": 16, "range_max_m": 30.0, "sweep_s": 0.08}
    mounted = {"laser_x_m": 0.2, "laser_y_m": -0.1, "laser_yaw_deg": 90, "laser_height_m": 0.8}
    usual = SimulationOptions(field_of_view_deg=360, max_duration_s=0.5)
    made = simulate(flat, usual.model_copy(update=lidar | mounted), tmp_path / "a.mcap")
    found = list(messages(made.log))
    assert {topic for topic, _, _ in found} == {"/tf_static", "/points", "/odom"}
    (mounted,) = found[0][2].transforms
    assert (mounted.header.frame_id, mounted.child_frame_id) == ("base_link", "laser")
    at = mounted.transform.translation
    assert (at.x, at.y, at.z) == (0.2, -0.1, 0.8)
    assert mounted.transform.rotation.z == pytest.approx(np.sqrt(0.5))
    clouds = [message for topic, _, message in found if topic == "/points"]
    assert len(clouds) == made.scans == len(tum(made.truth)) == 6
    assert [field.name for field in clouds[0].fields] == ["x", "y", "z", "time"]
    with open_log([made.log]) as log:
        sweeps = list(SweepStream(log, LogConfig(use_odometry=False)))
    for sweep in sweeps:
        assert sweep.cloud is not None
        assert sweep.cloud_times_s is not None
        assert np.isfinite(sweep.planar.ranges).any()
        assert sweep.cloud[:, 2].min() == pytest.approx(0.0, abs=0.1)  # the floor
        assert sweep.cloud[:, 2].max() == pytest.approx(2.5, abs=0.1)  # the ceiling

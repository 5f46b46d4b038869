"""What a library user needs: few names, loaded late, with the example that the page shows."""

import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import specmap_cli
from specmap_cli.core.errors import instance_of, path_of, paths_of
from specmap_cli.core.geometry import Pose2, nearest_motion
from specmap_cli.core.settings import Config
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.compare import compare_maps
from specmap_cli.pipelines.edit import edit_map
from specmap_cli.pipelines.edits import RequestedEdits
from specmap_cli.pipelines.merge import merge_maps
from specmap_cli.pipelines.simulate import SimulationResult
from specmap_cli.pipelines.update import update_map
from tests.conftest import SAMPLE_LOGS

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "library.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_every_public_name_is_there_and_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in specmap_cli.__all__:
        assert getattr(specmap_cli, name).__name__ == name
        assert getattr(specmap_cli, name).__doc__
        assert name in dir(specmap_cli)
        assert f"`{name}" in text
    with pytest.raises(AttributeError, match="no_such_name"):
        specmap_cli.no_such_name  # noqa: B018


@pytest.mark.parametrize(
    ("more", "shown", "said"),
    [
        ("", "'numpy' in sys.modules", "False"),
        # what is slow to load waits until registration runs
        (".pipelines.build", "{'scipy.sparse', 'specmap_cli.layout'} & {*sys.modules}", "set()"),
    ],
)
def test_importing_needs_nothing_heavy(more: str, shown: str, said: str) -> None:
    code = f"import sys, specmap_cli{more}; print({shown})"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.stdout == f"{said}\n", found.stderr


def test_the_examples_of_the_page_run(
    tiny_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("log.mcap", "other.mcap"):
        shutil.copy(tiny_log, tmp_path / name)
    shutil.copy(SAMPLE_LOGS / "office.png", tmp_path / "plan.png")
    monkeypatch.chdir(tmp_path)
    assert len(EXAMPLES) == 6
    known: dict[str, Any] = {}  # one after another, as they are read
    for example in EXAMPLES:
        exec(compile(example, str(PAGE), "exec"), known)
    shown = capsys.readouterr().out
    assert re.search(r"^\d submaps$", shown, flags=re.MULTILINE)
    assert re.search(r"^0 submap 0 \w+ \d+\.\d m2 \d visits$", shown, flags=re.MULTILINE)
    assert re.search(r"^in submap 0\n0\.\d m, rooms \(0,\), doors \[\]$", shown, re.MULTILINE)
    assert re.search(r"^room 0 \d+% sure$", shown, flags=re.MULTILINE)
    assert re.search(r"^1700000\d+ \d (None|Pose2\(x=)", shown, flags=re.MULTILINE)
    assert "/scan sensor_msgs/msg/LaserScan" in shown
    assert re.search(r"^\d+ rooms$", shown, flags=re.MULTILINE)


QUESTIONS = """
import math, sys
from specmap_cli import Localizer, Scan, SpecmapError, SweepStream, open_log, read_map

map_ = read_map("house")
for x, y in [(1.0, 4.0), (8.0, 4.0), (50.0, 50.0)]:
    room = map_.room_at(x, y)
    print(x, y, "is in", "no room" if room is None else room.name)

route = map_.route("kitchen", "lab")
if not route:
    sys.exit(route.why)
through = " - ".join(map_.rooms[id_].name for id_ in route.rooms)
print(f"{route.length_m:.1f} m: {through}")

localizer = Localizer(map_)
with open_log("log.mcap") as log:
    for sweep in SweepStream(log):
        seen = sweep.planar
        scan = Scan(seen.stamp_ns, seen.ranges, seen.bearings, odometry=sweep.odom_from_base)
        found = localizer.add(scan)
print("the last scan is in", map_.rooms[found.room].name)
x, y, theta = found.map_from_base
print(f"at {x:.2f} {y:.2f}, in", map_.room_at(x, y).name)
"""


def test_a_program_of_thirty_lines_tells_rooms_routes_and_scans(
    flat_map: Map,
    flat_log: SimulationResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In a simulated flat of three rooms above a corridor: two of them have names."""
    truth = read_tum(flat_log.truth)
    motion = nearest_motion(truth.poses[:, :2], flat_map.trajectory.poses[:, :2])  # to the map
    middles = motion.apply(np.array([[1.7, 3.5], [7.4, 3.5], [1.0, 4.0], [8.0, 4.0]]))
    kitchen, lab = (flat_map.room_at(*place) for place in middles[:2].tolist())
    assert kitchen is not None
    assert lab is not None
    names = {kitchen.id: "kitchen", lab.id: "lab"}
    edit_map(flat_map, RequestedEdits(names=names), tmp_path / "house")
    (tmp_path / "log.mcap").symlink_to(flat_log.log)
    monkeypatch.chdir(tmp_path)
    places = str([*map(tuple, middles[2:].tolist())])
    program = QUESTIONS.replace("[(1.0, 4.0), (8.0, 4.0)", places[:-1])
    assert program.count("\n") <= 31
    exec(compile(program, "program", "exec"), {})
    told = capsys.readouterr().out.splitlines()
    assert told[0].endswith("is in kitchen")
    assert told[1].endswith("is in lab")
    assert told[2] == "50.0 50.0 is in no room"
    length, _, through = told[3].partition(" m: ")
    # down through the door at 1.7 m, along the corridor, up through that at 7.45 m
    assert float(length) == pytest.approx(5.75 + 2 * 2.4, abs=1.2)
    assert through.startswith("kitchen - ")
    assert through.endswith(" - lab")
    last = motion @ Pose2(*truth.poses[-1].tolist())
    room = flat_map.room_at(*last[:2])
    assert room is not None
    named = names.get(room.id, room.name)
    assert told[4] == f"the last scan is in {named}"
    at, _, inside = told[5].removeprefix("at ").partition(", in ")
    assert inside == named
    assert math.dist([float(value) for value in at.split()], last[:2]) < 0.2


def test_the_example_of_a_node_feeds_the_localizer(
    flat_map: Map, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a ROS that hands over two scans of the map's own, as long as the node spins."""
    heard: list[Any] = []

    def spin(_: Any) -> None:
        with flat_map.scans() as scans:
            for number in (0, 1):
                scan = scans.scan(number)
                sec, nanosec = divmod(scan.stamp_ns, 10**9)
                message = SimpleNamespace(
                    header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec)),
                    ranges=scan.ranges.tolist(),
                    angle_min=float(scan.bearings[0]),
                    angle_increment=float(scan.bearings[1] - scan.bearings[0]),
                    range_min=0.0,
                    range_max=scan.range_max,
                    time_increment=0.0,
                )
                heard[0](message)

    def subscribe(_kind: Any, _topic: str, callback: Any, quality: str) -> None:
        assert quality == "best effort"  # as drivers of lasers send
        heard.append(callback)

    node = SimpleNamespace(create_subscription=subscribe)
    ros = SimpleNamespace(init=lambda: None, create_node=lambda _: node, spin=spin)
    monkeypatch.setitem(sys.modules, "rclpy", ros)
    service = SimpleNamespace(qos_profile_sensor_data="best effort")
    monkeypatch.setitem(sys.modules, "rclpy.qos", service)
    monkeypatch.setitem(sys.modules, "sensor_msgs", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "sensor_msgs.msg", SimpleNamespace(LaserScan=object))
    monkeypatch.setattr(sys, "argv", ["localizer_node.py", str(flat_map.path)])
    path = ROOT / "docs" / "examples" / "localizer_node.py"
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 2


@pytest.mark.parametrize(
    "call",
    [
        lambda: specmap_cli.build_map(3, "out"),  # type: ignore[arg-type]
        lambda: specmap_cli.build_map("log.mcap", 3),  # type: ignore[arg-type]
        lambda: specmap_cli.build_map("log.mcap", "out", {"seed": 1}),  # type: ignore[arg-type]
        lambda: specmap_cli.build_map([], "out", Config(), explain=3),  # type: ignore[arg-type]
        lambda: specmap_cli.localize_log("log.mcap", 3),  # type: ignore[arg-type]
        lambda: specmap_cli.localize_log("log.mcap", "out", 3),  # type: ignore[arg-type]
        lambda: specmap_cli.segment_map(3, "out"),  # type: ignore[arg-type]
        lambda: specmap_cli.segment_map("m.yaml", "out", "paper"),  # type: ignore[arg-type]
        lambda: update_map("map", "log.mcap", "out", {"seed": 1}),  # type: ignore[arg-type]
        lambda: merge_maps(["map", "b"], "out", {"seed": 1}),  # type: ignore[arg-type]
        lambda: compare_maps("map", "b", {"seed": 1}),  # type: ignore[arg-type]
        lambda: specmap_cli.read_map(None),  # type: ignore[arg-type]
        lambda: specmap_cli.Localizer(None),  # type: ignore[arg-type]
        lambda: specmap_cli.Localizer("map", {"seed": 1}),  # type: ignore[arg-type]
        lambda: specmap_cli.load_config(3),  # type: ignore[arg-type]
    ],
)
def test_wrong_types_are_refused_before_the_work(
    call: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert callable(call)
    with pytest.raises(TypeError, match=r"expected .*, found "):
        call()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"ranges": [1.0]}, "a scan of 1 ranges at 360 angles: expected as many of both"),
        ({"angles": list(range(360))}, "angles over 57 turns: expected radians"),
        ({"ranges": "ab"}, "a scan whose stamp, ranges or angles are not numbers: expected whole"),
        ({"stamp_ns": 1 << 63}, "a scan stamped 9223372036854775808 ns: expected nanoseconds"),
        ({"range_max": -1.0}, "a scan of a laser from 0 to -1 m: expected a range_min that is no"),
        ({"laser": (0.1, 0.0)}, "laser is (0.1, 0.0): expected x, y and theta"),
        ({"odometry": (0.0, 0.0, math.nan)}, "odometry is (0.0, 0.0, nan): expected x, y"),
    ],
)
def test_a_scan_that_cannot_be_is_refused(flat_map: Map, wrong: dict[str, Any], told: str) -> None:
    circle = {"ranges": [2.0] * 360, "angles": np.radians(np.arange(360)).tolist()}
    localizer = specmap_cli.Localizer(flat_map)
    with pytest.raises(specmap_cli.SpecmapError, match=f"^{re.escape(told)}"):
        localizer.add(specmap_cli.Scan(**{"stamp_ns": 1, **circle, **wrong}))
    localizer.add(specmap_cli.Scan(2, **circle))  # the next one is welcome
    with pytest.raises(specmap_cli.SpecmapError, match="stamped 1 ns before the one ahead of it"):
        localizer.add(specmap_cli.Scan(1, **circle))


@pytest.mark.parametrize("value", ["a/b", Path("a/b")])
def test_a_path_may_be_text(value: str | Path) -> None:
    assert path_of(value, "out") == Path("a/b")
    assert paths_of(value, "logs") == [Path("a/b")]
    assert paths_of([value, "c"], "logs") == [Path("a/b"), Path("c")]
    assert paths_of((), "logs") == []
    assert instance_of(value, type(value), "path") is value


@pytest.mark.parametrize("value", [None, 3, b"bytes", {"a": 1}, {"a"}, object(), [0] * 1000])
def test_what_is_no_path_is_named_and_cut_in_the_message(value: Any) -> None:
    with pytest.raises(TypeError, match=r"^out: expected a path \(str or Path\), found ") as told:
        path_of(value, "out")
    assert len(str(told.value)) < 120
    with pytest.raises(TypeError, match=r"^logs: expected a path"):
        paths_of(value, "logs")
    with pytest.raises(TypeError, match=r"^count: expected str, found "):
        instance_of(value, str, "count")

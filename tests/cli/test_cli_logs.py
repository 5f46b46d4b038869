"""Logs that cannot be used, or only in part: one line, the exit code, nothing left behind."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK, Run, leftovers, ran, standing_log

DATA = Path(os.environ.get("SPECMAP_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
DAMAGED_BAG = DATA / "damaged" / "laser_scan_matcher_demo.bag"  # its index is damaged
HAS_BAG = pytest.mark.skipif(not DAMAGED_BAG.is_file(), reason=f"no {DAMAGED_BAG} (SPECMAP_DATA)")

BAD = {
    "empty.mcap": (b"", "empty.mcap: the file is empty"),
    "text.mcap": (b"hello\n", "text.mcap: a text file, not a recording; expected MCAP"),
    "noise.bag": (bytes(range(256)) * 9, "noise.bag: of an unknown format, not a recording"),
    "head.mcap": (b"\x89MCAP0", "head.mcap: cut off after 6 bytes"),
}


@pytest.fixture(params=["info", "build", "localize", "convert"])
def line(request: pytest.FixtureRequest, tmp_path: Path, tiny_map: Path) -> tuple[str | Path, ...]:
    """The command and its options; the log follows."""
    return {
        "info": ("info",),
        "build": ("build", "-o", tmp_path / "out" / "map", *QUICK),
        "localize": ("localize", "--map", tiny_map, "-o", tmp_path / "labels.csv"),
        "convert": ("convert", "--overwrite"),
    }[request.param]


def after(line: tuple[str | Path, ...], log: Path) -> tuple[str | Path, ...]:
    """The arguments that come last."""
    return (log, log.parent / "converted.mcap") if line[0] == "convert" else (log,)


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_recording(
    name: str, line: tuple[str | Path, ...], tmp_path: Path, run: Run
) -> None:
    content, told = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    run(*line, *after(line, path)).fails(3, told)
    assert [each.name for each in tmp_path.iterdir()] == [name]


def test_a_missing_file_and_a_directory_without_logs(
    line: tuple[str | Path, ...], tmp_path: Path, run: Run
) -> None:
    for place, told in (
        (tmp_path / "none.mcap", "none.mcap: no such file or directory"),
        (tmp_path, "no recording in this directory"),
    ):
        run(*line, *after(line, place)).fails(3, told)
    assert list(tmp_path.iterdir()) == []


def test_a_file_given_twice(tiny_log: Path, run: Run) -> None:
    for again in (tiny_log, tiny_log.parent):
        told = "tiny.mcap: given twice; name each file of a recording once"
        run("info", tiny_log, again).fails(3, told)


@pytest.mark.parametrize("damaged", [False, pytest.param(True, marks=HAS_BAG)])
def test_a_log_cut_off_anywhere(damaged: bool, tiny_log: Path, tmp_path: Path, run: Run) -> None:
    log = DAMAGED_BAG if damaged else tiny_log
    whole, codes = log.read_bytes(), []
    for tenth in range(10):
        path = tmp_path / f"cut{tenth}{log.suffix}"
        path.write_bytes(whole[: len(whole) * tenth // 10 + (20 if damaged else 9)])
        said = run("info", path)
        codes.append(said.code)
        told = said.error if said.code else said.out
        assert f"{path.name}: " in told
        assert damaged or "cut off" in told or "no message is lost" in told
    assert set(codes) == {0, 3}
    assert codes == sorted(codes, reverse=True)  # the more there is, the more is read
    assert codes[2] == 0 or not damaged


def test_a_log_without_scans(tmp_path: Path, run: Run) -> None:
    path = standing_log(tmp_path / "noscan.mcap", 3.0, topics=())
    told = "noscan.mcap: no LaserScan, MultiEchoLaserScan or PointCloud2 in it"
    said = run("build", path, "-o", tmp_path / "map")
    said.fails(3, told, "/odom (nav_msgs/msg/Odometry)")
    assert not (tmp_path / "map").exists()


def test_two_scan_topics_are_listed_ready_to_paste(tmp_path: Path, run: Run) -> None:
    path = standing_log(tmp_path / "two.mcap", 3.0, topics=("/front", "/rear"))
    topics = (f"`--scan-topic /{name}` (LaserScan, 5 messages)" for name in ("front", "rear"))
    run("build", path, "-o", tmp_path / "map", *QUICK).fails(2, *topics)
    said = run("build", path, "-o", tmp_path / "map", "--scan-topic", "/rear", *QUICK)
    assert said.code == 0
    assert "scans from /rear" in said.err


@pytest.mark.parametrize(
    ("option", "told"),
    [
        (("--scan-topic", "/nope"), "--scan-topic /nope: no scans on such a topic; topics with"),
        (("--scan-topic", "/odom"), "/scan (LaserScan, 5 messages)"),
        (("--scan-frame", "nope"), "--scan-frame nope: no scans of such a sensor; there are"),
        (("--odom-topic", "/nope"), "--odom-topic /nope: no odometry on such a topic"),
        (("--base-frame", "nope"), "--base-frame nope: no transform joins it"),
    ],
)
def test_an_unknown_topic_or_frame(
    option: tuple[str, str], told: str, tmp_path: Path, run: Run
) -> None:
    path = standing_log(tmp_path / "one.mcap", 3.0)
    run("build", path, "-o", tmp_path / "map", *option).fails(2, told)


@pytest.mark.parametrize("distance", [math.nan, math.inf, 0.0])
def test_scans_that_see_nothing_make_no_map(distance: float, tmp_path: Path, run: Run) -> None:
    path = standing_log(tmp_path / "blind.mcap", distance)
    told = "blind.mcap: none of 5 scans could be registered (scans without any return: 5"
    run("build", path, "-o", tmp_path / "map").fails(4, told)
    assert not (tmp_path / "map").exists()
    assert leftovers(tmp_path) == []


def test_a_blind_robot_is_somewhere_all_the_same(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    said = run("localize", standing_log(tmp_path / "blind.mcap", math.nan), "--map", tiny_map)
    assert said.code == 0
    assert said.out.startswith("blind.mcap: 5 scans")
    assert "warning: scans without any return: 5" in said.err


def test_a_single_scan_is_a_map(tmp_path: Path, run: Run) -> None:
    path = standing_log(tmp_path / "one.mcap", 3.0, scans=1)
    said = run("build", path, "-o", tmp_path / "map", *QUICK)
    assert said.code == 0
    assert ": 1 submap, 0 edges, 0 revisits recognised; 1 scan over 0 m, 0 lost" in said.out


def test_a_name_of_any_bytes(tmp_path: Path, run: Run) -> None:
    path = standing_log(tmp_path / os.fsdecode(b"\xff\xe9.mcap"), 3.0)
    plot = tmp_path / "plot.png"
    assert run("build", path, "-o", tmp_path / "map", *QUICK).code == 0
    assert run("localize", path, "--map", tmp_path / "map", "--plot", plot).code == 0
    assert plot.is_file()


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_name_that_the_terminal_cannot_show(encoding: str, tmp_path: Path) -> None:
    path = standing_log(tmp_path / os.fsdecode(b"\xff-\xc3\xa9.mcap"), 3.0)
    said = ran("info", path, env={"PYTHONIOENCODING": encoding})
    assert said.code == 0
    assert said.out.startswith(f"{tmp_path}/\\udcff-")
    assert said.err == ""


@HAS_BAG
def test_what_is_readable_is_read_and_the_damage_told(tmp_path: Path, run: Run) -> None:
    said = run("convert", DAMAGED_BAG, tmp_path / "saved.mcap")
    assert said.code == 0
    assert "damage: " in said.out
    assert "laser_scan_matcher_demo.bag: the record at byte" in said.out
    said = run("info", tmp_path / "saved.mcap")
    assert "scan: 681 beams over 239.06 degrees" in said.out

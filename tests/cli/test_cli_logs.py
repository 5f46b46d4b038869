"""Logs that cannot be used, or only in part: one line, the exit code, nothing left behind."""

import math
import os
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import QUICK, Run, ran, standing_log

DATA = Path(os.environ.get("SPECMAP_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
DAMAGED_BAG = DATA / "damaged" / "laser_scan_matcher_demo.bag"  # its index is damaged
HAS_BAG = pytest.mark.skipif(not DAMAGED_BAG.is_file(), reason=f"no {DAMAGED_BAG} (SPECMAP_DATA)")

BAD: dict[str, tuple[bytes | None, str]] = {
    "empty.mcap": (b"", "empty.mcap: the file is empty"),
    "text.mcap": (b"hello\n", "text.mcap: a text file, not a recording; expected MCAP"),
    "noise.bag": (bytes(range(256)) * 9, "noise.bag: of an unknown format, not a recording"),
    "head.mcap": (b"\x89MCAP0", "head.mcap: cut off after 6 bytes"),
    "none.mcap": (None, "none.mcap: no such file or directory"),
    ".": (None, "no recording in this directory"),
}


@pytest.fixture(params=["info", "build", "localize", "convert"])
def line(request: pytest.FixtureRequest, tmp_path: Path, tiny_map: Path) -> tuple[str | Path, ...]:
    """The command and its options; the log follows."""
    return {
        "info": ("info",),
        "build": ("build", "-o", tmp_path / "out" / "map", *QUICK),
        "localize": ("localize", "--map", tiny_map, "-o", tmp_path / "labels.csv"),
        "convert": ("convert", "-o", tmp_path / "converted.mcap"),
    }[request.param]


@pytest.mark.parametrize("name", BAD)
def test_no_recording(name: str, line: tuple[str | Path, ...], tmp_path: Path, run: Run) -> None:
    content, told = BAD[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    run(*line, tmp_path / name).fails(3, told)
    assert [each.name for each in tmp_path.iterdir()] == ([] if content is None else [name])


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


TWO: dict[str, Any] = {"topics": ("/front", "/rear")}
NO_SCANS = "log.mcap: no LaserScan, MultiEchoLaserScan or PointCloud2 in it"
BLIND = "log.mcap: none of 5 scans could be registered (scans without any return: 5"


@pytest.mark.parametrize(
    ("log", "option", "code", "told"),
    [
        ({"topics": ()}, (), 3, NO_SCANS),
        ({"topics": ()}, (), 3, "/odom (nav_msgs/msg/Odometry)"),
        (TWO, (), 2, "`--scan-topic /front` (LaserScan, 5 messages)"),
        (TWO, (), 2, "`--scan-topic /rear` (LaserScan, 5 messages)"),
        ({}, ("--scan-topic", "/nope"), 2, "--scan-topic /nope: no scans on such a topic; topics"),
        ({}, ("--scan-topic", "/odom"), 2, "/scan (LaserScan, 5 messages)"),
        ({}, ("--scan-frame", "nope"), 2, "--scan-frame nope: no scans of such a sensor; there"),
        ({}, ("--odom-topic", "/nope"), 2, "--odom-topic /nope: no odometry on such a topic"),
        ({}, ("--base-frame", "nope"), 2, "--base-frame nope: no transform joins it"),
        *(({"distance": distance}, (), 4, BLIND) for distance in (math.nan, math.inf, 0.0)),
    ],
)
def test_what_makes_no_map(
    log: dict[str, Any], option: tuple[str, ...], code: int, told: str, tmp_path: Path, run: Run
) -> None:
    path = standing_log(tmp_path / "log.mcap", **{"distance": 3.0, **log})
    run("build", path, "-o", tmp_path / "map", *option).fails(code, told)
    assert [each.name for each in tmp_path.iterdir()] == ["log.mcap"]


def test_two_recordings_given_as_one_are_warned_of_first_and_once(tmp_path: Path, run: Run) -> None:
    paths = [standing_log(tmp_path / name, 3.0, scans=32) for name in ("a.mcap", "b.mcap")]
    said = run("build", *paths, "-o", tmp_path / "map", *QUICK)
    first, *others = [line for line in said.err.splitlines() if "warning: " in line]
    assert " both hold /scan for the same 6 s: if they are not parts of one recording" in first
    assert others
    assert first not in others


def test_a_blind_robot_is_somewhere_all_the_same(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    said = run("localize", standing_log(tmp_path / "blind.mcap", math.nan), "--map", tiny_map)
    assert said.code == 0
    assert said.out.startswith("blind.mcap: 5 scans")
    assert "warning: scans without any return: 5" in said.err


def test_a_single_scan_of_one_of_two_lasers_is_a_map(tmp_path: Path, run: Run) -> None:
    path = standing_log(tmp_path / "one.mcap", 3.0, scans=1, **TWO)
    said = run("build", path, "-o", tmp_path / "map", "--scan-topic", "/rear", *QUICK)
    assert said.code == 0
    assert "scans from /rear" in said.err
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

"""Several lasers on one topic: found, chosen or asked for, and those left out counted."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.sensors import SeveralSensorsError
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import SECOND, START, sweeps_of

Laser = tuple[Any, ...]  # frame, bearings of the first and the last beam, beams if not 11


def write(path: Path, lasers: list[Laser]) -> None:
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
    write(path, lasers)
    with pytest.raises(UsageError) as caught:
        sweeps_of(path, **options)
    assert str(caught.value) == f"{path}: /scan: {said}"


@pytest.mark.parametrize(("name", "x"), [("front", 0.2), ("/rear", -0.2)])
def test_only_the_sweeps_of_the_chosen_sensor_are_read(path: Path, name: str, x: float) -> None:
    write(path, [FRONT, REAR] * 15 + [FRONT])
    sweeps, stream = sweeps_of(path, scan_frame=name)
    count = 16 if x > 0 else 15
    assert [sweep.index for sweep in sweeps] == list(range(count))
    assert {sweep.base_from_laser.x for sweep in sweeps} == {x}
    assert len({sweep.stamp_ns // (SECOND // 10) % 2 for sweep in sweeps}) == 1
    assert stream.warnings == [
        f"scans of another sensor on the topic that were left out: {31 - count}"
    ]
    assert stream.selection.note.startswith(
        f"scans from /scan (LaserScan, 31) of sensor {name.lstrip('/')}, "
    )


def test_a_sensor_that_shows_up_late_is_left_out_and_said(path: Path) -> None:
    write(path, [FRONT] * 12 + [REAR] * 4)
    sweeps, stream = sweeps_of(path, look_scans=10)
    assert len(sweeps) == stream.counts["scans"] == 12
    assert stream.counts["other_sensor"] == 4
    assert "scans of another sensor on the topic that were left out: 4" in stream.warnings


def test_a_rare_sensor_is_left_out_without_a_question(path: Path) -> None:
    """As a scan whose frame was damaged; a tenth of the scans is no accident."""
    write(path, [REAR] * 3 + [FRONT] * 27)
    with pytest.raises(SeveralSensorsError) as caught:
        sweeps_of(path)
    assert caught.value.best == "front"
    sent = pickle.loads(pickle.dumps(caught.value))  # from a process that runs ahead
    assert (sent.best, str(sent)) == ("front", str(caught.value))
    assert caught.value.within("jobs.toml").hint == caught.value.hint
    write(path, [REAR] * 2 + [FRONT] * 28)
    sweeps, stream = sweeps_of(path)
    assert stream.selection.sensor.frame == "front"
    assert (len(sweeps), stream.counts["other_sensor"]) == (28, 2)


def test_a_field_of_view_may_be_chosen(path: Path) -> None:
    write(path, [WIDE, NARROW] * 10)
    sweeps, stream = sweeps_of(path, scan_frame="laser#2")
    assert len(sweeps) == stream.counts["other_sensor"] == 10
    assert {float(sweep.planar.bearings[0]) for sweep in sweeps} == {-0.5}


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
    write(path, lasers)
    sweeps, stream = sweeps_of(path)
    assert len(sweeps) == 20
    assert [sensor.name for sensor in stream.selection.sensors] == ["laser"]


def test_clouds_of_two_frames_are_two_sensors(path: Path) -> None:
    with LogWriter(path) as log:
        for number in range(6):
            stamp = START + number * SECOND // 10
            log.cloud("/points", f"lidar_{number % 2}", stamp, np.eye(3))
    with pytest.raises(UsageError, match=r"`--scan-frame lidar_0` .* or `--scan-frame lidar_1`"):
        sweeps_of(path)
    assert len(sweeps_of(path, scan_frame="lidar_1")[0]) == 3


def test_info_lists_the_sensors_and_the_command_that_chooses(path: Path) -> None:
    write(path, [FRONT, FRONT, REAR] * 10)
    with open_log(path) as log:
        summary = summarize(log)
        chosen = summarize(log, LogConfig(scan_frame="rear"))
    assert summary.problem is not None
    assert "2 sensors on one topic" in summary.problem
    assert summary.next_command == f"specmap build {path} --scan-frame front"
    assert chosen.next_command == f"specmap build {path} --scan-frame rear"
    assert "  several sensors on the topic: front (20 scans), rear (10 scans)" in chosen.lines()

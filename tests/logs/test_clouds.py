"""Times of points as the usual drivers write them: names, units, clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.clouds import CloudPoints, PointClock, cloud_points
from specmap_cli.logs.messages import CloudRecord
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter

STAMP = 1_700_000_000_250_000_000
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
SWEEP_S = np.linspace(0.0, 0.1, 400)


def cloud(name: str, kind: str, values: NDArray[np.float64]) -> CloudRecord:
    table = np.ones((1, len(values)), dtype=[*XYZ, ("intensity", "<f4"), (name, kind)])
    table[name] = values
    return CloudRecord(STAMP, "lidar", table)


def points_of(record: CloudRecord, clock: PointClock | None = None) -> CloudPoints:
    return cloud_points(record, STAMP, clock)


@pytest.mark.parametrize(
    ("name", "kind", "values", "precision"),
    [
        pytest.param("time", "<f4", SWEEP_S, 1e-7, id="Velodyne"),
        pytest.param("time", "<f4", SWEEP_S - 0.1, 1e-7, id="Velodyne, before the stamp"),
        pytest.param("t", "<u4", SWEEP_S * 1e9, 1e-8, id="Ouster"),
        pytest.param("timestamp", "<f8", SWEEP_S + STAMP / 1e9, 1e-6, id="Hesai, RoboSense"),
        pytest.param("timestamp", "<f8", SWEEP_S * 1e9 + STAMP, 1e-6, id="Livox, driver 2"),
        pytest.param("offset_time", "<u4", SWEEP_S * 1e9, 1e-8, id="Livox, driver 1"),
        pytest.param("time_stamp", "<u4", SWEEP_S * 1e9, 1e-8, id="Autoware"),
        pytest.param("time_stamp", "<f8", SWEEP_S + STAMP / 1e9, 1e-6, id="Autoware, older"),
        pytest.param("time_offset_ns", "<i4", SWEEP_S * 1e9 - 5e7, 1e-8, id="Aeva"),
        pytest.param("t", "<u4", SWEEP_S * 1e6, 2e-6, id="microseconds"),
        pytest.param("timestamp", "<u8", SWEEP_S * 1e6 + STAMP // 1000, 2e-6, id="absolute us"),
        pytest.param("timestamp", "<f8", SWEEP_S * 1e6 + STAMP / 1e3, 2e-6, id="absolute us float"),
        pytest.param("time", "<f4", SWEEP_S * 1e3, 1e-6, id="milliseconds"),
        pytest.param("time", ">f4", SWEEP_S * 1e6, 1e-6, id="microseconds, big endian"),
        pytest.param("Timestamp", "<f8", SWEEP_S + STAMP / 1e9, 1e-6, id="capital"),
    ],
)
def test_the_times_of_the_usual_drivers(
    name: str, kind: str, values: NDArray[np.float64], precision: float
) -> None:
    found = points_of(cloud(name, kind, values))
    assert found.times_s is not None
    assert not found.far_times
    begin = -0.1 if values[0] == -0.1 else -0.05 if name == "time_offset_ns" else 0.0
    np.testing.assert_allclose(found.times_s, SWEEP_S + begin, atol=precision)


@pytest.mark.parametrize("period_s", [0.01, 0.05, 1.0])
@pytest.mark.parametrize("unit_ns", [1_000_000_000, 1_000_000, 1_000, 1])
def test_every_unit_is_told_by_the_span(period_s: float, unit_ns: int) -> None:
    sweep = np.linspace(0.0, period_s, 400)
    found = points_of(cloud("time", "<f8", sweep * 1e9 / unit_ns))
    np.testing.assert_allclose(found.times_s, sweep, atol=1e-8)  # type: ignore[arg-type]


@pytest.mark.parametrize("since_s", [1234.5, STAMP / 1e9 - 3600.0])
def test_times_of_another_clock_count_from_the_earliest(since_s: float) -> None:
    """Such as seconds since the lidar was switched on, under stamps of the computer."""
    clock = PointClock()
    found = points_of(cloud("timestamp", "<f8", SWEEP_S[::-1] + since_s), clock)
    assert clock.foreign == 1
    np.testing.assert_allclose(found.times_s, SWEEP_S[::-1], atol=1e-6)  # type: ignore[arg-type]
    points_of(cloud("timestamp", "<f8", SWEEP_S + STAMP / 1e9), clock)
    assert clock.foreign == 1


def test_the_first_full_sweep_settles_the_unit() -> None:
    """A sliver of a later sweep spans too little to tell."""
    clock = PointClock()
    points_of(cloud("t", "<u4", SWEEP_S * 1e9), clock)
    sliver = points_of(cloud("t", "<u4", np.linspace(0.0, 1e6, 400)), clock)
    assert sliver.times_s is not None
    assert sliver.times_s.max() == pytest.approx(0.001)
    few = PointClock()
    points_of(cloud("t", "<u4", np.array([0.0, 1e6])), few)
    whole = points_of(cloud("t", "<u4", SWEEP_S * 1e9), few)
    assert whole.times_s is not None
    assert whole.times_s.max() == pytest.approx(0.1)


def test_a_foreign_clock_is_said_once(path: Path) -> None:
    rng = np.random.default_rng(1)
    with LogWriter(path) as log:
        for number in range(3):
            points, stamp = rng.uniform(1.0, 5.0, (400, 3)), STAMP + number * 100_000_000
            log.cloud("/points", "lidar", stamp, points, times_s=SWEEP_S + 500.0)
    with open_log(path) as opened:
        stream = SweepStream(opened, LogConfig())
        assert all(sweep.cloud_times_s is not None for sweep in stream)
        assert (
            "scans whose point times have another clock than their stamps and were counted from "
            "the earliest point: 3"
        ) in stream.warnings

"""The laser of the classifiers, and which others see the same."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.learning.classifiers import Sensor

CIRCLE = Sensor(beams=360, field_of_view=2.0 * math.pi, range_max=20.0, full_circle=True)
HALF = Sensor(beams=181, field_of_view=math.pi, range_max=20.0, full_circle=False)

sensors = st.builds(
    Sensor,
    beams=st.integers(1, 2000),
    field_of_view=st.floats(0.0, 2.0 * math.pi),
    range_max=st.floats(0.5, 100.0),
    full_circle=st.booleans(),
)


def scan(bearings: Any, full: bool = False) -> PlanarScan:
    return PlanarScan(0, np.asarray(bearings), np.ones(len(bearings)), 20.0, full_circle=full)


def test_the_sensor_of_a_scan_and_its_words() -> None:
    assert Sensor.of(scan(np.linspace(-np.pi / 2, np.pi / 2, 181))) == HALF
    circle = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    assert Sensor.of(scan(circle, full=True)) == CIRCLE
    assert str(HALF) == "181 beams over 180 degrees, 20 m"
    assert str(replace(CIRCLE, range_max=7.5)) == "360 beams over 360 degrees, 7.5 m"


@pytest.mark.parametrize("bearings", [[], [0.3]])
def test_a_scan_of_hardly_a_beam_has_no_field_of_view(bearings: list[float]) -> None:
    sensor = Sensor.of(scan(bearings))
    assert (sensor.beams, sensor.field_of_view) == (len(bearings), 0.0)
    assert sensor.sees_as(sensor)


@given(sensors)
def test_bearings_are_even_and_symmetric_and_a_laser_sees_as_itself(sensor: Sensor) -> None:
    assert sensor.sees_as(sensor)
    bearings = sensor.bearings()
    assert len(bearings) == sensor.beams
    if sensor.beams > 1:
        assert np.diff(bearings, n=2) == pytest.approx(0.0, abs=1e-9)
        step = sensor.field_of_view / (sensor.beams - (0 if sensor.full_circle else 1))
        assert bearings[1] - bearings[0] == pytest.approx(step, abs=1e-9)
        ends = bearings[0] + bearings[-1] + (step if sensor.full_circle else 0.0)
        assert ends == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"beams": 380}, True),
        ({"beams": 400}, False),
        ({"beams": 180}, False),
        ({"range_max": 24.0}, True),
        ({"range_max": 26.0}, False),
        ({"field_of_view": 2.0 * math.pi - math.radians(2.5)}, True),
        ({"field_of_view": 2.0 * math.pi - math.radians(3.5)}, False),
        ({"full_circle": False}, False),
    ],
)
def test_small_differences_are_none(change: dict[str, Any], same: bool) -> None:
    assert CIRCLE.sees_as(replace(CIRCLE, **change)) is same

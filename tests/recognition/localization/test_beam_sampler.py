"""Scans of one laser as another one would have taken them, and lasers that cannot stand in."""

from __future__ import annotations

import math
import re
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.learning.classifiers import Sensor
from specmap_cli.recognition.localization.classification import BeamSampler

HALF = Sensor(beams=181, field_of_view=math.pi, range_max=20.0, full_circle=False)


def circle(ranges: FloatArray, range_max: float = 30.0) -> PlanarScan:
    bearings = np.linspace(-np.pi, np.pi, len(ranges), endpoint=False)
    return PlanarScan(4, bearings, np.asarray(ranges), range_max, full_circle=True)


def test_the_same_laser_is_left_alone_and_another_one_is_said() -> None:
    scan = circle(np.ones(360))
    sampler = BeamSampler(Sensor.of(scan), Sensor.of(scan))
    assert sampler.note == ""
    assert sampler.apply(scan) is scan
    sampler = BeamSampler(Sensor.of(circle(np.ones(720))), HALF)
    assert sampler.note == (
        "the log's laser (720 beams over 360 degrees, 30 m) is resampled to the map's "
        "(181 beams over 180 degrees, 20 m)"
    )
    empty = PlanarScan(0, np.zeros(0), np.zeros(0), 30.0, full_circle=True)
    assert sampler.apply(empty) is empty


@given(
    st.integers(0, 999),
    st.integers(190, 400),
    st.integers(2, 90),
    st.sampled_from([-math.pi, 0.0, -2.0 * math.pi, -3.0, 1.0]),
)
def test_every_reading_is_that_of_the_nearest_bearing_around_the_circle(
    seed: int, beams: int, wanted: int, first: float
) -> None:
    """Wherever the bearings begin: many lasers count theirs from 0 to 360 degrees.

    What is as far as the known laser does not reach is no return there, and what is invalid stays.
    """
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.5, 25.0, beams)
    ranges[rng.random(beams) < 0.2] = rng.choice([np.nan, np.inf])
    bearings = first + 2.0 * math.pi / beams * np.arange(beams, dtype=np.float64)
    scan = PlanarScan(4, bearings, ranges, 30.0, full_circle=True)
    known = Sensor(beams=wanted, field_of_view=math.pi, range_max=20.0, full_circle=False)
    made = BeamSampler(Sensor.of(scan), known).apply(scan)
    assert (made.stamp_ns, made.range_max, made.full_circle) == (4, 20.0, False)
    np.testing.assert_array_equal(made.bearings, known.bearings())
    gaps = np.abs(np.angle(np.exp(1j * (made.bearings[:, None] - bearings))))
    nearest = gaps <= gaps.min(axis=1, keepdims=True) + 1e-9  # two where it lies between them
    left = np.where(ranges >= 20.0, np.inf, ranges)
    for reading, near in zip(made.ranges, nearest, strict=True):
        assert any(np.array_equal(reading, one, equal_nan=True) for one in left[near])


@pytest.mark.parametrize(
    ("seen", "refused"),
    [
        (HALF, False),
        (replace(HALF, field_of_view=math.radians(176.0)), False),
        (replace(HALF, field_of_view=math.radians(174.0)), True),
        (replace(HALF, field_of_view=math.radians(270.0)), False),
        (replace(HALF, range_max=10.0), False),
        (replace(HALF, range_max=9.9), True),
        (replace(HALF, beams=40), False),
    ],
)
def test_a_laser_that_sees_less_is_refused_in_one_line(seen: Sensor, refused: bool) -> None:
    told = (
        f"the log's laser ({seen}) sees less than the laser of the map ({HALF}); "
        "build the map again with this laser"
    )
    with pytest.raises(InputError, match=re.escape(told)) if refused else nullcontext():
        BeamSampler(seen, HALF)

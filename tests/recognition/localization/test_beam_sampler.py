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


def sampled(scan: PlanarScan, known: Sensor) -> PlanarScan:
    return BeamSampler(Sensor.of(scan), known).apply(scan)


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


def test_resampling_takes_the_nearest_beam_and_cuts_to_the_range() -> None:
    known = Sensor(beams=5, field_of_view=math.pi, range_max=10.0, full_circle=False)
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    scan = sampled(circle(9.0 + bearings), known)
    assert scan.bearings == pytest.approx(np.linspace(-math.pi / 2, math.pi / 2, 5))
    assert scan.ranges[:3] == pytest.approx(9.0 + scan.bearings[:3], abs=0.01)
    assert (scan.ranges[4:] == np.inf).all()
    nothing = np.where(np.arange(360) % 2, np.nan, np.inf)
    made = sampled(circle(nothing), HALF).ranges
    assert np.isnan(made).any()
    assert (np.isnan(made) | (made == np.inf)).all()
    assert (scan.stamp_ns, scan.range_max, scan.full_circle) == (4, 10.0, False)


@given(
    st.integers(0, 999),
    st.integers(190, 400),
    st.integers(2, 90),
    st.sampled_from([-math.pi, 0.0, -2.0 * math.pi, -3.0, 1.0]),
)
def test_every_reading_is_that_of_the_nearest_bearing_around_the_circle(
    seed: int, beams: int, wanted: int, first: float
) -> None:
    """Wherever the bearings begin: many lasers count theirs from 0 to 360 degrees."""
    ranges = np.random.default_rng(seed).uniform(0.5, 19.0, beams)
    bearings = first + 2.0 * math.pi / beams * np.arange(beams, dtype=np.float64)
    scan = PlanarScan(0, bearings, ranges, 30.0, full_circle=True)
    known = Sensor(beams=wanted, field_of_view=2 * math.pi, range_max=20.0, full_circle=True)
    made = sampled(scan, known)
    gaps = np.abs(np.angle(np.exp(1j * (made.bearings[:, None] - bearings))))
    nearest = gaps <= gaps.min(axis=1, keepdims=True) + 1e-9  # two where it lies between them
    assert all(reading in ranges[near] for reading, near in zip(made.ranges, nearest, strict=True))


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

"""Scans on evenly spaced beams, as a LaserScan carries them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.logs.planar import covers_circle
from specmap_cli.maps.even_bearings import EvenBeams, EvenSpacing
from specmap_cli.registration.sweep_view import deskewed

CIRCLE = 2 * math.pi


def scan(bearings: FloatArray, ranges: FloatArray, *, full_circle: bool = False) -> PlanarScan:
    return PlanarScan(0, bearings, ranges, 30.0, full_circle)


def floats(values: ArrayLike) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def bearings_of(beams: EvenBeams) -> FloatArray:
    return floats(beams.angle_min + beams.increment * np.arange(len(beams.ranges)))


def test_a_lasers_own_scan_stays_as_it_is() -> None:
    bearings, ranges = floats(np.linspace(-1.5, 1.5, 301)), np.arange(301.0)
    beams = EvenSpacing().beams(scan(bearings, ranges))
    assert beams.ranges is ranges
    assert bearings_of(beams) == pytest.approx(bearings, abs=1e-6)


def turned(full_circle: bool) -> tuple[PlanarScan, PlanarScan]:
    """A scan at rest, and one in motion with its beams de-skewed."""
    span = CIRCLE if full_circle else 4.0
    bearings = np.linspace(-span / 2, span / 2, 360, endpoint=not full_circle)
    rest = PlanarScan(
        0, bearings, 3.0 + np.cos(bearings), 30.0, full_circle, np.linspace(0.0, 0.1, 360)
    )
    moving = deskewed(rest, Pose2(0.2, 0.0, 0.0), Pose2(0.1, 0.0, 0.3), 0.1)
    return rest, moving


@pytest.mark.parametrize("full_circle", [True, False])
def test_what_was_measured_in_motion_keeps_the_bearings_of_the_laser(full_circle: bool) -> None:
    rest, moving = turned(full_circle)
    spacing = EvenSpacing()
    spacing.beams(rest)
    beams = spacing.beams(moving)
    assert (beams.angle_min, len(beams.ranges)) == (float(np.float32(rest.bearings[0])), 360)
    half = beams.increment / 2 * 1.2  # motion spreads the beams by a tenth
    seen = np.isfinite(beams.ranges)
    assert seen.mean() > (0.99 if full_circle else 0.9), "the view of a sector has turned away"
    for bearing, found in zip(bearings_of(beams)[seen], beams.ranges[seen], strict=True):
        away = np.abs((moving.bearings - bearing + math.pi) % CIRCLE - math.pi)
        assert found in moving.ranges[away <= half], "the reading of a neighbour"


def test_the_first_scan_may_be_one_in_motion() -> None:
    _, moving = turned(full_circle=True)
    beams = EvenSpacing().beams(moving)
    assert covers_circle(len(beams.ranges), beams.increment)
    assert np.isfinite(beams.ranges).all()


def test_no_reading_is_made_up_where_there_is_none() -> None:
    hole = floats([*np.linspace(-1.0, -0.5, 50), *np.linspace(0.5, 1.0, 50)])
    beams = EvenSpacing().beams(scan(hole, np.ones(100)))
    assert np.isnan(beams.ranges[np.abs(bearings_of(beams)) < 0.45]).all()
    assert np.isnan(beams.ranges).mean() == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("blind", [(150, 250), (0, 60), (340, 400), (380, 20), (7, 8), (7, 7)])
def test_a_circle_not_looked_at_all_around_goes_without_its_blind_part(
    blind: tuple[int, int],
) -> None:
    bearings = floats(-math.pi + (np.arange(400) + 0.5) * (CIRCLE / 400))
    ranges, (start, end) = np.arange(400.0), blind
    run = np.arange(start, end if end >= start else end + 400) % 400
    ranges[run] = np.nan
    beams = EvenSpacing().beams(scan(bearings, ranges))
    assert not covers_circle(len(beams.ranges), beams.increment)
    assert len(beams.ranges) == 400 - max(len(run), 2)
    places = np.round((bearings_of(beams) + math.pi) / (CIRCLE / 400) - 0.5).astype(int) % 400
    assert (beams.ranges == places).all(), "each reading at its bearing"


def test_a_single_beam_and_a_circle_that_saw_nothing() -> None:
    beams = EvenSpacing().beams(scan(np.array([0.3]), np.array([2.0])))
    assert (beams.angle_min, beams.increment) == (float(np.float32(0.3)), 0.0)
    assert beams.ranges.tolist() == [2.0]
    bearings = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    blind = EvenSpacing().beams(scan(bearings, np.full(90, np.nan))).ranges
    assert len(blind) == 1
    assert np.isnan(blind).all()

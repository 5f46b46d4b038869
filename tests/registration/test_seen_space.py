"""Where the local map has looked: inside of the outlines of its scans, and nowhere else."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.registration.local_map import SeenSpace
from specmap_cli.registration.sweep_view import outline_of
from tests.registration.drives import circle
from tests.strategies import seeds

CELL_M = 0.2


@given(seeds)
def test_space_inside_of_an_outline_was_seen_and_space_outside_was_not(seed: int) -> None:
    """Against the signed distance of each point from each outline."""
    rng = np.random.default_rng(seed)
    scans = [circle(0, rng.uniform(1.0, 5.0, 24)).planar for _ in range(3)]
    places = [Pose2(*rng.uniform(-2, 2, 3)) for _ in scans]
    outlines = [
        place.apply(outline_of(scan, IDENTITY, 20.0))
        for scan, place in zip(scans, places, strict=True)
    ]
    seen = SeenSpace.of(outlines, CELL_M, 20.0)
    points = rng.uniform(-8, 8, (200, 2))
    depths = np.array(
        [
            max(
                cv2.pointPolygonTest(outline[1:].astype(np.float32), (float(x), float(y)), True)
                for outline in outlines
            )
            for x, y in points
        ]
    )
    found = seen.holds(points)
    assert found[depths > 0.0].all()
    assert not found[depths < -3 * CELL_M].any()


def test_a_beam_without_return_and_the_back_of_the_laser_are_not_seen() -> None:
    bearings = np.linspace(-np.pi / 2, np.pi / 2, 181)
    ranges = np.where(bearings < 0.0, 3.0, np.inf)
    scan = PlanarScan(0, bearings, ranges, 10.0, full_circle=False)
    seen = SeenSpace.of([outline_of(scan, IDENTITY, 10.0)], CELL_M, 10.0)
    points = np.array([[1.0, -1.0], [1.0, 1.5], [-1.0, -1.0], [2.5, -3.0]])
    assert seen.holds(points).tolist() == [True, False, False, False]


def test_no_farther_than_walls_are_registered() -> None:
    scan = circle(0, np.full(90, 9.0)).planar
    seen = SeenSpace.of([outline_of(scan, Pose2(1.0, 0.0, 0.3), 4.0)], CELL_M, 20.0)
    assert seen.holds(np.array([[4.5, 0.0], [-2.5, 0.0], [6.0, 0.0]])).tolist() == [
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("beams", [4, 359, 720, 5000])
def test_outlines_of_many_beams_are_thinned(beams: int) -> None:
    outline = outline_of(circle(0, np.full(beams, 2.0)).planar, IDENTITY, 10.0)
    assert len(outline) <= 362
    assert np.allclose(outline[0], 0.0)
    assert np.allclose(np.hypot(*outline[1:].T), 2.0)
    assert np.allclose(outline[1], outline[-1])


def test_points_off_the_grid_were_not_seen() -> None:
    scan = dataclasses.replace(circle(0, np.full(90, 9.0)).planar, full_circle=True)
    seen = SeenSpace.of([outline_of(scan, IDENTITY, 20.0)], CELL_M, 5.0)
    points = np.array([[4.9, 4.9], [5.5, 0.0], [-1e6, 0.0], [0.0, 1e9]])
    assert seen.holds(points).tolist() == [True, False, False, False]

"""How well held-out keyframes fit what the others of their submap saw."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.learning.misfit import HeldOutMisfit, held_out_misfit, near_returns
from tests.recognition.posed import stored


def misfit_of(building: Any, poses: FloatArray, noise_m: float = 0.0) -> HeldOutMisfit:
    """What the scans from some poses of one submap say, with noise in their ranges."""
    rng = np.random.default_rng(3)
    noisy = [
        replace(scan, ranges=scan.ranges + rng.normal(0.0, noise_m, len(scan.ranges)))
        for scan in building.scans(poses)
    ]
    with stored(noisy, poses) as store:
        return held_out_misfit(store, {5: range(len(poses))}, store.poses)


def test_views_of_one_room_fit_the_rest_and_noise_shows(building: Any) -> None:
    poses = building.path(0, 2)
    clear, noisy = misfit_of(building, poses), misfit_of(building, poses, 0.15)
    assert clear.views == noisy.views == 40
    assert clear.typical < 0.05
    assert noisy.typical > clear.typical + 0.02


def test_what_was_seen_just_before_and_after_is_held_out_too(building: Any) -> None:
    """A robot that never moved a metre has nothing left to compare with."""
    poses = np.zeros((12, 3)) + building.path(0, 2)[:1]
    poses[:, 0] += 0.05 * np.arange(12)
    assert misfit_of(building, poses) == HeldOutMisfit(0.0, 0)


def test_views_of_places_seen_once_are_not_held_out(building: Any) -> None:
    """Two keyframes metres apart: neither is a place that the other knows."""
    assert misfit_of(building, building.path(0, 2)[[0, 20]]).views == 0


def test_near_returns_are_those_in_reach_or_the_nearer_half() -> None:
    bearings = np.linspace(-1.0, 1.0, 41)
    scan = PlanarScan(0, bearings, np.linspace(1.0, 21.0, 41), 30.0, full_circle=False)
    for reach, farthest in ((15.0, 15.0), (3.0, 11.0)):
        ranges = np.hypot(*near_returns(scan, reach).T)
        assert ranges.max() == pytest.approx(farthest)
    assert len(near_returns(PlanarScan(0, bearings, np.full(41, np.inf), 30.0, False), 8.0)) == 0

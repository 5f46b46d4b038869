"""How well held-out keyframes fit what the others of their submap saw."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.misfit import HeldOutMisfit, held_out_misfit
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

"""Where two tracks are tied: at the poses that saw most alike."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import wrap_angles
from specmap_cli.layout.passes import METRES_A_RADIAN
from specmap_cli.pipelines.laying_out import nearest_pair


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_poses_of_two_tracks_are_those_of_all_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    old, new = (rng.uniform(-3.0, 3.0, (count, 3)) for count in (40, 70))
    gaps = old[:, None] - new[None]
    apart = np.hypot(gaps[..., 0], gaps[..., 1])
    apart = apart + METRES_A_RADIAN * np.abs(wrap_angles(gaps[..., 2]))
    i, j = nearest_pair(old, new)
    assert i * len(new) + j == apart.argmin()


def test_of_poses_that_are_as_near_the_first_is_taken() -> None:
    track = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.0], [2.0, 0.0, 0.0]])
    assert nearest_pair(track, track + (0.0, 1.0, 0.0)) == (0, 0)

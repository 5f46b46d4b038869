"""The floor in a cloud: found at any tilt and height, never taken for a table or a ceiling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.clouds import CloudLeveller, floor_of
from tests.turning import turn


def room(seed: int = 0) -> FloatArray:
    """A room of 8 by 6 m around the origin, its floor at -1.2 m, with a ceiling and a table."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform((-4, -3, 0), (4, 3, 0), (3000, 3))
    walls = rng.uniform((-4, -3, -1.2), (4, 3, 1.8), (2400, 3))
    walls[:800, 0], walls[800:1600, 1], walls[1600:, 1] = 4.0, -3.0, 3.0
    table = rng.uniform((1, 1, -0.45), (2.5, 2.5, -0.45), (800, 3))
    points = np.concatenate([flat - (0, 0, 1.2), flat + (0, 0, 1.8), walls, table])
    return np.asarray(points + rng.normal(0.0, 0.01, points.shape))


@pytest.mark.parametrize("roll", [-0.6, -0.2, 0.0, 0.3])
@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.25])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_tilted_lidar_is_levelled_and_keeps_its_heading(
    roll: float, pitch: float, yaw: float
) -> None:
    turned = Rotation.from_euler("Z", yaw).apply(room())
    level_from_lidar = Rotation.from_euler("YX", [pitch, roll])
    found = floor_of(level_from_lidar.inv().apply(turned))
    assert found is not None
    off = Rotation.from_matrix(found.rotation) * level_from_lidar.inv()
    assert off.magnitude() < 0.004
    assert found.floor_m == pytest.approx(-1.2, abs=0.01)


def test_returns_beneath_the_floor_do_not_hide_it() -> None:
    """A shiny floor mirrors the ceiling."""
    mirrored = room()[3000:6000][::40] * (1.0, 1.0, -1.0) - (0.0, 0.0, 2.4)
    found = floor_of(np.concatenate([room(), mirrored]))
    assert found is not None
    assert found.floor_m == pytest.approx(-1.2, abs=0.01)


def only(*keep: str) -> FloatArray:
    parts = {"floor": (0, 3000), "ceiling": (3000, 6000), "walls": (6000, 8400)}
    return np.concatenate([room()[slice(*parts[name])] for name in keep])


@pytest.mark.parametrize(
    ("cloud", "settings_"),
    [
        (np.zeros((0, 3)), {}),
        (only("floor")[:20], {}),
        (only("walls", "ceiling"), {}),
        (only("floor")[np.abs(only("floor")[:, 1]) < 0.1], {}),  # a strip says nothing across it
        (only("floor"), {"floor_radius_m": 1.0}),
        (room(), {"floor_share": 0.9}),
    ],
    ids=["nothing", "few", "no floor", "strip", "too far", "small share"],
)
def test_a_cloud_without_a_floor_says_so(cloud: FloatArray, settings_: dict[str, float]) -> None:
    turn("logs", **settings_)
    assert floor_of(cloud) is None


def test_a_floor_tilted_beyond_the_limit_is_none() -> None:
    tilted = Rotation.from_euler("X", 0.5).apply(only("floor"))
    assert floor_of(tilted) is not None
    turn("logs", floor_tilt_max_rad=0.3)
    assert floor_of(tilted) is None


def test_a_cloud_without_a_floor_has_the_level_of_the_one_before() -> None:
    leveller = CloudLeveller()
    first = leveller.level(only("walls", "ceiling"))
    np.testing.assert_array_equal(first.rotation, np.eye(3))
    assert first.floor_m is None
    second = leveller.level(Rotation.from_euler("X", 0.2).apply(room()))
    assert second.floor_m == pytest.approx(-1.2, abs=0.01)
    assert leveller.level(only("walls")) is second

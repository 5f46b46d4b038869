"""Worlds that no plan of a real building offers: bare corridors, and corridors without end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, path_length, travelled
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation.simulator import (
    Laser,
    OdometryErrors,
    SimulatedTour,
    drifting_odometry,
    laser_bearings,
)
from specmap_cli.simulation.tours import drive
from specmap_cli.simulation.worlds import World

Place = tuple[float, float]

CELL_M = 0.05
_BORDER_M = 2.0  # of wall around a plan
_NICHE_M, _NICHE_DEPTH_M = (0.9, 1.6), (0.15, 0.6)  # doors and recesses: width and depth
_ROUNDED_M = 0.6  # how far before a corner the robot begins to turn
_PATH_STEP_M = 0.05


def corridors(
    ways: Sequence[tuple[Place, Place]], width_m: float, niche_every_m: float | None, seed: int = 0
) -> GridMap:
    """The plan of corridors along axis-parallel `ways`, with niches at random places, or bare."""
    rng = np.random.default_rng(seed)
    ends = np.array(ways, dtype=np.float64).reshape(-1, 2)
    low = ends.min(axis=0) - width_m - _BORDER_M
    size = np.ceil((ends.max(axis=0) + width_m + _BORDER_M - low) / CELL_M).astype(int)
    cells = np.full((size[1], size[0]), OCCUPIED, dtype=np.uint8)
    for way in ways:
        a, b = np.sort(np.array(way), axis=0)
        _carve(cells, a - width_m / 2 - low, b + width_m / 2 - low)
        if niche_every_m is not None:
            _niches(cells, a - low, b - low, width_m, niche_every_m, rng)
    return GridMap(cells, CELL_M, (float(low[0]), float(low[1])))


def _niches(
    cells: np.ndarray,
    a: FloatArray,
    b: FloatArray,
    width_m: float,
    every_m: float,
    rng: np.random.Generator,
) -> None:
    """Recesses in both walls of the corridor from `a` (2,) to `b` (2,)."""
    along = int(b[0] - a[0] < b[1] - a[1])
    length = float(b[along] - a[along])
    for side in (-1.0, 1.0):
        for start in np.cumsum(rng.exponential(every_m, size=int(3 * length / every_m) + 1)):
            wide, deep = rng.uniform(*_NICHE_M), rng.uniform(*_NICHE_DEPTH_M)
            if start + wide > length:
                break
            corner = np.array(a)
            corner[along] += start
            corner[1 - along] += side * width_m / 2
            opposite = np.array(corner)
            opposite[along] += wide
            opposite[1 - along] += side * deep
            _carve(cells, np.minimum(corner, opposite), np.maximum(corner, opposite))


def _carve(cells: np.ndarray, low: FloatArray, high: FloatArray) -> None:
    """Free space between two corners (2,), metres from the plan's own."""
    (left, bottom), (right, top) = np.round(low / CELL_M), np.round(high / CELL_M)
    cells[int(bottom) : int(top), int(left) : int(right)] = FREE


def drive_along(
    plan: GridMap,
    places: Sequence[Place],
    *,
    range_max_m: float,
    rate_hz: float,
    speed_mps: float,
    errors: OdometryErrors,
    field_of_view_deg: float = 270.0,
    beams: int = 361,
    noise_m: float = 0.015,
    seed: int = 0,
) -> SimulatedTour:
    """A drive from place to place, with odometry of the given errors."""
    wheels, noise = np.random.SeedSequence(seed).spawn(2)
    truth = drive(_rounded(np.array(places)), speed_mps, 1.5, 0.5)
    times = np.arange(0.0, truth.duration_s, 1.0 / rate_hz)
    laser = Laser(
        bearings=laser_bearings(np.radians(field_of_view_deg), beams),
        range_max_m=range_max_m,
        base_from_laser=Pose2(0.1, 0.0, 0.0),
        noise_m=noise_m,
        step_m=0.001,
    )
    dead = drifting_odometry(truth.at(times), errors, np.random.default_rng(wheels))
    return SimulatedTour(
        world=World.of(plan),
        laser=laser,
        truth=truth,
        odometry=type(truth)(times, dead),
        scan_times_s=times,
        area_m2=float(plan.free.sum()) * CELL_M**2,
        noise=noise,
    )


def _rounded(places: FloatArray) -> FloatArray:
    """A dense path (N, 2) through the places with its corners cut."""
    count = int(path_length(places) / _PATH_STEP_M) + 1
    at = np.linspace(0.0, travelled(places)[-1], count)
    path = np.column_stack([np.interp(at, travelled(places), places[:, k]) for k in (0, 1)])
    half = int(_ROUNDED_M / _PATH_STEP_M)
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    padded = np.pad(path, ((half, half), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(padded[:, k], kernel, mode="valid") for k in (0, 1)])

"""Casting rays in a grid map: what a laser would measure there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import GridMap

_RAYS_AT_ONCE = 1 << 16  # bounds the memory: some 10 MB
_BORDER = 1e-6  # cells a ray steps past a border, to stand in the next cell
_TINY = 1e-12  # takes the place of a direction of 0, so that its borders are far away
_DIAGONAL = math.sqrt(2.0)  # cells between two points, each half a diagonal off its cell's centre


def cast_ranges(
    distance: NDArray[Any],
    grid: GridMap,
    origins: NDArray[Any],
    bearings: NDArray[Any],
    max_range: float,
) -> FloatArray:
    """Virtual scans: ranges (N, B) from origins (N, 2) along bearings (B,), +inf past `max_range`.

    `distance` is `grid.obstacle_distance()`; see `cast_rays`.
    """
    origins = np.asarray(origins, dtype=np.float64).reshape(-1, 2)
    starts = np.repeat(origins, len(bearings), axis=0)
    angles = np.tile(np.asarray(bearings, dtype=np.float64), len(origins))
    ranges = cast_rays(distance, grid, starts, angles, max_range)
    return ranges.reshape(len(origins), len(bearings))


def cast_rays(
    distance: NDArray[Any],
    grid: GridMap,
    origins: NDArray[Any],
    angles: NDArray[Any],
    max_range: float,
) -> FloatArray:
    """Ranges (N,) of single rays from origins (N, 2) along angles (N,), +inf past `max_range`.

    `distance` is `grid.obstacle_distance()`. A ray leaps by the free distance it stands in and
    walks from cell border to cell border near obstacles, so that its range is where it enters the
    first occupied cell it touches, exact to a thousandth of a millimetre. Rays that leave the grid
    return +inf.
    """
    ranges = np.full(len(angles), np.inf)
    for first in range(0, len(angles), _RAYS_AT_ONCE):
        part = slice(first, first + _RAYS_AT_ONCE)
        starts = (np.asarray(origins[part], dtype=np.float64) - grid.origin) / grid.resolution
        cells = _march(distance, grid.resolution, starts, angles[part], max_range / grid.resolution)
        ranges[part] = cells * grid.resolution
    return ranges


def _march(
    distance: NDArray[Any],
    resolution: float,
    starts: FloatArray,
    angles: NDArray[Any],
    limit: float,
) -> FloatArray:
    """`cast_rays` in cells: starts (N, 2) column and row; lengths (N,), +inf past `limit`."""
    height, width = distance.shape
    flat = distance.reshape(-1)
    lengths = np.full(len(angles), np.inf)
    alive = np.arange(len(angles))
    x, y = starts[:, 0].copy(), starts[:, 1].copy()
    dx, dy = _nonzero(np.cos(angles)), _nonzero(np.sin(angles))
    travelled = np.zeros(len(angles))
    while len(alive):
        column, row = np.floor(x), np.floor(y)
        on = (column >= 0) & (row >= 0) & (column < width) & (row < height) & (travelled <= limit)
        index = np.where(on, row * width + column, 0).astype(np.intp)
        room = flat[index] / resolution
        stopped = on & (room <= 0.0)
        lengths[alive[stopped]] = travelled[stopped]
        border = np.minimum((column + (dx > 0) - x) / dx, (row + (dy > 0) - y) / dy)
        # neither the ray nor the obstacle need be at the centre of its cell
        step = np.maximum(room - _DIAGONAL, border + _BORDER)
        on &= ~stopped
        alive, step, dx, dy = alive[on], step[on], dx[on], dy[on]
        x, y = x[on] + dx * step, y[on] + dy * step
        travelled = travelled[on] + step
    return lengths


def _nonzero(direction: FloatArray) -> FloatArray:
    """The same components with those next to zero replaced by a tiny one of a sure sign."""
    return np.where(np.abs(direction) < _TINY, _TINY, direction)

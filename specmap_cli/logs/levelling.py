"""Clouds of a lidar whose mounting is unknown, levelled by the floor that they show.

Without a base frame nothing in a log says which way is up: a lidar may be tilted, or carried by
hand. The floor says so in every cloud. It is the plane below the lidar with the most returns near
it, those still lower counted against it: under a table top or a shelf there are returns.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from specmap_cli.core.arrays import first_in_cells
from specmap_cli.core.geometry import FloatArray, inverse3, product

FLOOR_RADIUS_M = 10.0  # a floor of unknown height is sought among the returns this near
# Floors are sought up to this tilt of the lidar: 45 degrees, as carried by hand.
_FLOOR_TILT_MAX_RAD = 0.785
_FLOOR_SHARE = 0.1  # share of the returns within FLOOR_RADIUS_M that must show a floor
_CELL_M = 0.4  # returns are thinned to it: floors near the lidar have thousands
_STEP_RAD = math.radians(5.0)  # between the tilts tried: 0.2 m off at 5 m
_LAYER_M = 0.2  # in which returns at one tilt are counted: what such a step displaces
_LOWER_WEIGHT = 2.0  # of a return below a floor, against one on it
_WIDTHS_M = (0.4, 0.2, 0.1, 0.05)  # returns this near a plane fix it anew, coarse to fine
_SPREAD_M = 0.4  # standard deviation of a floor's returns across it: less is a kerb or a board
_FEWEST = 30  # returns that fix a plane well: a tilt of 0.05 m / 10 m / sqrt(30)


class Level(NamedTuple):
    """A cloud's rotation (3, 3) into a level frame, and the floor's height there if it is known.

    The level frame looks where the lidar's x axis looks, and has its origin.
    """

    rotation: FloatArray
    floor_m: float | None


class CloudLeveller:
    """Finds the level of each cloud; one that shows no floor gets that of the cloud before it."""

    def __init__(self) -> None:
        self._last = Level(np.eye(3), None)

    def level(self, cloud: FloatArray) -> Level:
        """The level of a cloud (N, 3)."""
        self._last = floor_of(cloud) or self._last
        return self._last


def floor_of(cloud: FloatArray) -> Level | None:
    """The floor in a cloud (N, 3), None when it shows none."""
    squares = np.einsum("ij,ij->i", cloud, cloud)
    near = cloud[np.flatnonzero(squares <= FLOOR_RADIUS_M**2)]
    near = near[first_in_cells(near, _CELL_M)]
    if len(near) < _FEWEST:
        return None
    tilts = _tilts(_FLOOR_TILT_MAX_RAD)
    number, height = _best_layer(near, tilts)
    rotation = tilts[number]
    for width_m in _WIDTHS_M:
        turned = product(near, rotation.T)
        floor = turned[np.abs(turned[:, 2] - height) < width_m]
        if not _is_wide(floor):
            return None
        normal, height = _plane(floor)
        rotation = _upright(product(normal[None], rotation)[0])
    enough = len(floor) >= _FLOOR_SHARE * len(near)
    upright = float(rotation[2, 2]) >= math.cos(_FLOOR_TILT_MAX_RAD)
    return Level(rotation, height) if enough and upright and height < 0.0 else None


@cache
def _tilts(most_rad: float) -> FloatArray:
    """Rotations (T, 3, 3) to level frames whose vertical is within an angle of the lidar's z."""
    steps = math.floor(most_rad / _STEP_RAD)
    angles = [_STEP_RAD * step for step in range(-steps, steps + 1)]
    normals = [
        (math.sin(a) * math.cos(b), math.sin(b), math.cos(a) * math.cos(b))
        for a in angles
        for b in angles
    ]
    lowest = math.cos(most_rad)
    return np.stack([_upright(np.array(n)) for n in normals if n[2] >= lowest])


def _upright(normal: FloatArray) -> FloatArray:
    """The rotation (3, 3) that turns a unit vector up and leaves the heading of the x axis."""
    x, y, z = normal.tolist()
    slope = math.hypot(y, z)
    cr, sr, cp, sp = z / slope, y / slope, slope, -x
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def _best_layer(points: FloatArray, tilts: FloatArray) -> tuple[int, float]:
    """Which tilt shows the fullest layer of points (N, 3) below the lidar, and its middle."""
    depths = np.floor(product(tilts[:, 2, :], -points.T) / _LAYER_M).astype(np.intp)
    count = max(1, int(depths.max()) + 1)
    depths[depths < 0] = count  # above the lidar
    rows = np.arange(len(tilts))[:, None] * (count + 1)
    counts = np.bincount((depths + rows).ravel(), minlength=(count + 1) * len(tilts))
    filled = counts.reshape(len(tilts), -1)[:, :count]
    lower = filled[:, ::-1].cumsum(axis=1)[:, ::-1]
    lower = np.pad(lower, ((0, 0), (0, 2)))[:, 2:]  # the next layer may be of the same floor
    worth = filled - _LOWER_WEIGHT * lower
    number, depth = divmod(int(worth.argmax()), count)
    return number, -(depth + 0.5) * _LAYER_M


def _is_wide(points: FloatArray) -> bool:
    """Whether points (N, 3) are enough, and far enough apart every way, to fix a plane."""
    if len(points) < _FEWEST:
        return False
    x, y = (points[:, :2] - points[:, :2].mean(axis=0)).T
    xx, xy, yy = float((x * x).mean()), float((x * y).mean()), float((y * y).mean())
    least = (xx + yy) / 2 - math.hypot((xx - yy) / 2, xy)
    return least >= _SPREAD_M**2


def _plane(points: FloatArray) -> tuple[FloatArray, float]:
    """The plane z = a x + b y + c of points (N, 3) by least squares: its normal, its height.

    The height is that of the point of the plane nearest the origin, along the normal.
    """
    ground = np.column_stack([points[:, :2], np.ones(len(points))])
    slopes = product(ground.T, points[:, 2:])
    a, b, c = product(inverse3(product(ground.T, ground)), slopes)[:, 0].tolist()
    length = math.sqrt(1.0 + a * a + b * b)
    return np.array([-a, -b, 1.0]) / length, c / length

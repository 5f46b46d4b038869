"""Lasers, planar and 3D, and wheel odometry, with their errors, on a robot that follows a drive."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.simulation.tours import Drive
from specmap_cli.simulation.worlds import World

_NEAREST_M = 0.02  # noise never makes a return nearer: a range is above 0
_BATCH = 64  # scans cast at once: 35,000 rays of the usual laser, some MB
_SIDEWAYS = 0.5  # of the random error along the way that wheels make across it


@dataclass(frozen=True, slots=True, kw_only=True)
class Laser:
    """A planar laser: `bearings` (B,) in its own frame, mounted at `base_from_laser`.

    `noise_m` is the standard deviation of a range, `step_m` what ranges are rounded to,
    `dropouts` the share of beams that lose their return, `sweep_s` the time from the first beam of
    a scan to the last.
    """

    bearings: FloatArray
    range_max_m: float
    base_from_laser: Pose2
    noise_m: float = 0.0
    step_m: float = 0.0
    dropouts: float = 0.0
    sweep_s: float = 0.0

    @property
    def increment(self) -> float:
        """Angle from beam to beam."""
        return float(self.bearings[-1] - self.bearings[0]) / (len(self.bearings) - 1)

    @property
    def full_circle(self) -> bool:
        """Whether the beam after the last one would be the first."""
        return is_full_circle(self.increment * len(self.bearings))

    @property
    def beam_times_s(self) -> FloatArray:
        """(B,) seconds of each beam after the scan's stamp, which is the first beam's."""
        return np.linspace(0.0, self.sweep_s, len(self.bearings))

    def scans(
        self, world: World, drive: Drive, times_s: FloatArray, rng: np.random.Generator
    ) -> Iterator[FloatArray]:
        """Measured ranges (B,) of the scans that begin at the times (n,), +inf = no return."""
        for ranges in self.casts(world, drive, times_s):
            yield from self.measured(ranges, rng)

    def casts(self, world: World, drive: Drive, times_s: FloatArray) -> Iterator[FloatArray]:
        """True ranges (m, B) of the scans that begin at the times (n,), some scans at a time."""
        for first in range(0, len(times_s), _BATCH):
            begins = times_s[first : first + _BATCH]
            times = begins[:, None] + self.beam_times_s[None, :]
            lasers = compose(drive.at(times), np.array(self.base_from_laser))
            angles = lasers[..., 2] + self.bearings
            origins = lasers[..., :2].reshape(-1, 2)
            ranges = world.cast(origins, angles.reshape(-1), self.range_max_m)
            yield ranges.reshape(times.shape)

    def measured(self, ranges: FloatArray, rng: np.random.Generator) -> FloatArray:
        """True ranges of any shape as this laser reports them, in float32's precision."""
        measured = ranges + rng.normal(0.0, self.noise_m, ranges.shape)
        if self.step_m > 0.0:
            measured = np.round(measured / self.step_m) * self.step_m
        measured = np.maximum(measured, _NEAREST_M)
        measured[rng.random(ranges.shape) < self.dropouts] = np.inf
        measured[measured > self.range_max_m] = np.inf
        return np.asarray(measured.astype(np.float32), dtype=np.float64)


def laser_bearings(field_of_view_rad: float, beams: int) -> FloatArray:
    """Bearings (B,) centred on straight ahead; of a full circle the last one is left out."""
    half = 0.5 * field_of_view_rad
    return np.linspace(-half, half, beams, endpoint=not is_full_circle(field_of_view_rad))


def is_full_circle(angle_rad: float) -> bool:
    """Whether an angle is 2 pi, or less by no more than what rounding takes."""
    return angle_rad >= 2.0 * math.pi - 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryErrors:
    """How wheel odometry drifts: random walks, and errors of the calibration.

    The defaults are those of a usual wheeled robot indoors: metres off after a few hundred metres.

    A random error grows with the square root of the way: its standard deviation is that after one
    metre or one radian. The calibration's errors are relative (`..._scale`) or, for wheels of
    unequal size, radians a metre (`veer_per_m`).
    """

    translation_per_m: float = 0.01
    rotation_per_m: float = 0.01
    rotation_per_rad: float = 0.02
    distance_scale: float = 0.01
    turn_scale: float = 0.01
    veer_per_m: float = 0.003

    def times(self, factor: float) -> OdometryErrors:
        """All errors made larger or smaller."""
        return OdometryErrors(**{name: factor * error for name, error in asdict(self).items()})


def drifting_odometry(
    poses: FloatArray, errors: OdometryErrors, rng: np.random.Generator
) -> FloatArray:
    """Dead reckoning (n, 3) along true poses (n, 3), n >= 1, from the origin, angles unwrapped."""
    steps = compose(invert(poses[:-1]), poses[1:])
    way = np.hypot(steps[:, 0], steps[:, 1])
    turn = np.abs(steps[:, 2])
    slip = rng.normal(0.0, 1.0, (len(steps), 3))
    along = errors.translation_per_m * np.sqrt(way)
    measured = np.empty_like(steps)
    measured[:, 0] = steps[:, 0] * (1.0 + errors.distance_scale) + slip[:, 0] * along
    measured[:, 1] = steps[:, 1] * (1.0 + errors.distance_scale) + slip[:, 1] * _SIDEWAYS * along
    random_turn = np.hypot(
        errors.rotation_per_m * np.sqrt(way), errors.rotation_per_rad * np.sqrt(turn)
    )
    measured[:, 2] = steps[:, 2] * (1.0 + errors.turn_scale) + errors.veer_per_m * way
    measured[:, 2] += slip[:, 2] * random_turn
    heading = np.concatenate([[0.0], np.cumsum(measured[:, 2])])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    moved = np.column_stack(
        [c * measured[:, 0] - s * measured[:, 1], s * measured[:, 0] + c * measured[:, 1]]
    )
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    return np.column_stack([places, heading])


class Cloud(NamedTuple):
    """Returns of one sweep: `points` (N, 3) in the lidar's frame, `times_s` (N,) after its stamp.

    They come in the order in which they were measured; `times_s` is None for a sweep at once.
    """

    points: FloatArray
    times_s: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Lidar:
    """A 3D lidar: `level` with beams at every one of the `elevations` (R,), radians, upwards.

    It stands `height_m` above the floor; walls and the ceiling are `ceiling_m` above it.
    """

    level: Laser
    elevations: FloatArray
    height_m: float
    ceiling_m: float

    def clouds(
        self, world: World, drive: Drive, times_s: FloatArray, rng: np.random.Generator
    ) -> Iterator[Cloud]:
        """The sweeps that begin at the times (n,)."""
        # over ground, the beams of a ring end at the ceiling or on the floor, or else at a wall
        slopes = np.tan(self.elevations)
        room = np.where(slopes > 0.0, self.ceiling_m - self.height_m, self.height_m)
        level = slopes == 0.0
        ends = np.where(level, np.inf, room / np.where(level, 1.0, np.abs(slopes)))
        for walls in self.level.casts(world, drive, times_s):
            for distances in walls:
                ranges = np.minimum(distances[:, None], ends) / np.cos(self.elevations)
                ranges = self.level.measured(ranges, rng)
                hit = np.isfinite(ranges)
                column, ring = np.nonzero(hit)
                bearings, elevations = self.level.bearings[column], self.elevations[ring]
                over_ground = ranges[hit] * np.cos(elevations)
                x, y = over_ground * np.cos(bearings), over_ground * np.sin(bearings)
                points = np.column_stack([x, y, ranges[hit] * np.sin(elevations)])
                timed = self.level.sweep_s > 0.0
                yield Cloud(points, self.level.beam_times_s[column] if timed else None)

"""The simulator: a robot with a laser tours a floor plan, and errs as real ones do.

The plan is the truth: the robot visits all space it can reach, and the true pose of every scan is
known. Same plan, options and version: the same scans, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, path_length, wrap_angle
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.text import nanoseconds, said
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.simulation.tours import Drive, drive, plan_tour, reachable_space
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


START_NS = 1_700_000_000 * 10**9  # when every tour begins: a day of November 2023
_ROUNDING_S = 1e-9  # so that a scan due at the very end is made, whatever rounding says


class SimulationOptions(BaseModel):
    """The robot, its laser, its errors and its tour."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    field_of_view_deg: float = Field(270.0, ge=10, le=360)
    beams: int = Field(541, ge=8, le=20_000)
    range_max_m: float = Field(20.0, gt=0, le=1000)
    rate_hz: float = Field(10.0, gt=0, le=200, description="scans a second")
    sweep_s: float = Field(0.0, ge=0, description="first beam of a scan to its last; 0: at once")
    noise_m: float = Field(0.01, ge=0, le=1, description="standard deviation of a range")
    range_step_m: float = Field(0.001, ge=0, le=1, description="ranges are rounded to this")
    dropouts: float = Field(0.0, ge=0, lt=1, description="share of beams without their return")
    laser_x_m: float = 0.1
    laser_y_m: float = 0.0
    laser_yaw_deg: float = 0.0
    rings: int = Field(1, ge=1, le=256, description="1: a planar laser; more: a 3D lidar")
    vertical_fov_deg: float = Field(
        45.0, gt=0, lt=180, description="from the lowest ring to the highest, centred on level"
    )
    laser_height_m: float = Field(0.6, gt=0, description="of a 3D lidar above the floor")
    ceiling_m: float = Field(2.5, gt=0, description="of walls and ceiling above the floor")
    speed_mps: float = Field(0.6, gt=0, le=20)
    acceleration_mps2: float = Field(0.5, gt=0, le=20, description="and braking")
    turn_rate_degps: float = Field(90.0, gt=0, le=1000)
    robot_radius_m: float = Field(0.25, gt=0, description="the disc that must fit along the path")
    comfort_m: float = Field(
        0.8, gt=0, le=100, description="the path keeps this far from walls where there is room"
    )
    odometry_rate_hz: float = Field(10.0, gt=0, le=1000)
    odometry_drift: float = Field(1.0, ge=0, le=100, description="0: exact; 1: a usual robot")
    spacing_m: float = Field(2.0, ge=0.3, description="the path comes this near to every place")
    laps: int = Field(1, ge=1, le=100)
    max_duration_s: float | None = Field(None, gt=0, description="the recording ends here")
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _fit_together(self) -> SimulationOptions:
        if self.sweep_s > 1.0 / self.rate_hz:
            raise ValueError(f"sweep_s is longer than the {1.0 / self.rate_hz:g} s between scans")
        if self.rings > 1 and self.laser_height_m >= self.ceiling_m:
            raise ValueError(f"laser_height_m is not below ceiling_m, {self.ceiling_m:g} m")
        return self


def simulation_options(**values: Any) -> SimulationOptions:
    """Options by name. Raises UsageError naming the option that is unknown or out of range."""
    try:
        return SimulationOptions(**values)
    except ValidationError as error:
        first = error.errors()[0]
        if not first["loc"]:  # a check of several options together, which names them itself
            raise UsageError(str(first["ctx"]["error"])) from None
        raise UsageError(
            f"{said(first)}, found {first['input']!r}", where=first["loc"][0]
        ) from None


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedTour:
    """A tour as it will be recorded: everything but the ranges, which are cast scan by scan.

    `truth` is the robot's way in the plan, `odometry` the same by dead reckoning, at the times of
    its own messages. `noise` seeds the errors of the laser. A 3D `lidar` has `laser` for its level.
    """

    world: World
    laser: Laser
    lidar: Lidar | None = None
    truth: Drive
    odometry: Drive
    scan_times_s: FloatArray
    area_m2: float
    noise: np.random.SeedSequence

    @property
    def duration_s(self) -> float:
        """Time of the last scan; the first one is at 0."""
        return float(self.scan_times_s[-1])

    @property
    def distance_m(self) -> float:
        """Way driven up to the last scan."""
        return path_length(self.truth.at(self.scan_times_s))

    def scans(self) -> Iterator[tuple[Sweep, Pose2]]:
        """Every planar scan, as read from a log, with its true base pose in the plan.

        A 3D lidar has `clouds` instead, which become scans when a log of them is read.
        """
        laser, times = self.laser, self.scan_times_s
        truth, guesses = self.truth.at(times), self.odometry.at(times)
        beam_times = laser.beam_times_s if laser.sweep_s > 0.0 else None
        rng = np.random.default_rng(self.noise)
        for index, ranges in enumerate(laser.scans(self.world, self.truth, times, rng)):
            planar = PlanarScan(
                stamp_ns=stamp_of(times[index]),
                bearings=laser.bearings,
                ranges=ranges,
                range_max=laser.range_max_m,
                full_circle=laser.full_circle,
                beam_times_s=beam_times,
            )
            sweep = Sweep(
                index=index,
                stamp_ns=planar.stamp_ns,
                planar=planar,
                base_from_laser=laser.base_from_laser,
                odom_from_base=_pose(guesses[index]),
            )
            yield sweep, _pose(truth[index])

    def clouds(self) -> Iterator[tuple[int, Pose2, Cloud]]:
        """Stamp, true base pose in the plan and returns of every sweep of a 3D lidar."""
        assert self.lidar is not None
        truth, rng = self.truth.at(self.scan_times_s), np.random.default_rng(self.noise)
        clouds = self.lidar.clouds(self.world, self.truth, self.scan_times_s, rng)
        for time, pose, cloud in zip(self.scan_times_s, truth, clouds, strict=True):
            yield stamp_of(time), _pose(pose), cloud

    def odometry_messages(self) -> Iterator[tuple[int, Pose2]]:
        """Stamp and pose of every message of the odometry, in turn."""
        for time, pose in zip(self.odometry.times_s, self.odometry.poses, strict=True):
            yield stamp_of(time), _pose(pose)


def stamp_of(time_s: float) -> int:
    """Header stamp of a time of the tour, nanoseconds, in whole microseconds."""
    return START_NS + nanoseconds(float(time_s))


def simulated_tour(plan: GridMap, options: SimulationOptions) -> SimulatedTour:
    """Plan and drive the tour. Raises MapError when the robot fits nowhere in the plan.

    The route, the odometry's errors and the laser's are drawn from seeds of their own: another
    noise leaves the route as it is.
    """
    route = np.random.default_rng(np.random.SeedSequence(options.seed).spawn(1)[0])
    world = World.of(plan)
    space = reachable_space(world, options.robot_radius_m, options.comfort_m)
    path = plan_tour(world, space, options.spacing_m, options.laps, route)
    return tour_along(path, world, options, space.area_m2)


def tour_along(
    path: FloatArray, world: World, options: SimulationOptions, area_m2: float
) -> SimulatedTour:
    """The tour along a path (N, 2) in the world, of which the robot can reach `area_m2`.

    Its errors are those that `options.seed` draws for a tour of its own.
    """
    _, wheels, noise = np.random.SeedSequence(options.seed).spawn(3)
    turn_rate = math.radians(options.turn_rate_degps)
    truth = drive(path, options.speed_mps, turn_rate, options.acceleration_mps2)
    duration = min(truth.duration_s, options.max_duration_s or math.inf)
    scan_times = np.arange(0.0, duration + _ROUNDING_S, 1.0 / options.rate_hz)
    laser = Laser(
        bearings=laser_bearings(math.radians(options.field_of_view_deg), options.beams),
        range_max_m=options.range_max_m,
        base_from_laser=Pose2(
            options.laser_x_m, options.laser_y_m, math.radians(options.laser_yaw_deg)
        ),
        noise_m=options.noise_m,
        step_m=options.range_step_m,
        dropouts=options.dropouts,
        sweep_s=options.sweep_s,
    )
    lidar = None
    if options.rings > 1:
        half = 0.5 * math.radians(options.vertical_fov_deg)
        lidar = Lidar(
            level=laser,
            elevations=np.linspace(-half, half, options.rings),
            height_m=options.laser_height_m,
            ceiling_m=options.ceiling_m,
        )
    # dead reckoning between the stamps of the scans, and around the first and the last of them
    period = 1.0 / options.odometry_rate_hz
    times = np.arange(-0.5 * period, float(scan_times[-1]) + period, period)
    errors = OdometryErrors().times(options.odometry_drift)
    reckoned = drifting_odometry(truth.at(times), errors, np.random.default_rng(wheels))
    return SimulatedTour(
        world=world,
        laser=laser,
        lidar=lidar,
        truth=truth,
        odometry=Drive(times, reckoned),
        scan_times_s=scan_times,
        area_m2=area_m2,
        noise=noise,
    )


def _pose(row: FloatArray) -> Pose2:
    x, y, theta = row.tolist()
    return Pose2(x, y, wrap_angle(theta))

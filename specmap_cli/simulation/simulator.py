"""The simulator: a robot with a laser tours a floor plan, and errs as real ones do.

The plan is the truth: the robot visits all space it can reach, and the true pose of every scan is
known. Same plan, options and version: the same scans, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray, Pose2, path_length, wrap_angle
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.text import nanoseconds
from specmap_cli.core.wording import said
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.simulation.lasers import (
    Cloud,
    Laser,
    Lidar,
    OdometryErrors,
    drifting_odometry,
    laser_bearings,
)
from specmap_cli.simulation.tours import Drive, Limits, drive, plan_tour, reachable_space
from specmap_cli.simulation.worlds import World

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
        """Every planar scan, as read from a log, with its true base pose in the plan."""
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
            guess = _pose(guesses[index])
            sweep = Sweep(
                index=index,
                stamp_ns=planar.stamp_ns,
                planar=planar,
                base_from_laser=laser.base_from_laser,
                odom_from_base=guess,
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
    limits = Limits(
        options.speed_mps, math.radians(options.turn_rate_degps), options.acceleration_mps2
    )
    truth = drive(path, limits)
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


def simulate_sweeps(plan: GridMap, options: SimulationOptions) -> Iterator[tuple[Sweep, Pose2]]:
    """The planar scans of a tour with odometry, as read from a log, with their true base poses.

    Raises UsageError for a 3D lidar: its clouds become scans only when a log of them is read.
    """
    if options.rings > 1:
        raise UsageError(
            "a 3D lidar has clouds",
            "write a log of them by specmap simulate",
            mark=";",
            where="rings",
        )
    yield from simulated_tour(plan, options).scans()


def _pose(row: FloatArray) -> Pose2:
    x, y, theta = row.tolist()
    return Pose2(x, y, wrap_angle(theta))

"""Simulated recordings: a robot with a planar laser tours a floor plan.

The plan is the truth: the robot visits all space it can reach, its laser and its odometry err as
real ones do, and the true pose of every scan is known. Same plan, options and version: the same
recording, byte for byte.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from specmap_cli.core.errors import UsageError
from specmap_cli.core.files import write_text
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.logs.writer import LogWriter
from specmap_cli.simulation.driving import Drive, drive
from specmap_cli.simulation.lasers import (
    Laser,
    OdometryErrors,
    drifting_odometry,
    laser_bearings,
)
from specmap_cli.simulation.tours import plan_tour, reachable_space
from specmap_cli.simulation.worlds import World

START_NS = 1_700_000_000 * 10**9
BASE_FRAME, ODOM_FRAME, LASER_FRAME = "base_link", "odom", "laser"


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
    speed_mps: float = Field(0.6, gt=0, le=20)
    turn_rate_degps: float = Field(90.0, gt=0, le=1000)
    robot_radius_m: float = Field(0.25, gt=0, description="the disc that must fit along the path")
    odometry_rate_hz: float = Field(10.0, gt=0, le=1000)
    odometry_drift: float = Field(1.0, ge=0, le=100, description="0: exact; 1: a usual robot")
    spacing_m: float = Field(2.0, ge=0.3, description="the path comes this near to every place")
    laps: int = Field(1, ge=1, le=100)
    max_duration_s: float | None = Field(None, gt=0, description="the recording ends here")
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _sweeps_do_not_overlap(self) -> SimulationOptions:
        if self.sweep_s > 1.0 / self.rate_hz:
            raise ValueError(f"sweep_s is longer than the {1.0 / self.rate_hz:g} s between scans")
        return self


def simulation_options(**values: Any) -> SimulationOptions:
    """Options by name. Raises UsageError naming the option that is unknown or out of range."""
    try:
        return SimulationOptions(**values)
    except ValidationError as error:
        first = error.errors()[0]
        if not first["loc"]:  # a check of several options together, which names them itself
            raise UsageError(str(first["ctx"]["error"])) from None
        raise UsageError(f"{first['loc'][0]}: {first['msg']}, found {first['input']!r}") from None


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """What was written: the recording, the true poses beside it, and their size."""

    log: Path
    truth: Path
    scans: int
    duration_s: float
    distance_m: float
    area_m2: float

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        return {**asdict(self), "log": str(self.log), "truth": str(self.truth)}

    def lines(self) -> list[str]:
        """The same for a person."""
        return [
            f"{self.log}: {counted(self.scans, 'scan')} in {self.duration_s:.0f} s over "
            f"{self.distance_m:.0f} m through {self.area_m2:.0f} m2",
            f"true poses in {self.truth}",
        ]


@dataclass(frozen=True, slots=True)
class Recording:
    """A tour as it will be recorded: everything but the ranges, which are cast scan by scan."""

    world: World
    laser: Laser
    drive: Drive
    scan_times_s: FloatArray
    odometry_times_s: FloatArray
    odometry: FloatArray
    area_m2: float
    noise: np.random.Generator

    def scans(self) -> Iterator[tuple[Sweep, Pose2]]:
        """Every scan with its true base pose in the plan; can be run through once."""
        laser = self.laser
        truth = self.drive.at(self.scan_times_s)
        guesses = Drive(self.odometry_times_s, self.odometry).at(self.scan_times_s)
        full = laser.increment * len(laser.bearings) >= 2.0 * math.pi - 1e-6
        beam_times = laser.beam_times_s if laser.sweep_s > 0.0 else None
        measured = laser.scans(self.world, self.drive, self.scan_times_s, self.noise)
        for index, ranges in enumerate(measured):
            stamp = stamp_of(self.scan_times_s[index])
            planar = PlanarScan(stamp, laser.bearings, ranges, laser.range_max_m, full, beam_times)
            sweep = Sweep(index, stamp, planar, laser.base_from_laser, _pose(guesses[index]))
            yield sweep, _pose(truth[index])


def stamp_of(time_s: float) -> int:
    """Header stamp of a time of the tour, nanoseconds, in whole microseconds."""
    return START_NS + round(float(time_s) * 1e6) * 1000


def record(plan: GridMap, options: SimulationOptions) -> Recording:
    """Plan and drive the tour. Raises MapError when the robot fits nowhere in the plan."""
    route, wheels, noise = np.random.default_rng(options.seed).spawn(3)
    world = World.of(plan)
    space = reachable_space(world, options.robot_radius_m)
    path = plan_tour(world, space, options.robot_radius_m, options.spacing_m, options.laps, route)
    driven = drive(path, options.speed_mps, math.radians(options.turn_rate_degps))
    duration = min(driven.duration_s, options.max_duration_s or math.inf)
    scan_times = np.arange(0.0, duration + 1e-9, 1.0 / options.rate_hz)
    # between the scans' stamps, and around the first and the last of them
    period = 1.0 / options.odometry_rate_hz
    odometry_times = np.arange(-0.5 * period, scan_times[-1] + period, period)
    errors = OdometryErrors().times(options.odometry_drift)
    odometry = drifting_odometry(driven.at(odometry_times), errors, wheels)
    return Recording(
        world, _laser(options), driven, scan_times, odometry_times, odometry, space.area_m2, noise
    )


def simulate_sweeps(plan: GridMap, options: SimulationOptions) -> Iterator[tuple[Sweep, Pose2]]:
    """The scans of a tour with odometry, as read from a log, each with its true base pose."""
    yield from record(plan, options).scans()


def simulate(
    plan: GridMap,
    options: SimulationOptions,
    out: Path,
    truth: Path | None = None,
    progress: Progress | None = None,
) -> SimulationResult:
    """Write a tour of `plan` as MCAP: /scan, /odom and /tf_static, and the true poses as TUM.

    `truth` is where the true poses of the base in the plan go, one line a scan; by default `out`
    with the suffix .tum. Raises MapError when the robot fits nowhere in the plan and UsageError
    when a file cannot be written.
    """
    progress = progress or Silent()
    recording = record(plan, options)
    truth = truth or out.with_suffix(".tum")
    progress.start("simulate", len(recording.scan_times_s))
    lines = []
    with LogWriter(out) as writer:
        mounting = recording.laser.base_from_laser
        writer.static_transform(
            BASE_FRAME,
            LASER_FRAME,
            (mounting.x, mounting.y, 0.0),
            _quaternion(mounting.theta),
            START_NS,
        )
        odometry = _OdometryTrack(recording, writer)
        for sweep, pose in recording.scans():
            odometry.write_until(sweep.stamp_ns)
            _write_scan(writer, recording.laser, sweep.planar, options.rate_hz)
            lines.append(tum_line(sweep.stamp_ns, pose))
            progress.advance()
        odometry.write_until(None)
        write_text(truth, "".join(lines))
    end = float(recording.scan_times_s[-1])
    return SimulationResult(out, truth, len(lines), end, driven_m(recording), recording.area_m2)


def driven_m(recording: Recording) -> float:
    """Distance driven up to the last scan."""
    places = recording.drive.at(recording.scan_times_s)[:, :2]
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def tum_line(stamp_ns: int, pose: Pose2) -> str:
    """One line `t x y z qx qy qz qw` of a TUM trajectory."""
    _, _, z, w = _quaternion(pose.theta)
    seconds = f"{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d}"
    return f"{seconds} {pose.x:.9f} {pose.y:.9f} 0 0 0 {z:.9f} {w:.9f}\n"


class _OdometryTrack:
    """Writes the odometry up to a stamp, so that messages come in the order of their stamps."""

    def __init__(self, recording: Recording, writer: LogWriter) -> None:
        self._stamps = [stamp_of(time) for time in recording.odometry_times_s]
        self._poses = recording.odometry
        self._writer = writer
        self._next = 0

    def write_until(self, stamp_ns: int | None) -> None:
        while self._next < len(self._stamps):
            stamp = self._stamps[self._next]
            if stamp_ns is not None and stamp > stamp_ns:
                return
            pose = _pose(self._poses[self._next])
            self._writer.odometry("/odom", ODOM_FRAME, BASE_FRAME, stamp, pose)
            self._next += 1


def _write_scan(writer: LogWriter, laser: Laser, planar: PlanarScan, rate_hz: float) -> None:
    writer.scan(
        "/scan",
        LASER_FRAME,
        planar.stamp_ns,
        float(laser.bearings[0]),
        laser.increment,
        planar.ranges,
        range_max=laser.range_max_m,
        time_increment=laser.sweep_s / (len(laser.bearings) - 1),
        scan_time=1.0 / rate_hz,
    )


def _laser(options: SimulationOptions) -> Laser:
    return Laser(
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


def _pose(row: FloatArray) -> Pose2:
    x, y, theta = row.tolist()
    return Pose2(x, y, wrap_angle(theta))


def _quaternion(theta: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))

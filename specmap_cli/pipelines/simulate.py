"""`specmap simulate`: the tour of a simulated robot as a recording, its true poses beside it."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.errors import UsageError
from specmap_cli.core.files import write_text
from specmap_cli.core.geometry import Pose2, quaternions_from_rpy
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import Sweep, Trajectory
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.logs.writer import LogWriter
from specmap_cli.maps.text_files import trajectory_text
from specmap_cli.simulation.simulator import (
    START_NS,
    Cloud,
    SimulatedTour,
    SimulationOptions,
    simulated_tour,
)

BASE_FRAME, ODOM_FRAME, LASER_FRAME = "base_link", "odom", "laser"  # as in ROS's REP 105
SCAN_TOPIC, CLOUD_TOPIC, ODOM_TOPIC = "/scan", "/points", "/odom"


@dataclass(frozen=True, slots=True, kw_only=True)
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


def simulate(
    plan: GridMap,
    options: SimulationOptions,
    out: str | Path,
    truth: str | Path | None = None,
    progress: Progress | None = None,
) -> SimulationResult:
    """Write a tour of `plan` as MCAP: /scan, /odom and /tf_static, and the true poses as TUM.

    A 3D lidar has /points in place of /scan.

    `truth` is where the true poses of the base in the plan go, one line a scan; by default `out`
    with the suffix .tum. Raises MapError when the robot fits nowhere in the plan and UsageError
    when a file cannot be written, or both would be one file.
    """
    progress = progress or Silent()
    out = Path(out)
    truth = out.with_suffix(".tum") if truth is None else Path(truth)
    if truth == out:
        raise UsageError(
            "the recording and the true poses would be one file", "rename one", mark=";", where=out
        )
    tour = simulated_tour(plan, options)
    progress.start("simulate", len(tour.scan_times_s))
    with LogWriter(out) as writer:
        true_poses = _write_tour(writer, tour, options.rate_hz, progress)
        write_text(truth, trajectory_text(true_poses))
    return SimulationResult(
        log=out,
        truth=truth,
        scans=len(true_poses.stamps_ns),
        duration_s=tour.duration_s,
        distance_m=tour.distance_m,
        area_m2=tour.area_m2,
    )


def _write_tour(
    writer: LogWriter, tour: SimulatedTour, rate_hz: float, progress: Progress
) -> Trajectory:
    """Write every message of a tour; returns the true poses at its scans."""
    laser, lidar = tour.laser, tour.lidar
    x, y, theta = laser.base_from_laser
    z = 0.0 if lidar is None else lidar.height_m
    level = np.zeros(1)
    quaternion = quaternions_from_rpy(level, level, np.array([theta]))[0].tolist()
    writer.static_transform(
        BASE_FRAME, LASER_FRAME, (x, y, z), quaternion_xyzw=quaternion, stamp_ns=START_NS
    )
    # what the laser sees, with the true pose; the odometry, which sees nothing, with its own
    seen: Iterator[tuple[int, Pose2, Sweep | Cloud]] = (
        tour.clouds()
        if lidar is not None
        else ((sweep.stamp_ns, pose, sweep) for sweep, pose in tour.scans())
    )
    odometry = ((stamp, pose, None) for stamp, pose in tour.odometry_messages())
    stamps: list[int] = []
    poses: list[Pose2] = []
    for stamp, pose, reading in heapq.merge(odometry, seen, key=itemgetter(0)):
        if reading is None:
            writer.odometry(ODOM_TOPIC, ODOM_FRAME, BASE_FRAME, stamp, pose)
            continue
        if isinstance(reading, Cloud):
            writer.cloud(CLOUD_TOPIC, LASER_FRAME, stamp, *reading)
        else:
            writer.scan(
                SCAN_TOPIC,
                LASER_FRAME,
                stamp,
                float(laser.bearings[0]),
                laser.increment,
                reading.planar.ranges,
                range_max=laser.range_max_m,
                time_increment=laser.sweep_s / (len(laser.bearings) - 1),
                scan_time=1.0 / rate_hz,
            )
        stamps.append(stamp)
        poses.append(pose)
        progress.advance()
    return Trajectory(np.array(stamps, dtype=np.int64), np.array(poses, dtype=np.float64))

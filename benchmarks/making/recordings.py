"""Sweeps written as recordings, and trajectories held against what is known of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.data import recording, truth_file
from benchmarks.making.spoiling import Spoiling
from specmap_cli.core.geometry import Pose2, nearest_motion, quaternions_from_rpy
from specmap_cli.core.records import Sweep, Trajectory
from specmap_cli.core.settings import LogConfig
from specmap_cli.evaluation.trajectories import associate, read_relations, relation_errors
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from specmap_cli.maps.text_files import read_tum
from specmap_cli.simulation.simulator import SimulatedTour, stamp_of

Score = Callable[[Trajectory], float]


@dataclass(frozen=True, slots=True)
class Recording:
    """A log to build a map of, and how many metres a trajectory of it is off."""

    log: Path
    score: Score


def simulated(tour: SimulatedTour, spoil: Spoiling, path: Path) -> Recording:
    """A tour of the simulator as it is spoiled; its error is absolute, after the best motion."""
    write((sweep for sweep, _ in tour.scans()), spoil, path)
    stamps = np.array([stamp_of(time) for time in tour.scan_times_s.tolist()])
    return Recording(path, absolute(Trajectory(stamps, tour.truth.at(tour.scan_times_s))))


def recorded(name: str, spoil: Spoiling, path: Path) -> Recording:
    """A real log as it is spoiled: fr079 is held against its relations, others against poses."""
    copied(name, spoil, path)
    relations = truth_file(f"{name}.relations")
    if relations.exists():
        known = read_relations(relations)
        return Recording(path, lambda found: relation_errors(found, known).translation_m.mean)
    return Recording(path, absolute(read_tum(truth_file(f"{name}_corrected.tum"))))


def copied(name: str, spoil: Spoiling, path: Path) -> None:
    """A real log as it is spoiled, of which no truth is known."""
    with open_log([recording(name)]) as log:
        write(SweepStream(log, LogConfig()), spoil, path)


def own_odometry(path: Path) -> Recording:
    """A log whose odometry is known to be right."""
    stamps, poses = [], []
    with open_log([path]) as log:
        for sweep in SweepStream(log, LogConfig()):
            assert sweep.odom_from_base is not None
            stamps.append(sweep.stamp_ns)
            poses.append(sweep.odom_from_base)
    return Recording(path, absolute(Trajectory(np.array(stamps), np.array(poses))))


def absolute(truth: Trajectory) -> Score:
    """Root mean square of the distances to true places, after the best rigid motion."""

    def score(found: Trajectory) -> float:
        rows, at = associate(found.stamps_ns, truth.stamps_ns)
        here, there = found.poses[at, :2], truth.poses[rows, :2]
        return rms(nearest_motion(here, there).apply(here) - there)

    return score


def by_order(truth: Trajectory) -> Score:
    """As `absolute`, for a log whose stamps say nothing: the n-th pose is that of the n-th scan."""

    def score(found: Trajectory) -> float:
        if len(found.poses) != len(truth.poses):
            return float("nan")
        here, there = found.poses[:, :2], truth.poses[:, :2]
        return rms(nearest_motion(here, there).apply(here) - there)

    return score


def rms(away: np.ndarray) -> float:
    """Of the lengths of vectors (n, 2)."""
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def write(sweeps: Iterable[Sweep], spoil: Spoiling, path: Path) -> None:
    """Sweeps as an MCAP file with /scan, /odom where there is odometry, and /tf_static."""
    with LogWriter(path) as writer:
        for number, sweep in enumerate(spoil(sweeps)):
            if not number:
                mount(writer, "laser", sweep.base_from_laser, sweep.stamp_ns)
            write_scan(writer, sweep)


def mount(
    writer: LogWriter, frame: str, base_from_laser: Pose2, stamp_ns: int, roll: float = 0.0
) -> None:
    """Where a laser sits on the robot, and how it is rolled."""
    x, y, theta = base_from_laser
    angles = np.array([[roll], [0.0], [theta]])
    quaternion = quaternions_from_rpy(*angles)[0].tolist()
    writer.static_transform("base_link", frame, (x, y, 0.0), quaternion, stamp_ns)


def write_scan(
    writer: LogWriter, sweep: Sweep, behind_ns: int = 0, *, frame: str = "laser"
) -> None:
    """The odometry and the planar scan of a sweep, so much later; its bearings are even."""
    planar, stamp_ns = sweep.planar, sweep.stamp_ns + behind_ns
    step = float(planar.bearings[-1] - planar.bearings[0]) / (len(planar.bearings) - 1)
    if sweep.odom_from_base is not None:
        writer.odometry("/odom", "odom", "base_link", stamp_ns, sweep.odom_from_base)
    writer.scan(
        "/scan",
        frame,
        stamp_ns,
        float(planar.bearings[0]),
        step,
        planar.ranges,
        range_max=planar.range_max,
    )


def write_turned(log: Path, how: str, path: Path) -> None:
    """A planar log anew: `as it is`, its beams `reversed`, or its laser `upside down`."""
    with open_log([log]) as source, LogWriter(path) as writer:
        for number, sweep in enumerate(SweepStream(source, LogConfig())):
            stamp_ns, planar = sweep.stamp_ns, sweep.planar
            if not number:
                roll = math.pi if how == "upside down" else 0.0
                mount(writer, "laser", sweep.base_from_laser, stamp_ns, roll)
            first, last = float(planar.bearings[0]), float(planar.bearings[-1])
            begin, end, ranges = {
                "as it is": (first, last, planar.ranges),
                "reversed": (last, first, planar.ranges[::-1]),
                "upside down": (-last, -first, planar.ranges[::-1]),
            }[how]
            if sweep.odom_from_base is not None:
                writer.odometry("/odom", "odom", "base_link", stamp_ns, sweep.odom_from_base)
            step = (end - begin) / (len(ranges) - 1)
            writer.scan("/scan", "laser", stamp_ns, begin, step, ranges, range_max=planar.range_max)


def two_lasers(front: SimulatedTour, rear: SimulatedTour, path: Path) -> Recording:
    """Two lasers that take turns on one topic, each in a frame of its own."""
    pairs: Iterator[tuple[tuple[Sweep, Pose2], tuple[Sweep, Pose2]]] = zip(
        front.scans(), rear.scans(), strict=True
    )
    with LogWriter(path) as writer:
        for number, ((ahead, _), (behind, _)) in enumerate(pairs):
            sweep = behind if number % 2 else ahead
            if number < 2:
                mount(writer, f"laser_{number}", sweep.base_from_laser, sweep.stamp_ns)
            write_scan(writer, sweep, frame=f"laser_{number % 2}")
    stamps = np.array([stamp_of(time) for time in front.scan_times_s.tolist()])
    return Recording(path, absolute(Trajectory(stamps, front.truth.at(front.scan_times_s))))


def without_stamps(tour: SimulatedTour, path: Path) -> Recording:
    """A CARMEN log in which every stamp is 0: each line holds its own odometry."""
    with path.open("w", encoding="ascii") as file:
        for sweep, _ in tour.scans():
            ranges = np.where(np.isfinite(sweep.planar.ranges), sweep.planar.ranges, 81.9)
            assert sweep.odom_from_base is not None
            base = sweep.odom_from_base
            laser = base @ sweep.base_from_laser
            words = [f"{value:.2f}" for value in ranges] + [f"{v:.6f}" for v in (*laser, *base)]
            file.write(f"FLASER {len(ranges)} {' '.join(words)} 0.0 robot 0.0\n")
    truth = tour.truth.at(tour.scan_times_s)
    return Recording(path, by_order(Trajectory(np.zeros(len(truth), dtype=np.int64), truth)))

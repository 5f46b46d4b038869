"""The intact recordings: short drives of the simulated robot, as messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    POINT_CLOUD,
    TF_MESSAGE,
    Transform,
    cloud_cdr,
    in_space,
    message_class,
    odometry_cdr,
    scan_cdr,
    transforms_cdr,
    typestore,
)
from specmap_cli.logs.readers.recording import Message
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour

SCAN_TOPIC = "/scan"
_SHIFT_NS = 123_457_000
_LATE_NS = 20_000_000  # a recorder has a scan this long after its stamp
_HEIGHTS_M = (0.0, 0.3, 0.6)  # of the points that stand for a beam in a cloud
_LASER_M = (0.1, 0.0, 0.3)  # where the laser sits on the base


_Sender = Callable[[Sweep], Iterator[Message]]


@dataclass(frozen=True, slots=True)
class Drive:
    """A recording's messages in log time, and the header stamps of its scans in turn."""

    name: str
    messages: tuple[Message, ...]
    stamps_ns: tuple[int, ...]


def plan() -> GridMap:
    """Two rooms above a corridor, 6 m x 5 m."""
    cells = np.full((100, 120), OCCUPIED, dtype=np.uint8)
    for bottom, top, left, right in ((4, 34, 4, 116), (38, 96, 4, 64), (38, 80, 68, 116)):
        cells[bottom:top, left:right] = FREE
    for left in (24, 84):
        cells[34:38, left : left + 18] = FREE
    return GridMap(cells, 0.05)


def options(**changes: float) -> SimulationOptions:
    """The robot of the drives: few beams; no two of its scans are a whole second apart."""
    values: dict[str, float] = {"beams": 30, "rate_hz": 1.9, "range_max_m": 12.0, "seed": 3}
    return SimulationOptions.model_validate({**values, **changes})


def drives() -> tuple[Drive, ...]:
    """The drive recorded by a planar laser, by one with several echoes, and by a 3D lidar."""
    planar = _sweeps(options(max_duration_s=6.0))
    lidar = _sweeps(options(beams=90, max_duration_s=4.5))
    return (
        _drive("planar", planar, _planar_messages),
        _drive("echo", planar, _echo_messages),
        _drive("cloud", lidar, _cloud_messages),
    )


def planar_drive(seconds: float, beams: int) -> Drive:
    """A drive of another length, such as the one from which the map is built."""
    choices = options(max_duration_s=seconds, beams=beams)
    return _drive("planar", _sweeps(choices), _planar_messages)


def _sweeps(choices: SimulationOptions) -> tuple[Sweep, ...]:
    """The sweeps of a tour, none of them stamped with a whole second: mutations make those."""
    tour = simulated_tour(plan(), choices).scans()
    return tuple(replace(sweep, stamp_ns=sweep.stamp_ns + _SHIFT_NS) for sweep, _ in tour)


def _drive(name: str, sweeps: tuple[Sweep, ...], sent_of: _Sender) -> Drive:
    sent = [message for sweep in sweeps for message in sent_of(sweep)]
    first = sweeps[0].stamp_ns
    mounting = transforms_cdr(
        first, [Transform("base_link", "laser", _LASER_M, (0.0, 0.0, 0.0, 1.0))]
    )
    static = Message("/tf_static", TF_MESSAGE, first, mounting)
    return Drive(name, (static, *sent), tuple(sweep.stamp_ns for sweep in sweeps))


def _planar_messages(sweep: Sweep) -> Iterator[Message]:
    """Odometry, then a LaserScan."""
    yield _odometry(sweep)
    planar = sweep.planar
    step = float(planar.bearings[1] - planar.bearings[0])
    data = scan_cdr(
        "laser",
        sweep.stamp_ns,
        float(planar.bearings[0]),
        step,
        planar.ranges,
        range_max=planar.range_max,
    )
    yield Message(SCAN_TOPIC, LASER_SCAN, sweep.stamp_ns + _LATE_NS, data)


def _echo_messages(sweep: Sweep) -> Iterator[Message]:
    """Odometry, then a MultiEchoLaserScan of one echo a beam."""
    odometry, scan = _planar_messages(sweep)
    yield odometry
    single: Any = typestore().deserialize_cdr(scan.data, LASER_SCAN)
    echo = message_class("sensor_msgs/msg/LaserEcho")
    kept = ("header", "angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
    fields = {name: getattr(single, name) for name in (*kept, "range_min", "range_max")}
    ranges = [echo(echoes=np.array([value], dtype=np.float32)) for value in single.ranges]
    message = message_class(MULTI_ECHO)(**fields, ranges=ranges, intensities=[])
    data = bytes(typestore().serialize_cdr(message, MULTI_ECHO))
    yield Message(SCAN_TOPIC, MULTI_ECHO, scan.time_ns, data)


def _cloud_messages(sweep: Sweep) -> Iterator[Message]:
    """The odometry as a transform, then a PointCloud2 with the times of its points."""
    assert sweep.odom_from_base is not None
    place = in_space(sweep.odom_from_base)
    moved = transforms_cdr(sweep.stamp_ns, [Transform("odom", "base_link", *place)])
    yield Message("/tf", TF_MESSAGE, sweep.stamp_ns, moved)
    points = _points(sweep)
    times = np.linspace(0.0, 0.05, len(points))
    data = cloud_cdr("laser", sweep.stamp_ns, points, times)
    yield Message(SCAN_TOPIC, POINT_CLOUD, sweep.stamp_ns + _LATE_NS, data)


def _odometry(sweep: Sweep) -> Message:
    pose = sweep.odom_from_base or Pose2(0.0, 0.0, 0.0)
    data = odometry_cdr("odom", "base_link", sweep.stamp_ns, pose)
    return Message("/odom", ODOMETRY, sweep.stamp_ns, data)


def _points(sweep: Sweep) -> FloatArray:
    """The returns (N, 3) in the laser's frame, each at several heights."""
    hits = sweep.planar.hits()
    columns = [np.column_stack([hits, np.full(len(hits), height)]) for height in _HEIGHTS_M]
    return np.vstack(columns)

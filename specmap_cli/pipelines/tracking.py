"""Scan matching a whole log: every sweep registered in turn, and how it went."""

from __future__ import annotations

import math
from array import array
from collections.abc import Generator, Mapping
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.records import PosedScan, Trajectory
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.core.text import counted
from specmap_cli.logs.planar import Repeats
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.session import Stopwatch
from specmap_cli.registration.frontend import FrontEnd

_NOWHERE = (math.nan, math.nan, math.nan)


class TrajectoryRecorder:
    """Collects the pose of every registered scan."""

    def __init__(self) -> None:
        self._stamps = array("q")
        self._poses = array("d")
        self._tilt = array("d")
        self._lost = array("b")
        self._odometry = array("d")

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, scan: PosedScan) -> None:
        """Add one scan; z, roll and pitch are kept once a 3D pose has been seen."""
        self._stamps.append(scan.stamp_ns)
        self._poses.extend(scan.map_from_base)
        self._lost.append(scan.lost)
        self._odometry.extend(scan.odom_from_base or _NOWHERE)
        if scan.map_from_base_3d is not None:
            self._tilt.extend([0.0] * (3 * (len(self) - 1) - len(self._tilt)))
            m = scan.map_from_base_3d
            roll = np.arctan2(m[2, 1], m[2, 2])
            pitch = np.arctan2(-m[2, 0], np.hypot(m[2, 1], m[2, 2]))
            self._tilt.extend((float(m[2, 3]), float(roll), float(pitch)))

    def trajectory(self) -> Trajectory:
        """What has been recorded so far, as arrays."""
        tilt = None
        if self._tilt:
            tilt = np.zeros((len(self), 3))
            tilt.reshape(-1)[: len(self._tilt)] = self._tilt
        return Trajectory(
            stamps_ns=np.array(self._stamps, dtype=np.int64),
            poses=np.array(self._poses, dtype=np.float64).reshape(-1, 3),
            tilt=tilt,
            lost=np.array(self._lost, dtype=np.bool_),
            odometry=np.array(self._odometry, dtype=np.float64).reshape(-1, 3),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """What reading and registration have to tell at the end of a log.

    `counts` are of messages and of scans, `seconds` those of registration alone.
    """

    counts: Mapping[str, int]
    warnings: tuple[str, ...]
    seconds: float


def track(stream: SweepStream, config: RegistrationConfig) -> Generator[PosedScan, None, Tracking]:
    """Yield every scan of a log with its pose; return how it went.

    Scans that a hanging driver repeats say nothing of where the robot is: they are left out.
    """
    front_end, clock, repeats = FrontEnd(config), Stopwatch(), Repeats()
    stale = 0
    for sweep in stream:
        if repeats.stale(sweep):
            stale += 1
            continue
        with clock.stage("registration"):
            scans = front_end.take(sweep)
        yield from scans
    yield from front_end.rest()
    hung = [
        f"{counted(stale, 'scan')} repeat the one before although odometry says that the robot "
        "moved, and were left out: the driver of the laser hung"
    ]
    return Tracking(
        counts={
            **{**stream.counts, **front_end.counts, "stale_scans": stale},
            "damage": len(stream.log.damage),
        },
        warnings=(*stream.warnings, *(hung if stale else ()), *front_end.warnings),
        seconds=clock.seconds.get("registration", 0.0),
    )

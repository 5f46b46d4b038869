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
from specmap_cli.logs.planar import HUNG, Repeats
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.session import Stopwatch
from specmap_cli.registration.frontend import FrontEnd

_NOWHERE = (math.nan, math.nan, math.nan)


class TrajectoryRecorder:
    """Collects the pose of every registered scan."""

    def __init__(self) -> None:
        self._stamps = array("q")
        self._rows = array("d")  # of each scan: its pose, that by odometry, tilt, whether lost
        self._tilted = False

    def append(self, scan: PosedScan) -> None:
        """Add one scan; z, roll and pitch are kept once a 3D pose has been seen."""
        tilt = (0.0, 0.0, 0.0)
        if scan.map_from_base_3d is not None:
            m, self._tilted = scan.map_from_base_3d, True
            roll = np.arctan2(m[2, 1], m[2, 2])
            pitch = np.arctan2(-m[2, 0], np.hypot(m[2, 1], m[2, 2]))
            tilt = (float(m[2, 3]), float(roll), float(pitch))
        odometry = scan.odom_from_base or _NOWHERE
        self._stamps.append(scan.stamp_ns)
        self._rows.extend((*scan.map_from_base, *odometry, *tilt, scan.lost))

    def trajectory(self) -> Trajectory:
        """What has been recorded so far, as arrays."""
        rows = np.array(self._rows, dtype=np.float64).reshape(-1, 10)
        poses, odometry, tilt, lost = map(np.copy, np.split(rows, [3, 6, 9], axis=1))
        return Trajectory(
            stamps_ns=np.array(self._stamps, dtype=np.int64),
            poses=poses,
            tilt=tilt if self._tilted else None,
            lost=lost[:, 0] > 0.0,
            odometry=odometry,
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
    hung = [HUNG.format(counted(stale, "scan"))] if stale else []
    return Tracking(
        counts={
            **{**stream.counts, **front_end.counts, "stale_scans": stale},
            "damage": len(stream.log.damage),
        },
        warnings=(*stream.warnings, *hung, *front_end.warnings),
        seconds=clock.seconds.get("registration", 0.0),
    )

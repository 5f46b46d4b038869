"""What the verdict on a map rests on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from specmap_cli.core.findings import Place, Severity
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Trajectory
from specmap_cli.layout.audit import Audit
from specmap_cli.layout.relaxation import Layout

HoleKind = Literal["missing", "lost", "rest"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Hole:
    """A hole in what is known, `seconds` long, before row `row` of the trajectory.

    Scans were `missing` meanwhile, or `lost`, or the map had the robot at `rest` while odometry
    drove on. `keyframe` is the first one after it. `measured` is the motion of the base by
    odometry, None where nothing measured it. `apart` is the motion by odometry seen from that of
    the map, or without odometry that of a robot at rest. `alike` is the share of the walls seen
    from the keyframe that lie where walls were seen before the hole.
    """

    row: int
    keyframe: int
    seconds: float
    measured: Pose2 | None
    apart: Pose2
    alike: float
    kind: HoleKind = "missing"


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What is known of a map besides the map.

    `trajectory` is that of all scans in the finished layout, `keyframes_ns` the stamps of the
    keyframes, `breaks` the numbers of those at which tracking started afresh. `beyond` of them did
    not fit into the largest grid allowed. `warnings` are of reading and registration, `holes` those
    of the recording.
    """

    trajectory: Trajectory
    keyframes_ns: tuple[int, ...]
    breaks: tuple[int, ...]
    layout: Layout
    audit: Audit
    beyond: int
    warnings: tuple[str, ...]
    holes: tuple[Hole, ...] = ()

    def place_of(self, keyframe: int) -> Place:
        """Where a keyframe lies in the map."""
        x, y, _ = self.layout.poses[keyframe].tolist()
        return x, y

    @property
    def measured(self) -> np.ndarray:
        """(n,) which scans of the trajectory have odometry."""
        odometry = self.trajectory.odometry
        if odometry is None:
            return np.zeros(len(self.trajectory.poses), dtype=np.bool_)
        return np.asarray(np.isfinite(odometry[:, 0]))


def place_at(trajectory: Trajectory, row: int) -> Place:
    """Where a scan lies in the map."""
    x, y, _ = trajectory.poses[row].tolist()
    return x, y


def graded(value: float, doubtful: float, poor: float) -> tuple[Severity, float]:
    """How grave a value is by the limits that it passes, and the limit that counts."""
    if value > poor:
        return "poor", poor
    return ("doubtful" if value > doubtful else "note"), doubtful

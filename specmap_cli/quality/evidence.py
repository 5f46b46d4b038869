"""What the verdict on a map rests on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.findings import Place, Severity
from specmap_cli.core.records import Trajectory
from specmap_cli.layout.audit import Audit
from specmap_cli.layout.relaxation import Layout


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What is known of a map besides the map.

    `trajectory` is that of all scans in the finished layout, `keyframes_ns` the stamps of the
    keyframes, `breaks` the numbers of those at which tracking started afresh. `beyond` of them did
    not fit into the largest grid allowed. `warnings` are of reading and registration.
    """

    trajectory: Trajectory
    keyframes_ns: tuple[int, ...]
    breaks: tuple[int, ...]
    layout: Layout
    audit: Audit
    beyond: int
    warnings: tuple[str, ...]

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

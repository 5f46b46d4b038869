"""What a registration method is: it holds the points of the last keyframes and aligns new ones.

The front end does the rest: it guesses, aligns with ever narrower kernels, refuses what ran off,
searches where the score is low, and judges. `methods.py` says how a package adds a method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig

WINDOW_KEYFRAMES = 80  # keyframes in the local map
REBUILD_KEYFRAMES = 4  # keyframes between rebuilds of the voxels, which forget older ones


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorKind:
    """What is registered: a planar scan, whose points have z = 0, or a 3D lidar's whole cloud.

    `voxel_m` is the cell of the local map, `range_m` how far its points can be from the robot.
    """

    in_space: bool
    voxel_m: float
    range_m: float

    @classmethod
    def of(cls, sweep: Sweep, config: RegistrationConfig) -> SensorKind:
        """The kind of sensor that took a sweep."""
        if sweep.cloud is None:
            return cls(in_space=False, voxel_m=config.voxel_m, range_m=config.max_range_m)
        return cls(in_space=True, voxel_m=config.cloud_voxel_m, range_m=config.cloud_range_m)


class Aligner(Protocol):
    """A registration method with a local map of its own; map and poses share one frame."""

    def insert(self, points: FloatArray, map_from_base: FloatArray) -> None:
        """Add a keyframe: points (N, 3) of the base frame seen from a pose (4, 4).

        The map holds the last `WINDOW_KEYFRAMES` of them; older ones must leave it soon.
        """

    def clear(self) -> None:
        """Forget all keyframes."""

    def align(
        self, points: FloatArray, guess: FloatArray, kernel_m: float, *, coarse: bool
    ) -> FloatArray:
        """The pose `map_from_base` (4, 4) near `guess` (4, 4) at which points (N, 3) fit the map.

        `kernel_m` is the width of the robust kernel: residuals well below it count in full, those
        well above it hardly. A `coarse` alignment is followed by finer ones, and may stop early.
        It is called with a map of one keyframe at the least, and must not change its arguments.
        The front end refuses a result that is not finite or runs off.
        """


AlignerFactory = Callable[[RegistrationConfig, SensorKind], Aligner]

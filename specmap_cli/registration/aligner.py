"""Registration methods: they hold the points of the last keyframes, and align new ones to them.

The front end does the rest: it guesses, aligns with ever narrower kernels, refuses what ran off,
searches where the score is low, and judges. KISS-ICP is built in: Vizzo et al., "KISS-ICP: In
Defense of Point-to-Point ICP" (RA-L 2023). Its voxel map and its registration are used directly.
Its package is imported when an aligner is made, nowhere else in specmap.

A package offers another method by an entry point in its own pyproject.toml. Its name is then a
value of the setting `registration.method`::

    [project.entry-points."specmap.registration"]
    my-icp = "my_package.icp:MyAligner"

It names a class whose constructor takes the settings and the kind of sensor (`AlignerFactory`), or
a function that takes the same and returns an `Aligner`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from specmap_cli.core.errors import PACKAGE, SETTING, UsageError
from specmap_cli.core.geometry import FloatArray, product
from specmap_cli.core.plugins import with_plugins
from specmap_cli.core.settings import RegistrationConfig

WINDOW_KEYFRAMES = 80  # keyframes in the local map
REBUILD_KEYFRAMES = 4  # keyframes between rebuilds of the voxels, which forget older ones
GROUP = "specmap.registration"  # of entry points

_POINTS_PER_VOXEL = 10  # most points kept in a voxel of planar scans
_CLOUD_POINTS_PER_VOXEL = 20  # most points kept in a voxel of 3D clouds
_ITERATIONS = 50  # of the registration, per kernel
_CONVERGED = 1e-4  # KISS-ICP's own: steps below it, metres and radians, end the iterations
# Enough for a coarse alignment, which is aligned again; and in space, where thousands of points in
# larger voxels average more.
_NEARLY_CONVERGED = 1e-3
_GATE_KERNELS = 3.0  # points farther from the map than so many kernels have no match (its tau)
_KEPT_RANGES = 2.0  # its map reaches this many sensor ranges; the window forgets long before


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorKind:
    """What is registered: a planar scan, whose points have z = 0, or a 3D lidar's whole cloud.

    `voxel_m` is the cell of the local map, `range_m` how far its points can be from the robot.
    """

    in_space: bool
    voxel_m: float
    range_m: float


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


class KissIcpAligner:
    """The points of the last keyframes in KISS-ICP's voxel map, in the map frame.

    The voxels are rebuilt every few keyframes, so that old passes and bad scans leave them again:
    met after some drift they would bend the trajectory.
    """

    def __init__(self, _config: RegistrationConfig, sensor: SensorKind) -> None:
        try:
            from kiss_icp.pybind import kiss_icp_pybind as kiss_icp  # its settings load slowly
        except ImportError as error:
            raise UsageError(
                f"registration.method 'kiss-icp' needs the package kiss-icp: {error}",
                "install it or choose another method",
                mark=";",
                code=PACKAGE,
            ) from error
        # one thread: the sums of several would come in another order at every run
        converged = _NEARLY_CONVERGED if sensor.in_space else _CONVERGED
        self._fine = kiss_icp._Registration(_ITERATIONS, converged, 1)
        self._coarse = kiss_icp._Registration(_ITERATIONS, _NEARLY_CONVERGED, 1)
        reach_m = _KEPT_RANGES * sensor.range_m
        most = _CLOUD_POINTS_PER_VOXEL if sensor.in_space else _POINTS_PER_VOXEL
        self._voxels = kiss_icp._VoxelHashMap(sensor.voxel_m, reach_m, most)
        self._vectors = kiss_icp._Vector3dVector
        self._clouds: deque[FloatArray] = deque(maxlen=WINDOW_KEYFRAMES)
        self._inserted = 0

    def insert(self, points: FloatArray, map_from_base: FloatArray) -> None:
        """Add a keyframe: points (N, 3) of the base frame seen from a pose (4, 4)."""
        placed = product(points, map_from_base[:3, :3].T) + map_from_base[:3, 3]
        self._clouds.appendleft(placed)
        if self._inserted % REBUILD_KEYFRAMES == 0:
            self._voxels._clear()
            placed = np.concatenate(self._clouds)  # the newest first: a full voxel takes no more
        self._voxels._add_points(self._vectors(placed))
        self._inserted += 1

    def clear(self) -> None:
        """Forget all keyframes."""
        self._clouds.clear()
        self._voxels._clear()
        self._inserted = 0

    def align(
        self, points: FloatArray, guess: FloatArray, kernel_m: float, *, coarse: bool
    ) -> FloatArray:
        """The pose (4, 4) near a guess at which points (N, 3) fit the map."""
        method = self._coarse if coarse else self._fine
        gate_m = _GATE_KERNELS * kernel_m
        pose: FloatArray = method._align_points_to_map(
            self._vectors(points), self._voxels, guess, gate_m, kernel_m
        )
        return pose


BUILT_IN: Mapping[str, AlignerFactory] = {"kiss-icp": KissIcpAligner}


def aligner_factory(name: str) -> AlignerFactory:
    """The registration method of a name; UsageError when there is none."""
    methods = with_plugins(GROUP, BUILT_IN)
    if name not in methods:
        raise UsageError(
            f"no such method {name!r}",
            f"choose from {', '.join(methods)}, or install the package that offers it",
            where="registration.method",
            code=SETTING,
        )
    return methods[name]

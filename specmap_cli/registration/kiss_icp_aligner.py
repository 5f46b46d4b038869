"""KISS-ICP behind the front end: its point-to-point registration on its voxel map.

Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP" (RA-L 2023). Its voxel map and its
registration are used directly; motion prediction, thresholds and de-skewing are the front end's.
The package kiss-icp is imported when an aligner is made, nowhere else in specmap.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from specmap_cli.core.errors import PACKAGE, UsageError
from specmap_cli.core.geometry import FloatArray, product
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.aligner import REBUILD_KEYFRAMES, WINDOW_KEYFRAMES, SensorKind

_POINTS_PER_VOXEL = 10  # most points kept in a voxel of planar scans
_CLOUD_POINTS_PER_VOXEL = 20  # most points kept in a voxel of 3D clouds
_ITERATIONS = 50  # of the registration, per kernel
_CONVERGED = 1e-4  # KISS-ICP's own: steps below it, metres and radians, end the iterations
_CONVERGED_IN_SPACE = 5e-4  # in voxels of twice the size, and thousands of points average more
_NEARLY_CONVERGED = 1e-3  # enough for a coarse alignment, whose result is aligned again
_GATE_KERNELS = 3.0  # points farther from the map than so many kernels have no match (its tau)
_KEPT_RANGES = 2.0  # its map reaches this many sensor ranges; the window forgets long before


class KissIcpAligner:
    """The points of the last keyframes in KISS-ICP's voxel map, in the map frame.

    The voxels are rebuilt every few keyframes, so that old passes and bad scans leave them again:
    met after some drift they would bend the trajectory.
    """

    def __init__(self, _config: RegistrationConfig, sensor: SensorKind) -> None:
        try:
            from kiss_icp.mapping import VoxelHashMap
            from kiss_icp.registration import Registration
        except ImportError as error:
            raise UsageError(
                f"registration.method 'kiss-icp' needs the package kiss-icp: {error}; install it "
                "or choose another method",
                code=PACKAGE,
            ) from error
        # one thread: the sums of several would come in another order at every run
        converged = _CONVERGED_IN_SPACE if sensor.in_space else _CONVERGED
        self._fine = Registration(_ITERATIONS, converged, max_num_threads=1)
        self._coarse = Registration(_ITERATIONS, _NEARLY_CONVERGED, max_num_threads=1)
        reach_m = _KEPT_RANGES * sensor.range_m
        most = _CLOUD_POINTS_PER_VOXEL if sensor.in_space else _POINTS_PER_VOXEL
        self._voxels = VoxelHashMap(sensor.voxel_m, reach_m, most)
        self._clouds: deque[FloatArray] = deque(maxlen=WINDOW_KEYFRAMES)
        self._inserted = 0

    def insert(self, points: FloatArray, map_from_base: FloatArray) -> None:
        """Add a keyframe: points (N, 3) of the base frame seen from a pose (4, 4)."""
        placed = product(points, map_from_base[:3, :3].T) + map_from_base[:3, 3]
        self._clouds.appendleft(placed)
        if self._inserted % REBUILD_KEYFRAMES == 0:
            self._voxels.clear()
            placed = np.concatenate(self._clouds)  # the newest first: a full voxel takes no more
        self._voxels.add_points(placed)
        self._inserted += 1

    def clear(self) -> None:
        """Forget all keyframes."""
        self._clouds.clear()
        self._voxels.clear()
        self._inserted = 0

    def align(
        self, points: FloatArray, guess: FloatArray, kernel_m: float, *, coarse: bool
    ) -> FloatArray:
        """The pose (4, 4) near a guess at which points (N, 3) fit the map."""
        method = self._coarse if coarse else self._fine
        gate_m = _GATE_KERNELS * kernel_m
        pose: FloatArray = method.align_points_to_map(points, self._voxels, guess, gate_m, kernel_m)
        return pose

"""What a laser would measure at many poses, all rays cast at once: a tenth of the time."""

from collections.abc import Iterable

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.gridmap import GridMap, cast_rays
from specmap_cli.grids.keyframes import KeyframeStore


def ranges_at(plan: GridMap, poses: FloatArray, bearings: FloatArray, reach: float) -> FloatArray:
    """Ranges (n, B) from poses (n, 3) of the laser along bearings (B,), +inf past `reach`."""
    origins = np.repeat(poses[:, :2], len(bearings), axis=0)
    angles = (poses[:, 2:] + bearings).ravel()
    ranges = cast_rays(plan.obstacle_distance(), plan, origins, angles, reach)
    return ranges.reshape(len(poses), len(bearings))


def keyframe(
    scan: PlanarScan, pose: Pose2, base_from_laser: Pose2 = IDENTITY, number: int = 0
) -> PosedScan:
    """A scan as it was registered at a pose."""
    return PosedScan(
        index=number,
        stamp_ns=scan.stamp_ns,
        map_from_base=pose,
        planar=scan,
        base_from_laser=base_from_laser,
    )


def store_of(scans: Iterable[PosedScan]) -> KeyframeStore:
    """A store of keyframes in their order."""
    store = KeyframeStore()
    for scan in scans:
        store.append(scan)
    return store

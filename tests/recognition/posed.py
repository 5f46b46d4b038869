"""Scans at poses, and plans as a robot maps them: walls that it saw, and nothing behind them."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import NO_SUBMAP, PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.recognition.learning.calibration import HeldOutMisfit
from specmap_cli.recognition.localization.walls import MapWalls


def posed(
    planar: PlanarScan,
    map_from_base: Pose2,
    number: int = 0,
    base_from_laser: Pose2 = IDENTITY,
    **more: Any,
) -> PosedScan:
    """A scan at a pose; `number` is its place in the log."""
    return PosedScan(
        index=number,
        stamp_ns=number,
        map_from_base=map_from_base,
        planar=planar,
        base_from_laser=base_from_laser,
        **more,
    )


def scanned(plan: GridMap) -> GridMap:
    """The plan without what lies deeper in its walls than two cells."""
    near = cv2.dilate(plan.free.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    cells = np.where(plan.free, FREE, np.where(near & plan.occupied, OCCUPIED, UNKNOWN))
    return GridMap(cells.astype(np.uint8), plan.resolution, plan.origin)


def walls_of(
    plan: GridMap,
    owner: NDArray[Any] | None = None,
    misfit: HeldOutMisfit | None = None,
    submaps: Mapping[int, slice] | None = None,
) -> MapWalls:
    """The walls of a plan, of which `owner` (H, W), or some columns, are of submaps; 0 without."""
    grid = scanned(plan)
    if owner is None:
        owner = np.full(grid.cells.shape, NO_SUBMAP if submaps else 0)
        for id_, columns in (submaps or {}).items():
            owner[:, columns] = id_
    return MapWalls(grid, owner, misfit, LocalizationConfig())

"""An existing occupancy grid divided into submaps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, CellArray, GridMap
from specmap_cli.segmentation.division import Segmentation, segment

__all__ = [
    "FloorplanResult",
    "FloorplanSubmap",
    "segment_floorplan",
    "submap_grid",
]

_WALL_CELLS = 2  # obstacles this near belong to the picture of a region: a wall drawn in cells
_OUTLINE_CELLS = 1.5  # how far a polygon may stray from the outline: the steps of a slanted wall


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorplanSubmap:
    """A region: `polygon` (N, 2) its outer outline and `centroid`, in metres of the map."""

    id: int
    polygon: FloatArray
    area_m2: float
    centroid: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorplanResult:
    """A divided map: submaps by id 0, 1, ... (falling area)."""

    grid: GridMap
    segmentation: Segmentation
    submaps: tuple[FloorplanSubmap, ...]


def segment_floorplan(grid: GridMap, config: SegmentationConfig) -> FloorplanResult:
    """Divide `grid` and describe the regions; NoResultError when no free space holds a node."""
    found = _in_one_piece(segment(grid, config))
    if not found.count:
        raise NoResultError(
            f"no free space wider than {2 * config.clearance_m:g} m in the map "
            f"({grid.free_area_m2:.1f} m2 free): check the resolution and the thresholds"
        )
    return FloorplanResult(
        grid=grid,
        segmentation=found,
        submaps=tuple(_submap(grid, found.labels == id_, id_) for id_ in range(found.count)),
    )


def _in_one_piece(found: Segmentation) -> Segmentation:
    """Regions without scraps: of each only its largest connected piece stays labelled."""
    labels = np.full_like(found.labels, -1)
    for label, window in enumerate(ndimage.find_objects(found.labels + 1)):
        if window is not None:
            mine = (found.labels[window] == label).astype(np.uint8)
            _, piece, stats, _ = cv2.connectedComponentsWithStats(mine, connectivity=8)
            largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
            labels[window][piece == largest] = label
    return replace(found, labels=labels)


def submap_grid(result: FloorplanResult, submap: int) -> GridMap:
    """The region of one submap with the obstacles round it, cropped; the rest is unknown."""
    grid = result.grid
    region = result.segmentation.labels == submap
    reach = np.ones((2 * _WALL_CELLS + 1, 2 * _WALL_CELLS + 1), dtype=np.uint8)
    shown = cv2.dilate(region.astype(np.uint8), reach).astype(bool)
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    cells: CellArray = np.full(grid.cells.shape, UNKNOWN, dtype=np.uint8)
    cells[shown & (grid.cells == OCCUPIED)] = OCCUPIED
    cells[region & (grid.cells == FREE)] = FREE
    return GridMap(cells, grid.resolution, grid.origin).window(*window)


def _submap(grid: GridMap, region: BoolArray, number: int) -> FloorplanSubmap:
    cells = np.argwhere(region)
    x, y = grid.centres_of(cells).mean(axis=0)
    outlines, _ = cv2.findContours(
        region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    outer = max(outlines, key=lambda outline: (cv2.contourArea(outline), len(outline)))
    corners = cv2.approxPolyDP(outer, _OUTLINE_CELLS, closed=True)[:, 0, ::-1]
    area = len(cells) * grid.resolution**2
    return FloorplanSubmap(
        id=number,
        polygon=grid.centres_of(corners),
        area_m2=area,
        centroid=(float(x), float(y)),
    )

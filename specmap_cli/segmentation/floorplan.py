"""An existing occupancy grid divided into submaps: regions, and the doorways where they touch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, CellArray, GridMap
from specmap_cli.segmentation.borders import contacts
from specmap_cli.segmentation.division import Segmentation, segment
from specmap_cli.segmentation.kmeans import LabelArray

__all__ = [
    "Doorway",
    "FloorplanEdge",
    "FloorplanResult",
    "FloorplanSubmap",
    "label_image",
    "segment_floorplan",
    "submap_grid",
]

_WALL_CELLS = 2  # obstacles this near belong to the picture of a region: a wall drawn in cells
_OUTLINE_CELLS = 1.5  # how far a polygon may stray from the outline: the steps of a slanted wall
_JOINED_HALF_CELLS = 2  # border points this near are one doorway: a diagonal border has such gaps


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorplanSubmap:
    """A region: `polygon` (N, 2) its outer outline and `centroid`, in metres of the map."""

    id: int
    polygon: FloatArray
    area_m2: float
    centroid: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Doorway:
    """A stretch of common border: its middle in metres of the map, and its width."""

    x: float
    y: float
    width_m: float


@dataclass(frozen=True, slots=True)
class FloorplanEdge:
    """Two regions that touch, `source` < `target`, and where: the widest doorway first."""

    source: int
    target: int
    doorways: tuple[Doorway, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorplanResult:
    """A divided map: submaps by id 0, 1, ... (falling area) and the edges in order."""

    grid: GridMap
    segmentation: Segmentation
    submaps: tuple[FloorplanSubmap, ...]
    edges: tuple[FloorplanEdge, ...]


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
        edges=_edges(grid, found.labels, config.door_min_m),
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


def label_image(result: FloorplanResult) -> NDArray[np.uint16]:
    """(H, W) submap id + 1, 0 unlabelled, as a picture: its top row is the map's highest y.

    Raises NoResultError when there are more regions than 16 bits count.
    """
    if len(result.submaps) >= 2**16:
        raise NoResultError(f"{len(result.submaps)} regions do not fit a 16-bit picture")
    return np.ascontiguousarray(result.segmentation.labels[::-1] + 1).astype(np.uint16)


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


def _edges(grid: GridMap, labels: LabelArray, narrowest: float) -> tuple[FloorplanEdge, ...]:
    """An edge for each two labels side by side along `narrowest` metres at the least."""
    touching = contacts(labels)
    middles = (touching.one + touching.other) / 2.0
    edges = []
    for source, target in np.unique(touching.labels, axis=0).tolist():
        border = middles[(touching.labels == (source, target)).all(axis=1)]
        doorways = tuple(door for door in _doorways(grid, border) if door.width_m >= narrowest)
        if doorways:
            edges.append(FloorplanEdge(source, target, doorways))
    return tuple(edges)


def _doorways(grid: GridMap, points: FloatArray) -> list[Doorway]:
    """The connected stretches of a border given by points (m, 2) between cells, widest first."""
    spots = np.rint(points * 2.0).astype(np.intp)
    low = spots.min(axis=0)
    picture = np.zeros(spots.max(axis=0) - low + 1, dtype=np.uint8)
    picture[tuple((spots - low).T)] = 1
    side = 2 * _JOINED_HALF_CELLS + 1
    joined = cv2.dilate(picture, np.ones((side, side), dtype=np.uint8))
    count, pieces = cv2.connectedComponents(joined, connectivity=8)
    piece = pieces[tuple((spots - low).T)]
    found = []
    for number in range(1, count):
        stretch = points[piece == number]
        x, y = grid.centres_of(stretch).mean(axis=0)
        sides = cv2.minAreaRect(stretch.astype(np.float32))[1]
        found.append(Doorway(float(x), float(y), (max(sides) + 1.0) * grid.resolution))
    return sorted(found, key=lambda door: (-door.width_m, door.x, door.y))

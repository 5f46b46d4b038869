"""An existing occupancy grid divided into submaps: regions, and the doorways where they touch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from specmap_cli.core.config import SegmentationConfig
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, CellArray, GridMap
from specmap_cli.segmentation.kmeans import LabelArray
from specmap_cli.segmentation.spectral import Segmentation, segment

__all__ = [
    "Doorway",
    "FloorplanEdge",
    "FloorplanResult",
    "FloorplanSubmap",
    "label_image",
    "segment_floorplan",
    "submap_grid",
]

_WALL_CELLS = 2  # obstacles this near belong to the picture of a region
_OUTLINE_CELLS = 1.5  # how far a polygon may stray from the outline it simplifies


@dataclass(frozen=True, slots=True)
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
    doorways: list[Doorway]


@dataclass(frozen=True, slots=True)
class FloorplanResult:
    """A divided map: submaps by id 0, 1, ... (falling area) and the edges in order."""

    grid: GridMap
    segmentation: Segmentation
    submaps: list[FloorplanSubmap]
    edges: list[FloorplanEdge]


def segment_floorplan(grid: GridMap, config: SegmentationConfig) -> FloorplanResult:
    """Divide `grid` and describe the regions; NoResultError when no free space holds a node."""
    found = _in_one_piece(segment(grid, config))
    if not found.count:
        raise NoResultError(
            f"no free space wider than {2 * config.clearance_m:g} m in the map "
            f"({grid.free_area_m2:.1f} m2 free): check the resolution and the thresholds"
        )
    submaps = [_submap(grid, found.labels == label, label) for label in range(found.count)]
    return FloorplanResult(grid, found, submaps, _edges(grid, found.labels, config.door_min_m))


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
    """(H, W) submap id + 1, 0 unlabelled, as a picture: its top row is the map's highest y."""
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
    x, y = grid.origin
    corner = (x + int(columns[0]) * grid.resolution, y + int(rows[0]) * grid.resolution)
    return GridMap(cells[window].copy(), grid.resolution, corner)


def _submap(grid: GridMap, region: BoolArray, number: int) -> FloorplanSubmap:
    cells = np.argwhere(region)
    x, y = grid.centres_of(cells).mean(axis=0)
    outlines, _ = cv2.findContours(
        region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    outer = max(outlines, key=lambda outline: (cv2.contourArea(outline), len(outline)))
    corners = cv2.approxPolyDP(outer, _OUTLINE_CELLS, closed=True)[:, 0, ::-1]
    area = len(cells) * grid.resolution**2
    return FloorplanSubmap(number, grid.centres_of(corners), area, (float(x), float(y)))


def _edges(grid: GridMap, labels: LabelArray, narrowest: float) -> list[FloorplanEdge]:
    """An edge for each two labels side by side along `narrowest` metres at the least."""
    pairs, middles = _border(labels)
    keys, which = np.unique(pairs, axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    stretches = np.split(middles[order], np.cumsum(np.bincount(which.ravel()))[:-1])
    edges = []
    for (source, target), points in zip(keys.tolist(), stretches, strict=False):
        doorways = [door for door in _doorways(grid, points) if door.width_m >= narrowest]
        if doorways:
            edges.append(FloorplanEdge(source, target, doorways))
    return edges


def _border(labels: LabelArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Pairs of different labels side by side (m, 2) and the rows, columns between them (m, 2)."""
    pairs, middles = [], []
    for one, other, step in (
        (labels[:-1], labels[1:], (0.5, 0.0)),
        (labels[:, :-1], labels[:, 1:], (0.0, 0.5)),
    ):
        cells = np.argwhere((one != other) & (one >= 0) & (other >= 0))
        at = tuple(cells.T)
        pairs.append(np.sort(np.column_stack([one[at], other[at]]), axis=1))
        middles.append(cells + step)
    return np.concatenate(pairs).astype(np.int64), np.concatenate(middles)


def _doorways(grid: GridMap, points: FloatArray) -> list[Doorway]:
    """The connected stretches of a border given by points (m, 2) between cells, widest first."""
    spots = np.rint(points * 2.0).astype(np.intp)
    low = spots.min(axis=0)
    picture = np.zeros(spots.max(axis=0) - low + 1, dtype=np.uint8)
    picture[tuple((spots - low).T)] = 1
    joined = cv2.dilate(picture, np.ones((5, 5), dtype=np.uint8))
    count, pieces = cv2.connectedComponents(joined, connectivity=8)
    piece = pieces[tuple((spots - low).T)]
    found = []
    for number in range(1, count):
        stretch = points[piece == number]
        x, y = grid.centres_of(stretch).mean(axis=0)
        sides = cv2.minAreaRect(stretch.astype(np.float32))[1]
        found.append(Doorway(float(x), float(y), (max(sides) + 1.0) * grid.resolution))
    return sorted(found, key=lambda door: (-door.width_m, door.x, door.y))

"""Which submap each cell of the whole map belongs to.

The grids of neighbouring submaps overlap: each robot saw through the door into the other. A cell
that several grids call free belongs to the submap whose keyframes came nearest to it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from specmap_cli.gridmap import FREE, UNKNOWN, BoolArray, GridMap
from specmap_cli.outputs.grids import warp
from specmap_cli.outputs.shape import NOTHING, Outline, outline_of
from specmap_cli.outputs.tables import Labels
from specmap_cli.records import IntArray
from specmap_cli.topomap import Submap

OwnerArray = NDArray[np.signedinteger[Any]]

NOBODY = -1
_FAR = np.float32(1e6)


@dataclass(frozen=True, slots=True)
class Regions:
    """The map divided: `owner` (H, W) is the submap id of each free cell of `grid`, or NOBODY.

    `outlines` are the shapes of the regions in the map frame, by id; a submap that owns no cell has
    none.
    """

    grid: GridMap
    owner: OwnerArray
    outlines: dict[int, Outline]

    @classmethod
    def of(cls, grid: GridMap, owner: OwnerArray) -> Regions:
        """The regions with their outlines."""
        outlines = {}
        for id_, window in enumerate(ndimage.find_objects(owner + 1)):
            if window is not None:
                rows, columns = window
                x, y = np.array([columns.start, rows.start]) * grid.resolution + grid.origin
                part = GridMap(grid.cells[window], grid.resolution, (float(x), float(y)))
                outlines[id_] = outline_of(owner[window] == id_, part)
        return cls(grid, owner, outlines)

    def outline(self, submap: int) -> Outline:
        """The outline of one region, that of nothing for a submap without a cell."""
        return self.outlines.get(submap, NOTHING)


def divide(whole: GridMap, submaps: Iterable[Submap], labels: Labels) -> Regions:
    """Give each free cell of `whole` to a submap that saw it, the one with the nearest keyframe."""
    owner = np.full(whole.cells.shape, NOBODY, dtype=np.int32)
    nearest = np.full(whole.cells.shape, np.inf, dtype=np.float32)
    for submap in sorted(submaps, key=lambda submap: submap.id):
        window, cells = warp(submap.grid.cells, submap.grid, submap.map_from_submap, whole, UNKNOWN)
        if not cells.size:
            continue
        places = whole.cells_of(labels.poses[labels.submaps == submap.id, :2])
        corner = np.array([window[0].start, window[1].start])
        distance = _distance(places - corner, cells.shape)
        seen = (cells == FREE) & (whole.cells[window] == FREE)
        better: BoolArray = seen & (distance < nearest[window])
        owner[window][better] = submap.id
        nearest[window][better] = distance[better]
    return Regions.of(whole, owner)


def _distance(
    places: IntArray, shape: tuple[int, ...]
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """(H, W) cells to the nearest of the places (N, 2) that lie inside; far when none does."""
    inside = ((places >= 0) & (places < shape)).all(axis=1)
    if not inside.any():
        return np.full(shape, _FAR, dtype=np.float32)
    picture = np.ones(shape, dtype=np.uint8)
    picture[places[inside, 0], places[inside, 1]] = 0
    return np.asarray(cv2.distanceTransform(picture, cv2.DIST_L2, 5), dtype=np.float32)

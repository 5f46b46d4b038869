"""Which submap each cell of the whole map belongs to.

The grids of neighbouring submaps overlap: the robot saw through each door from both sides. So a
cell belongs to the submap from which the robot would reach it first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.grids.gridmap import BoolArray, GridMap
from specmap_cli.topology.borders import Line
from specmap_cli.topology.flooding import drawn, flood
from specmap_cli.topology.outlines import NOTHING, Outline, outline_of

OwnerArray = NDArray[np.signedinteger[Any]]

NOBODY = -1
# Half the width of the gaps that a region goes through, that of a small robot, and how far it goes
# past the last of them: across a sill, not down the rays of a laser.
_ROBOT_RADIUS_M, _REACH_M = 0.15, 0.3


@dataclass(frozen=True, slots=True)
class Regions:
    """The map divided: `owner` (H, W) is the submap id of each free cell of `grid`, or NOBODY.

    `outlines` are the shapes of the regions in the map frame, by id; a submap that owns no cell has
    none.
    """

    grid: GridMap
    owner: OwnerArray
    outlines: Mapping[int, Outline]

    @classmethod
    def of(cls, grid: GridMap, owner: OwnerArray) -> Regions:
        """The regions with their outlines."""
        from scipy import ndimage  # takes a fifth of a second to load, and `localize` never asks

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

    def owners(self, points: FloatArray) -> IntArray:
        """(n,) the submap in whose region each point (n, 2 or more) lies, NOBODY outside of all.

        A robot that stands beside the border of a region, by half its width, is still in it.
        """
        nobody = (self.owner == NOBODY).astype(np.uint8)
        away, nearest = cv2.distanceTransformWithLabels(
            nobody, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        owner_of = np.full(int(nearest.max(initial=0)) + 1, NOBODY, dtype=np.int64)
        owner_of[nearest[nobody == 0]] = self.owner[nobody == 0]
        owner_of = np.where(nobody.all(), NOBODY, owner_of)
        cells = self.grid.cells_of(points[:, :2])
        inside = self.grid.inside(cells)
        rows, columns = cells[inside].T
        near = away[rows, columns] * self.grid.resolution <= _ROBOT_RADIUS_M
        owners = np.full(len(points), NOBODY, dtype=np.int64)
        owners[inside] = np.where(near, owner_of[nearest[rows, columns]], NOBODY)
        return owners


def divide(whole: GridMap, labels: Labels, fences: Sequence[Line] = ()) -> Regions:
    """Give each free cell of `whole` to the submap of the keyframe that is nearest on foot.

    The keyframes flood the cells where a robot has room, and from there the free cells, so that
    regions are connected and end at walls, and go through no slit. Cells that a robot could not get
    near, such as those seen through a gap or a window, are nobody's. No region grows across the
    `fences`, lines in the map.
    """
    places = whole.cells_of(labels.poses[:, :2])
    inside = whole.inside(places) & (labels.submaps != NO_SUBMAP)
    rows, columns = places[inside].T
    passable = whole.free
    passable[rows, columns] = True  # where the robot stood, whatever was found there later
    markers = np.zeros(passable.shape, dtype=np.int32)
    markers[rows, columns] = labels.submaps[inside] + 1
    fence = drawn(fences, whole) if fences else None
    roomy = (whole.clearance() >= _ROBOT_RADIUS_M) | (markers > 0)
    entered = _connected(roomy, markers > 0)
    nearest = np.where(entered, flood(entered, markers, fence), 0).astype(np.int32)
    owner = flood(passable, nearest, fence) - 1
    owner[~whole.free | ~_near(entered, passable, whole.resolution) | (owner < 0)] = NOBODY
    return Regions.of(whole, owner)


def _near(entered: BoolArray, passable: BoolArray, resolution: float) -> BoolArray:
    """(H, W) the passable cells within reach of those that a robot could have `entered`."""
    away = cv2.distanceTransform((~entered).astype(np.uint8), cv2.DIST_L2, 5)
    return _connected((away * resolution <= _REACH_M) & passable, entered)


def _connected(cells: BoolArray, seeds: BoolArray) -> BoolArray:
    """(H, W) the parts of `cells` that hold one of the `seeds`."""
    _, parts = cv2.connectedComponents(cells.astype(np.uint8), connectivity=4)
    held = np.zeros(int(parts.max(initial=0)) + 1, dtype=np.bool_)
    held[parts[seeds & cells]] = True
    return np.asarray(held[parts])

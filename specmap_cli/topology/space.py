"""The free space of a divided map, and how wide it is at each cell."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import GridMap, cell_distances, contacts
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions

Pair = tuple[int, int]
Window = tuple[slice, slice]

_JOINED_HALF_CELLS = 2  # border points this near are one border: a diagonal one has such gaps


@dataclass(frozen=True, slots=True)
class Space:
    """The cells of a map: `owner` (H, W) is the submap of each free one, or NOBODY.

    `away` (H, W) are the cells from its centre to the nearest centre of a cell that is not free,
    unknown ones among them; 0 where it is not free itself. `wall_depth` is how deep in its cell the
    surface of a wall lies, in cells, on average: a half where a laser hit it, none in a drawing.
    """

    grid: GridMap
    owner: OwnerArray
    away: FloatArray
    wall_depth: float = 0.0

    @classmethod
    def of(cls, regions: Regions, *, scanned: bool = False) -> Space:
        """The space of the regions of a map, which a laser `scanned`, or somebody drew."""
        free = regions.grid.free
        away = cell_distances(np.pad(free.astype(np.uint8), 1))[1:-1, 1:-1]
        owner = np.where(free, regions.owner, NOBODY)
        return cls(regions.grid, owner, away, 0.5 if scanned else 0.0)

    @property
    def clearance(self) -> FloatArray:
        """(H, W) metres from the centre of a free cell to the side of the nearest one that is not.

        Zero for cells that are not free.
        """
        return np.asarray(np.maximum(self.away - 0.5, 0.0) * self.grid.resolution)

    def place(self, cell: FloatArray | IntArray) -> tuple[float, float]:
        """x and y in the map of a row and a column, which may have fractions."""
        x, y = self.grid.centres_of(np.asarray(cell)[None])[0].tolist()
        return x, y


def windows_of(owner: OwnerArray) -> dict[int, Window]:
    """The rows and columns that hold the cells of each submap, by id."""
    from scipy import ndimage  # takes a fifth of a second to load, and `localize` never asks

    found = enumerate(ndimage.find_objects(owner + 1))
    return {submap: window for submap, window in found if window is not None}


@dataclass(frozen=True, slots=True)
class Border:
    """One stretch along which two submaps touch, the smaller id first.

    `low` and `high` (m, 2) are the rows and columns of the cells on both sides, side by side.
    """

    pair: Pair
    low: IntArray
    high: IntArray

    def clearance(self, away: FloatArray) -> float:
        """The widest place at which it can be crossed, as `Space.away`, in cells."""
        both = np.minimum(away[tuple(self.low.T)], away[tuple(self.high.T)])
        return float(both.max())


def borders_of(owner: OwnerArray) -> list[Border]:
    """Every stretch along which two submaps touch: by pair, then from the lowest row on."""
    touching = contacts(owner)
    swap = owner[tuple(touching.one.T)] != touching.labels[:, 0]
    low = np.where(swap[:, None], touching.other, touching.one)
    high = np.where(swap[:, None], touching.one, touching.other)
    pairs, which = np.unique(touching.labels, axis=0, return_inverse=True)
    found = []
    for number, (a, b) in enumerate(pairs.tolist()):
        mine = np.flatnonzero(which.ravel() == number)
        for stretch in _stretches(low[mine] + high[mine]):
            found.append(Border((a, b), low[mine[stretch]], high[mine[stretch]]))
    return found


def _stretches(spots: IntArray) -> list[IntArray]:
    """The connected stretches of a border: rows of its points (m, 2), given in half cells."""
    first = spots.min(axis=0)
    picture = np.zeros(spots.max(axis=0) - first + 1, dtype=np.uint8)
    picture[tuple((spots - first).T)] = 1
    side = 2 * _JOINED_HALF_CELLS + 1
    joined = cv2.dilate(picture, np.ones((side, side), dtype=np.uint8))
    count, parts = cv2.connectedComponents(joined, connectivity=8)
    part = parts[tuple((spots - first).T)]
    return [np.flatnonzero(part == number) for number in range(1, count)]

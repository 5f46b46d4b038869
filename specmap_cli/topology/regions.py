"""Which submap each cell of the whole map belongs to, and where submaps touch.

The grids of neighbouring submaps overlap: the robot saw through each door from both sides. So a
cell belongs to the submap from which the robot would reach it first. Fronts spread through free
cells from where the robot drove; they cross a wall or a fence only when nothing else is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.grids.gridmap import (
    BoolArray,
    GridMap,
    LengthArray,
    clearance_of,
    contacts,
    exact,
    joined,
    slices_near,
    window_of,
    within,
)
from specmap_cli.topology.shapes import NOTHING, Outline, outline_of
from specmap_cli.topology.topological_map import Line, Seen

OwnerArray = NDArray[np.signedinteger[Any]]

NOBODY = -1
# Half the width of the gaps that a region goes through, that of a small robot, and how far it goes
# past the last of them: across a sill, not down the rays of a laser.
_ROBOT_RADIUS_M, _REACH_M = 0.15, 0.3
# Smaller pieces that were only seen are single rays, and slits beside walls and furniture, of which
# a map has hundreds.
LEAST_SEEN_M2 = 1.0


@dataclass(frozen=True, slots=True)
class Regions:
    """The map divided: `owner` (H, W) is the submap id of each cell of `grid`, or NOBODY.

    A cell of a submap is free, or furniture in it where a finished map was divided. `outlines` are
    the shapes of the regions in the map frame, by id; a submap that owns no cell has none. `seen`
    is what was only seen, the largest piece first: free cells that are nobody's.
    """

    grid: GridMap
    owner: OwnerArray
    outlines: Mapping[int, Outline]
    seen: tuple[Seen, ...] = ()

    @classmethod
    def of(cls, grid: GridMap, owner: OwnerArray) -> Regions:
        """The regions with their outlines, and what was only seen."""
        outlines = {}
        for id_, (rows, columns) in windows_of(owner).items():
            x, y = np.array([columns.start, rows.start]) * grid.resolution + grid.origin
            part = GridMap(grid.cells[rows, columns], grid.resolution, (float(x), float(y)))
            outlines[id_] = outline_of(owner[rows, columns] == id_, part)
        return cls(grid, owner, outlines, _seen(grid, owner))

    def outline(self, submap: int) -> Outline:
        """The outline of one region, that of nothing for a submap without a cell."""
        return self.outlines.get(submap, NOTHING)

    @property
    def area_m2(self) -> float:
        """Area of all submaps: their free cells."""
        return sum(outline.area_m2 for outline in self.outlines.values())

    @property
    def seen_m2(self) -> float:
        """Area of what was only seen."""
        return sum(piece.area_m2 for piece in self.seen)

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


def _seen(grid: GridMap, owner: OwnerArray) -> tuple[Seen, ...]:
    """The pieces of free cells that are nobody's, from LEAST_SEEN_M2 on, the largest first.

    Cells join over their corners, too: the rays of a fan are one piece.
    """
    nobodys = grid.free & (owner == NOBODY)
    shown = window_of(nobodys)
    if shown is None:
        return ()
    part = nobodys[shown].astype(np.uint8)
    _, pieces, figures, _ = cv2.connectedComponentsWithStats(part, connectivity=8)
    areas = figures[:, cv2.CC_STAT_AREA] * grid.resolution**2
    found = []
    for number in 1 + np.flatnonzero(areas[1:] >= LEAST_SEEN_M2):
        left, bottom, width, height, _ = figures[number].tolist()
        window = pieces[bottom : bottom + height, left : left + width]
        inside = clearance_of(window == number)
        row, column = np.unravel_index(inside.argmax(), inside.shape)
        cell = (shown[0].start + bottom + row, shown[1].start + left + column)
        x, y = grid.centres_of(np.array([cell]))[0].tolist()
        found.append(Seen(area_m2=float(areas[number]), x=x, y=y))
    return tuple(sorted(found, key=lambda piece: -piece.area_m2))


def divide(
    whole: GridMap,
    labels: Labels,
    fences: Sequence[Line] = (),
    unentered: BoolArray | None = None,
) -> Regions:
    """Give each free cell of `whole` to the submap of the keyframe that is nearest on foot.

    The keyframes flood the cells where a robot has room, and from there the free cells, so that
    regions are connected and end at walls, and go through no slit. Cells that a robot could not get
    near, such as those seen through a gap or a window, are nobody's, and so is what is `unentered`
    (H, W): rooms without a keyframe. No region grows across the `fences`, lines in the map.
    """
    places = whole.cells_of(labels.poses[:, :2])
    inside = whole.inside(places) & (labels.submaps != NO_SUBMAP)
    rows, columns = places[inside].T
    passable = whole.free if unentered is None else whole.free & ~unentered
    narrow = within(
        np.pad(whole.free.astype(np.uint8), 1), _ROBOT_RADIUS_M / whole.resolution - _SLACK
    )
    entered = passable & ~narrow[1:-1, 1:-1]
    del narrow
    passable[rows, columns] = True  # where the robot stood, whatever was found there later
    submaps = labels.submaps[inside]
    markers = np.zeros(passable.shape, dtype=_small(submaps.max(initial=0) + 2))
    markers[rows, columns] = submaps + 1
    fence = drawn(fences, whole) if fences else None
    entered |= markers > 0
    entered = joined(entered, markers > 0)
    markers = np.where(entered, flood(entered, markers, fence), 0)
    owner = flood(passable, markers, fence)
    del markers
    owner -= 1
    beside = within((~entered).astype(np.uint8), _REACH_M / whole.resolution)
    beside &= passable
    beside = joined(beside, entered)
    beside &= whole.free & (owner >= 0)
    owner[~beside] = NOBODY
    return Regions.of(whole, owner)


def _small(most: int) -> type[np.signedinteger[Any]]:
    """The small kind of numbers in which ids of cells fit, up to the largest of some."""
    return np.int16 if most <= np.iinfo(np.int16).max else np.int32


_CROSS = np.array([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)])
_SLACK = 0.01  # cells: less than from one distance to the next where a robot has hardly room
_NEARLY = 1e-5  # cells: less than from one distance to the next, more than a rounding
_CELL = 0.7072  # of the side of a cell: from its centre to its corner, and no less


def flood(passable: BoolArray, markers: OwnerArray, fences: BoolArray | None = None) -> OwnerArray:
    """(H, W) the marker that reaches each cell first, of the kind of the `markers` (H, W).

    The watershed grows all markers a ring at a time over equal cells, and crosses an edge of the
    picture only when nothing else is left. It leaves lines one cell wide where fronts meet.
    """
    entered = passable if fences is None else passable & ~fences
    rows, columns = passable.shape
    picture = np.full((rows + 2, columns + 2, 3), 255, dtype=np.uint8)
    picture[1:-1, 1:-1][entered] = 0
    flooded = np.zeros((rows + 2, columns + 2), dtype=np.int32)
    flooded[1:-1, 1:-1] = markers
    cv2.watershed(picture, flooded)
    del picture
    fronts = np.argwhere((flooded[1:-1, 1:-1] < 0) & passable) + 1
    reached = flooded[tuple((fronts[:, None] + _CROSS).reshape(-1, 2).T)].reshape(-1, len(_CROSS))
    flooded[tuple(fronts.T)] = reached.max(axis=1)
    return flooded[1:-1, 1:-1].astype(markers.dtype)


def drawn(fences: Iterable[Line], grid: GridMap) -> BoolArray:
    """(H, W) the cells that fences go through: no way from cell to next cell leads between them."""
    cells = np.zeros(grid.cells.shape, dtype=np.bool_)
    reach = _CELL * grid.resolution
    for fence in fences:
        ends = np.array(fence)
        rows, columns = slices_near(ends, 2.0 * reach, grid.origin, grid.resolution, cells.shape)
        window = np.mgrid[rows, columns].reshape(2, -1).T
        along, across, length = along_and_across(grid.centres_of(window), fence)
        on = (np.abs(across) <= reach) & (along >= -reach) & (along <= length + reach)
        cells[tuple(window[on].T)] = True
    return cells


def along_and_across(places: FloatArray, line: Line) -> tuple[FloatArray, FloatArray, float]:
    """How far along a line each place (n, 2) is, and how far left of it; the line's length."""
    start, end = np.array(line[0]), np.array(line[1])
    length = float(np.hypot(*(end - start)))
    x, y = ((end - start) / length).tolist()
    away = places - start
    return away[:, 0] * x + away[:, 1] * y, away[:, 1] * x - away[:, 0] * y, length


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
    away: LengthArray
    wall_depth: float = 0.0

    @classmethod
    def of(cls, regions: Regions, *, scanned: bool = False) -> Space:
        """The space of the regions of a map, which a laser `scanned`, or somebody drew."""
        free = regions.grid.free
        away = clearance_of(free)
        owner = np.where(free, regions.owner, NOBODY)
        return cls(regions.grid, owner, away, 0.5 if scanned else 0.0)

    def clearance(self, part: Any = ...) -> FloatArray:
        """(H, W) metres from the centre of a free cell to the side of the nearest one that is not.

        Zero for cells that are not free. Only a `part` of the cells is looked at: those of an index
        into the map.
        """
        inside = exact(self.away[part])
        inside -= 0.5
        np.maximum(inside, 0.0, out=inside)
        return np.asarray(np.multiply(inside, self.grid.resolution, out=inside))

    def away_for(self, clearance_m: float) -> float:
        """From how many cells `away` on a free cell has so much clearance."""
        return clearance_m / self.grid.resolution + 0.5 - _NEARLY

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


def borders_of(owner: OwnerArray) -> list[Border]:
    """Every stretch along which two submaps touch: by pair, then from the lowest row on."""
    touching = contacts(owner)
    swap = owner[tuple(touching.one.T)] != touching.labels[:, 0]
    low = np.where(swap[:, None], touching.other, touching.one)
    high = np.where(swap[:, None], touching.one, touching.other)
    pairs, which = np.unique(touching.labels, axis=0, return_inverse=True)
    side = 2 * _JOINED_HALF_CELLS + 1
    found = []
    for number, (a, b) in enumerate(pairs.tolist()):
        mine = np.flatnonzero(which.ravel() == number)
        spots = low[mine] + high[mine]  # in half cells
        spots -= spots.min(axis=0)
        picture = np.zeros(spots.max(axis=0) + 1, dtype=np.uint8)
        picture[tuple(spots.T)] = 1
        joined = cv2.dilate(picture, np.ones((side, side), dtype=np.uint8))
        count, parts = cv2.connectedComponents(joined, connectivity=8)
        stretch = parts[tuple(spots.T)]
        for part in range(1, count):
            here = mine[stretch == part]
            found.append(Border((a, b), low[here], high[here]))
    return found

"""Which submap each cell of the whole map belongs to, its shape, and where submaps touch.

The grids of neighbouring submaps overlap: the robot saw through each door from both sides. So a
cell belongs to the submap from which the robot would reach it first, from within its room where it
is known. Fronts spread through free cells from where the robot drove; they leave a room and cross a
wall or a fence only when nothing else is left.

The outline of a submap is the outer contour of its free cells, and says whether it is a corridor, a
hall or a room: its mean width is four times the mean distance of its points from the border. For a
long strip, straight or bent, that is its width; for a square it is two thirds of the side.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import windows_of
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.grids.gridmap import (
    BoolArray,
    GridMap,
    LengthArray,
    Piece,
    cell_distances,
    clearance_of,
    contacts,
    exact,
    flood,
    nearest_values,
    slices_near,
    window_of,
    within,
)
from specmap_cli.topology.topological_map import Line, Seen, SubmapKind

_TOLERANCE = 2.0  # of the simplified contour, half cells
_KEPT_AREA = 0.8  # share of its area that a simplified contour must keep
_PAIRS_AT_ONCE = 1 << 18  # sides of a contour, two at a time: bounds the memory


@dataclass(frozen=True, slots=True)
class Outline:
    """A region's shape in metres: `polygon` (N, 2) counter-clockwise and `centroid` (2,).

    Both are those of the largest connected part. `area_m2` is that of all free cells: what is told
    anywhere as the area of a submap, or summed as that of a map. Furniture that counts as a part of
    a region is none of it. A region without a cell has no points, None and zero.
    """

    polygon: FloatArray
    centroid: FloatArray | None
    area_m2: float


NOTHING = Outline(np.zeros((0, 2)), None, 0.0)


def outline_of(region: BoolArray, grid: GridMap) -> Outline:
    """The outline of the cells `region` (H, W) in the frame of `grid`.

    It is simplified to within a cell's side. The centroid is the centre of the region's cell
    nearest the mean of its cells, so that it lies inside a region of any shape.
    """
    if not region.any():
        return NOTHING
    # of its largest connected part, the first of equals
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        region.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S
    )
    part = np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))
    counts = [np.count_nonzero(part, axis=axis) for axis in (1, 0)]
    mean = np.array([np.average(np.arange(len(count)), weights=count) for count in counts])
    cell = np.round(mean).astype(np.intp)
    if not part[tuple(cell)]:
        eroded = cv2.erode(part.astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
        border = np.argwhere(part & (eroded == 0))
        cell = border[np.argmin(np.sum((border - mean) ** 2, axis=1))]
    return Outline(
        _contour(part) * grid.resolution + grid.origin,
        grid.centres_of(cell[None])[0],
        float(np.count_nonzero(region & grid.free)) * grid.resolution**2,
    )


def _contour(region: BoolArray) -> FloatArray:
    """(N, 2) columns and rows of the outer contour of one connected region, counter-clockwise.

    Cell (row, column) covers [column, column + 1) x [row, row + 1). The contour has few corners, as
    far as it stays the outline of an area.
    """
    # Doubled, so that the contour runs a quarter of a cell inside the region, not along centres,
    # where a passage one cell wide would have no area.
    doubled = np.zeros((2 * region.shape[0] + 2, 2 * region.shape[1] + 2), dtype=np.uint8)
    for row, column in ((1, 1), (1, 2), (2, 1), (2, 2)):
        doubled[row:-1:2, column:-1:2] = region
    contours, _ = cv2.findContours(doubled, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    ring = max(contours, key=cv2.contourArea)
    area = cv2.contourArea(ring)
    for tolerance in (_TOLERANCE, _TOLERANCE / 2.0):
        simple = cv2.approxPolyDP(ring, tolerance, True)
        is_thin = cv2.contourArea(simple) < _KEPT_AREA * area  # thinner than the tolerance
        if not is_thin and not _meets_itself(simple.reshape(-1, 2).astype(np.int64)):
            ring = simple
            break
    corners = (ring.reshape(-1, 2).astype(np.float64) - 0.5) / 2.0
    x, y = corners.T
    turning = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return corners if turning >= 0.0 else corners[::-1]


def _meets_itself(ring: NDArray[np.int64]) -> bool:
    """Whether two sides of a ring (N, 2), which are no neighbours, cross or touch: exactly."""
    ends = np.roll(ring, -1, axis=0)
    low, high = np.minimum(ring, ends), np.maximum(ring, ends)
    for first in range(0, len(ring), many := 1 + _PAIRS_AT_ONCE // len(ring)):
        some = slice(first, first + many)
        across, along = (  # whether they are near each other, in columns and in rows
            (a[some, None] <= b) & (a <= b[some, None]) for a, b in zip(low.T, high.T, strict=True)
        )
        one, other = np.nonzero(across & along)
        one += first
        distant = (other - one > 1) & (other - one < len(ring) - 1)
        one, other = one[distant], other[distant]
        apart = _side(ring[one], ends[one], ring[other]) * _side(ring[one], ends[one], ends[other])
        aside = _side(ring[other], ends[other], ring[one])
        aside *= _side(ring[other], ends[other], ends[one])
        if ((apart <= 0) & (aside <= 0)).any():
            return True
    return False


def _side(
    start: NDArray[np.int64], end: NDArray[np.int64], place: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(N,) on which side of a line a place lies: 1, -1, or 0 on it."""
    along, to = end - start, place - start
    return np.asarray(np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]))


# Of a shape, and along its longer side; larger shapes have larger cells. Borders run along cells of
# a map, of which no multiple is half of one of these: none runs through a row of their centres.
_CELL_M, _MOST_CELLS = 0.05 / math.sqrt(2.0), 1000.5
# Gaps narrower than a door lie between pieces of furniture: they are filled, from both sides.
_GAP_M = 0.8
# A hall is wider than a corridor is made, and larger than a room for thirty people.
_HALL_WIDTH_M, _HALL_M2 = 4.0, 60.0
# Area by squared mean width of a rectangle four times as long as it is wide: 4 / (1 - 1/12) ** 2.
_LONG = 576.0 / 121.0


def kind_of(polygon: FloatArray) -> SubmapKind | None:
    """The kind of a region with this border (N, 2), metres; None for one without any area.

    A hall has 60 square metres and a mean width of 4 m, or more. Of other shapes, those are
    corridors that are long for their width, as a rectangle of 4 by 1 is. They are measured along
    their own walls: a shape that is turned, moved or mirrored has the same kind, unless half a
    percent of its length would change it.
    """
    if not len(polygon):
        return None
    shape, cell = _along_walls(polygon)
    if not shape.any():
        return None
    # a gap is filled where no disc fits into it; its radius is half a cell less than the reach
    reach = int(_GAP_M / 2.0 / cell) + 1
    away = cell_distances(np.pad(~shape, reach + 1, constant_values=True).astype(np.uint8))
    away = cell_distances((away < reach).astype(np.uint8))
    depths = away[away >= reach] - (reach - 0.5)
    area, width = len(depths) * cell**2, 4.0 * cell * float(depths.mean())
    if area >= _HALL_M2 and width >= _HALL_WIDTH_M:
        return "hall"
    return "corridor" if area >= _LONG * width**2 else "room"


def _along_walls(polygon: FloatArray) -> tuple[BoolArray, float]:
    """The cells (H, W) of a polygon (N, 2) in rows along its walls, and their side, metres."""
    corners = polygon @ (1.0, 1.0j)
    steps = np.roll(corners, -1) - corners
    # a right angle, times four, is a whole turn: all sides of a rectangle point one way
    corners = corners * np.exp(-0.25j * np.angle(np.sum(steps**4)))
    x, y = (part - (part.max() + part.min()) / 2.0 for part in (corners.real, corners.imag))
    cell = max(_CELL_M, 2.0 * max(x.max(), y.max()) / _MOST_CELLS)
    width, height = (int(part.max() / cell) for part in (x, y))  # on each side of the middle
    x, y = x / cell + width, y / cell + height
    end_x, end_y = np.roll(x, -1), np.roll(y, -1)
    low, high = (np.ceil(ends).astype(np.intp) for ends in (np.fmin(y, end_y), np.fmax(y, end_y)))
    side = np.repeat(np.arange(len(x)), high - low)
    row = low[side] + np.arange(len(side)) - (np.cumsum(high - low) - (high - low))[side]
    share = (row - y[side]) / (end_y - y)[side]
    first = np.ceil(x[side] + share * (end_x - x)[side]).astype(np.intp)  # beyond the side
    crossed = np.zeros((2 * height + 1, 2 * width + 2), dtype=np.intp)
    np.add.at(crossed, (row, first), 1)
    return np.cumsum(crossed, axis=1)[:, :-1] % 2 == 1, cell


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
        nearest, away = nearest_values(self.owner + 1)  # of which NOBODY is nought
        away_m = self.grid.under(points[:, :2], away, np.inf) * self.grid.resolution
        owners = self.grid.under(points[:, :2], nearest, 0).astype(np.int64) - 1
        return np.where(away_m <= _ROBOT_RADIUS_M, owners, NOBODY)


def _seen(grid: GridMap, owner: OwnerArray) -> tuple[Seen, ...]:
    """The pieces of nobody's free cells from LEAST_SEEN_M2 on, over corners, the largest first."""
    nobodys = grid.free & (owner == NOBODY)
    shown = window_of(nobodys)
    if shown is None:
        return ()
    part = nobodys[shown].astype(np.uint8)
    del nobodys
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
    rooms: Collection[Piece] | None = None,
) -> Regions:
    """Give each free cell of `whole` to the submap of the keyframe that is nearest on foot.

    The keyframes flood the cells where a robot has room, and from there the free cells, so that
    regions are connected and end at walls, and go through no slit. Cells that a robot could not get
    near, such as those seen through a gap or a window, are nobody's. `rooms` are those that were
    entered; what is in none is nobody's. A region grows out of a room, and across the `fences`,
    lines in the map, only where nothing else is left: not from a keyframe on one, either.
    """
    places = whole.cells_of(labels.poses[:, :2])
    inside = whole.inside(places) & (labels.submaps != NO_SUBMAP)
    rows, columns = places[inside].T
    passable, pieces = whole.free, rooms or ()
    if rooms is not None:
        known = np.zeros_like(passable)
        for window, cells in rooms:
            known[window] |= cells
        passable &= known
        del known
    room = _ROBOT_RADIUS_M / whole.resolution - _SLACK
    entered = ~within(np.pad(whole.free, 1).view(np.uint8), room)[1:-1, 1:-1]
    entered &= passable
    passable[rows, columns] = True  # where the robot stood, whatever was found there later
    entered[rows, columns] = True
    submaps = labels.submaps[inside]
    small = np.int16 if submaps.max(initial=0) < np.iinfo(np.int16).max - 1 else np.int32
    owner: OwnerArray = np.zeros(passable.shape, dtype=small)
    owner[rows, columns] = submaps + 1
    fenced = drawn(fences, whole) if fences else None
    if fenced is not None:
        owner = flood(entered & ~fenced, owner, pieces)
    owner = flood(entered, owner, pieces)
    entered = owner > 0
    passable &= within((~entered).view(np.uint8), _REACH_M / whole.resolution)
    if fenced is not None:
        owner = flood(passable & ~fenced, owner, pieces)
    owner = flood(passable, owner, pieces)
    del passable, entered, fenced  # masks of the whole map, which what follows needs not
    owner[~whole.free] = 0
    owner -= 1
    return Regions.of(whole, owner)


_SLACK = 0.01  # cells: less than from one distance to the next where a robot has hardly room
_NEARLY = 1e-5  # cells: less than from one distance to the next, more than a rounding
_CELL = 0.7072  # of the side of a cell: from its centre to its corner, and no less


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
        owner = regions.owner
        if (owner[~free] != NOBODY).any():  # furniture that counts as a part of a region
            owner = np.where(free, owner, NOBODY)
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

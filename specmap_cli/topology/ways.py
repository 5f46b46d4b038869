"""Where a robot of some radius can stand in each submap, and how it gets to the next one.

A way leads from the anchor of a submap to that of its neighbour. It is the cheapest over free
cells, drawn as a line with few corners.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import Window, windows_of
from specmap_cli.core.geometry import FloatArray, path_length
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.gridmap import GridMap, slices_near
from specmap_cli.topology.regions import (
    Border,
    Pair,
    Space,
    along_and_across,
    borders_of,
)
from specmap_cli.topology.topological_map import Door, Line

Price = Callable[[Any], FloatArray]  # of a step in some cells, by their index into the map

# Out to so many radii from a wall each step is the cheaper the more room there is: a way keeps to
# the middle of a door and of a corridor, and does not go round through a hall for it.
_COMFORT = 2.5


@dataclass(frozen=True, slots=True)
class Way:
    """A way between two anchors inside their submaps.

    `path` (N, 2) are its corners in metres of the map, None where the robot is too wide for every
    way. `clearance_m` is the least on it, or that of the widest way there is; None for no way.
    """

    path: FloatArray | None
    clearance_m: float | None

    @property
    def length_m(self) -> float | None:
        """Metres along the path."""
        return None if self.path is None else path_length(self.path)


NO_WAY = Way(None, None)


def ways(
    space: Space, anchors: Mapping[int, Anchor], pairs: Iterable[Pair], radius_m: float
) -> dict[Pair, Way]:
    """The way between each pair of submaps, the smaller id first, at a clearance of `radius_m`.

    A way leads through the two submaps only, in a straight line where that is no nearer to walls.
    The time is that of one search over the cells of each submap: linear in the area.
    """

    def price(part: Any) -> FloatArray:
        return prices_of(space.clearance(part), radius_m)

    windows, found = windows_of(space.owner), dict.fromkeys(pairs, NO_WAY)
    trees: dict[int, Tree] = {}
    borders: dict[Pair, list[Border]] = {}
    for submap in {submap for pair in found for submap in pair} & windows.keys():
        cells = _within(windows[submap], space.owner[windows[submap]] == submap)
        trees[submap] = tree(cells, price(tuple(cells.T)), anchors[submap].cell)
    for border in borders_of(space.owner):
        borders.setdefault(border.pair, []).append(border)
    for pair in found:
        if pair not in borders:
            continue
        beside = np.concatenate([border.low for border in borders[pair]])
        beyond = np.concatenate([border.high for border in borders[pair]])
        low, high = (trees[submap] for submap in pair)
        step = (price(tuple(beside.T)) + price(tuple(beyond.T))) / 2.0
        cost = low.cost_to(beside) + step + high.cost_to(beyond)
        best = int(np.argmin(cost))
        if np.isfinite(cost[best]):
            cells = np.concatenate([low.way_to(beside[best]), high.way_to(beyond[best])[::-1]])
        else:  # none crosses the border once
            ends = [anchors[submap].cell for submap in pair]
            wandering, most = _over_both(space, pair, windows, ends, price)
            if wandering is None:
                found[pair] = Way(None, most)
                continue
            cells = wandering
        corners = straightened(cells, price)
        under = np.concatenate([cells_on(a, b)[0] for a, b in pairwise(corners)])
        clearance_m = float(space.clearance(tuple(under.T)).min())
        found[pair] = Way(space.grid.centres_of(corners), clearance_m)
    return found


def _over_both(
    space: Space,
    pair: Pair,
    windows: Mapping[int, Window],
    ends: Sequence[tuple[int, int]],
    price: Price,
) -> tuple[IntArray | None, float | None]:
    """The cheapest way between two cells over those of a pair; the clearance of the widest."""
    rows, columns = (
        slice(min(a.start, b.start), max(a.stop, b.stop))
        for a, b in zip(*(windows[submap] for submap in pair), strict=True)
    )
    window, mine = (rows, columns), np.isin(space.owner[rows, columns], pair)
    start, end = np.array(ends)
    corner = (rows.start, columns.start)
    room = np.where(mine, space.clearance(window), 0.0)
    most = widest(room, tuple(start - corner), tuple(end - corner))
    if most is None:
        return None, None
    cells = _within(window, mine)
    found = tree(cells, price(tuple(cells.T)), ends[0])
    return found.way_to(end) if np.isfinite(found.cost_to(end[None])[0]) else None, most


def _within(window: Window, mask: BoolArray) -> IntArray:
    """(n, 2) rows and columns on the map of the set cells of a window of it, row by row."""
    return np.asarray(np.argwhere(mask) + [part.start for part in window])


def prices_of(clearance: FloatArray, radius_m: float) -> FloatArray:
    """(H, W) or (n,) the price of a step in cells of that clearance, infinite below `radius_m`."""
    most = _COMFORT * radius_m
    price = np.minimum(clearance, most)
    with np.errstate(divide="ignore"):
        np.divide(most, price, out=price)
    price[clearance < radius_m] = np.inf
    return price


def widest(room: FloatArray, start: tuple[int, ...], end: tuple[int, ...]) -> float | None:
    """The clearance of the widest way between two cells of some `room` (h, w), or None."""
    levels = np.unique(room[room > 0.0])
    low, high = 0, len(levels)  # joined at levels below `low`, apart from `high` on
    while low < high:
        middle = (low + high) // 2
        level = (room >= levels[middle]).astype(np.uint8)
        _, parts = cv2.connectedComponents(level, connectivity=4)
        if parts[start] == parts[end] != 0:
            low = middle + 1
        else:
            high = middle
    return float(levels[low - 1]) if low else None


_OFF_TRACK_M = 2.0  # on foot from the robot's way: farther off lies what was seen through glass
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_SQUARE = cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3))


@dataclass(frozen=True, slots=True)
class Anchor:
    """A free cell of a submap, by row and column, and its clearance in metres."""

    cell: tuple[int, int]
    clearance_m: float


def anchors_of(
    space: Space, stood: IntArray, radius_m: float, margin_m: float, doors: Sequence[Door] = ()
) -> dict[int, Anchor]:
    """The anchor of each submap that has a free cell.

    It is the cell nearest to the middle of the submap that keeps the robot's radius and a margin
    off all that is not free, and off its `doors` so much that another robot fits between. Where no
    cell keeps so much, it is the one that keeps the most. Of a submap in pieces that one counts in
    which the robot stood most often: rows and columns `stood` (k, 2). Nor is what is far from the
    robot's way a place to stand, such as the floor behind a railing or glass.
    """
    anchors = {}
    wide, comfortable = space.away_for(radius_m), space.away_for(radius_m + margin_m)
    for submap, window in windows_of(space.owner).items():
        mine, away = space.owner[window] == submap, space.away[window]
        first = [part.start for part in window]
        roomy = mine & (away >= wide)
        if not roomy.any():
            roomy = mine
        count, parts, stats, _ = cv2.connectedComponentsWithStats(
            roomy.view(np.uint8), connectivity=4
        )
        here = stood - first
        here = here[((here >= 0) & (here < roomy.shape)).all(axis=1)]
        often, size = np.bincount(parts[tuple(here.T)], minlength=count), stats[:, cv2.CC_STAT_AREA]
        size[0] = often[0] = -1
        piece = np.asarray(parts == np.lexsort([size, often])[-1])
        del mine, roomy, parts
        near = np.zeros_like(piece)  # where the robot stood; all counts where it never did
        near[tuple(here.T)] = piece[tuple(here.T)]
        if near.any():  # ways within the piece, as long as around an octagon: at most a tenth off
            for step in range(int(_OFF_TRACK_M / space.grid.resolution)):
                square = _SQUARE if step % 2 else _CROSS
                near = piece & (cv2.dilate(near.astype(np.uint8), square) > 0)
            piece = near
        middle = [
            np.average(np.arange(side), weights=np.count_nonzero(piece, axis=axis))
            for side, axis in zip(piece.shape, (1, 0), strict=True)
        ]
        clear = piece.copy()
        for door in (door for door in doors if submap in door.between):
            _keep_off(door.sides, 2.0 * radius_m + margin_m, space.grid, window, clear)
        piece = clear if clear.any() else piece
        rows, columns = np.nonzero(piece & (away >= min(comfortable, float(away[piece].max()))))
        best = int(np.argmin((rows - middle[0]) ** 2 + (columns - middle[1]) ** 2))
        cell = np.array([[rows[best], columns[best]]]) + first
        row, column = cell[0].tolist()
        anchors[submap] = Anchor((row, column), float(space.clearance(tuple(cell.T))[0]))
    return anchors


def _keep_off(line: Line, reach_m: float, grid: GridMap, window: Window, cells: BoolArray) -> None:
    """Take from the `cells` (h, w) of a window of a grid those nearer than this to a line."""
    there = slices_near(np.array(line), reach_m, grid.origin, grid.resolution, grid.cells.shape)
    rows, columns = (
        np.arange(max(near.start, own.start), min(near.stop, own.stop))
        for near, own in zip(there, window, strict=True)
    )
    near = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    along, across, length = along_and_across(grid.centres_of(near), line)
    beyond = np.maximum(np.abs(along - length / 2) - length / 2, 0.0)
    blocked = near[np.hypot(beyond, across) < reach_m] - [part.start for part in window]
    cells[tuple(blocked.T)] = False


_STEPS = ((0, 1), (1, -1), (1, 0), (1, 1))  # to half of the eight neighbours, row by row
_NO_NODE = -1
_ROW = 1 << 32  # more than any map has columns


@dataclass(frozen=True, slots=True)
class Tree:
    """The cheapest ways from one cell over some cells of the map, its nodes.

    `cells` (n, 2) are the row and column on the map of each node, row by row; `cost` (n + 1,) that
    of the way, infinite where there is none and for node -1; `before` (n,) the node that comes
    before it on the way, negative for the first.
    """

    cells: IntArray
    cost: FloatArray
    before: NDArray[np.int32]

    def cost_to(self, cells: IntArray) -> FloatArray:
        """(m,) the cost of the way to cells (m, 2) of the map, infinite where there is none."""
        return np.asarray(self.cost[_numbers(_keys(self.cells), _keys(cells))])

    def way_to(self, cell: IntArray) -> IntArray:
        """(k, 2) the cells of the way to one that can be reached, from the first on."""
        way, node = [], int(_numbers(_keys(self.cells), _keys(cell[None]))[0])
        while node >= 0:
            way.append(node)
            node = int(self.before[node])
        return np.asarray(self.cells[way[::-1]])


def tree(cells: IntArray, price: FloatArray, start: tuple[int, int]) -> Tree:
    """The cheapest ways from `start`, a row and column of the map, over cells (n, 2), row by row.

    `price` (n,) is that of a step of one cell, also across corners, and infinite where nobody can
    go. Takes n log n, and nothing for the rest of the map.
    """
    from scipy.sparse import csr_matrix  # take a fifth of a second to load
    from scipy.sparse.csgraph import dijkstra

    cells, price = cells[np.isfinite(price)], price[np.isfinite(price)]
    keys = _keys(cells)
    there = np.stack([_numbers(keys, keys + down * _ROW + right) for down, right in _STEPS], axis=1)
    can = there != _NO_NODE
    # a line across a corner touches the cells on both sides of it: left or right, and below
    can[:, 1] &= np.append(np.False_, can[:-1, 0])[: len(can)] & can[:, 2]
    can[:, 3] &= can[:, 0] & can[:, 2]
    prices = (price[:, None] + price[there]) * [0.5 * np.hypot(*step) for step in _STEPS]
    row_ends = np.append(0, np.cumsum(can.sum(axis=1)))
    graph = csr_matrix((prices[can], there[can], row_ends), shape=(len(cells), len(cells)))
    del there, can, prices, row_ends
    first = int(_numbers(keys, _keys(np.array([start])))[0])
    cost, before = np.full(len(cells), np.inf), np.full(len(cells), _NO_NODE, dtype=np.int32)
    if first != _NO_NODE:
        cost, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    return Tree(cells, np.append(cost, np.inf), before)


def _keys(cells: IntArray) -> IntArray:
    """(n,) one number for each of some cells (n, 2): it rises row by row."""
    return np.asarray(cells[:, 0] * _ROW + cells[:, 1], dtype=np.int64)


def _numbers(keys: IntArray, asked: IntArray) -> NDArray[np.int32]:
    """(m,) where each of the keys asked for is among some that rise, `_NO_NODE` where it is not."""
    if not len(keys):
        return np.full(len(asked), _NO_NODE, dtype=np.int32)
    at = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    return np.where(keys[at] == asked, at, _NO_NODE).astype(np.int32)


_DEVIATION_CELLS = 2.0  # how far a straight piece may leave the cells that it stands for
_HAIRS = 1e-6 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])  # to all sides
_SLACK = 1e-9  # of prices that are equal but for the last digit


def straightened(way: IntArray, price: Price) -> IntArray:
    """The corners (k, 2) of a line from the first to the last cell of a way (n, 2).

    Cells that a line must not enter have an infinite `price`. A piece of the line costs no
    more than the corners that it replaces: so it keeps off walls as the way does.
    """
    corners = way[_corners(way, price)]
    prices = [line_price(a, b, price) for a, b in pairwise(corners)]
    kept = [0]
    while kept[-1] < len(corners) - 1:
        here = kept[-1]
        kept.append(
            next(
                there
                for there in range(len(corners) - 1, here, -1)
                if there == here + 1
                or line_price(corners[here], corners[there], price)
                <= sum(prices[here:there]) + _SLACK
            )
        )
    return corners[kept]


def _corners(way: IntArray, price: Price) -> list[int]:
    """Rows of a way between which a straight line may be drawn: Douglas and Peucker (1973)."""
    kept, waiting = {0, len(way) - 1}, [(0, len(way) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        along = way[last] - way[first]
        length = float(np.sqrt(np.sum(along**2)))
        rows, columns = (way[first : last + 1] - way[first]).T
        if length == 0.0:
            deviation = np.hypot(rows, columns)
        else:
            deviation = np.abs(rows * along[1] - columns * along[0]) / length
        open_line = math.isfinite(line_price(way[first], way[last], price))
        if float(deviation.max()) > _DEVIATION_CELLS or not open_line:
            corner = first + 1 + int(np.argmax(deviation[1:-1]))
            kept.add(corner)
            waiting += [(first, corner), (corner, last)]
    return sorted(kept)


def line_price(start: IntArray, end: IntArray, price: Price) -> float:
    """The price of a straight line between the centres of two cells."""
    cells, lengths = cells_on(start, end)
    prices = price(tuple(cells.T))
    return float(np.sum(prices * lengths)) if np.isfinite(prices).all() else math.inf


def cells_on(start: IntArray, end: IntArray) -> tuple[IntArray, FloatArray]:
    """(n, 2) every cell under a straight line, and the length (n,) of the line in it, in cells.

    Through a corner the line touches the cells on both sides, at no length.
    """
    along = (end - start).astype(np.float64)
    counts = [round(abs(part)) for part in along.tolist()]  # of edges of cells met on each axis
    met = [(np.arange(count) + 0.5) / count for count in counts if count]
    ends = np.unique(np.concatenate([[0.0, 1.0], *met]))
    middles = (ends[:-1] + ends[1:]) / 2.0
    under = np.rint(start + middles[:, None] * along)
    touched = np.rint(start + ends[:, None, None] * along + _HAIRS)
    lengths = np.diff(ends) * math.hypot(*along)
    return (
        np.concatenate([under, touched.reshape(-1, 2)]).astype(np.int64),
        np.concatenate([lengths, np.zeros(touched.size // 2)]),
    )

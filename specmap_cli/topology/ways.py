"""Ways from the anchor of a submap to that of its neighbour, for a robot of some radius."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.topology.anchors import Anchor
from specmap_cli.topology.polylines import cells_on, straightened
from specmap_cli.topology.space import Border, Pair, Space, Window, borders_of, windows_of
from specmap_cli.topology.trees import Tree, tree

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
        if self.path is None:
            return None
        return float(np.sum(np.linalg.norm(np.diff(self.path, axis=0), axis=1)))


NO_WAY = Way(None, None)


def ways(
    space: Space, anchors: Mapping[int, Anchor], pairs: Iterable[Pair], radius_m: float
) -> dict[Pair, Way]:
    """The way between each pair of submaps, the smaller id first, at a clearance of `radius_m`.

    A way leads through the two submaps only, in a straight line where that is no nearer to walls.
    The time is that of one search over the cells of each submap: linear in the area.
    """
    land = _Land.of(space, anchors, radius_m)
    return {pair: _way(land, pair) for pair in pairs}


@dataclass(frozen=True, slots=True)
class _Land:
    """What every search needs: prices of cells (H, W), and the cheapest ways in each submap."""

    space: Space
    clearance: FloatArray
    price: FloatArray
    anchors: Mapping[int, Anchor]
    windows: Mapping[int, Window]
    trees: Mapping[int, Tree]
    borders: Mapping[Pair, Border]

    @classmethod
    def of(cls, space: Space, anchors: Mapping[int, Anchor], radius_m: float) -> _Land:
        clearance = space.clearance
        most = _COMFORT * radius_m
        with np.errstate(divide="ignore"):
            price = most / np.minimum(clearance, most)
        price[clearance < radius_m] = np.inf
        windows = windows_of(space.owner)
        trees = {}
        for submap, window in windows.items():
            mine = (space.owner[window] == submap) & np.isfinite(price[window])
            trees[submap] = tree(mine, price[window], window, anchors[submap].cell)
        return cls(space, clearance, price, anchors, windows, trees, _whole(space))


def _whole(space: Space) -> dict[Pair, Border]:
    """The whole border of each pair of submaps that touch, of one piece or of several."""
    pieces: dict[Pair, list[Border]] = {}
    for border in borders_of(space.owner):
        pieces.setdefault(border.pair, []).append(border)
    return {
        pair: Border(
            pair,
            np.concatenate([border.low for border in mine]),
            np.concatenate([border.high for border in mine]),
        )
        for pair, mine in pieces.items()
    }


def _way(land: _Land, pair: Pair) -> Way:
    """The way between the anchors of two submaps."""
    if pair not in land.borders:
        return NO_WAY
    cells = _across(land, pair)
    if cells is None:
        widest = _widest(land, pair)
        cells = None if widest is None else _through_both(land, pair)
        if cells is None:
            return Way(None, widest)
    corners = straightened(cells, land.price)
    under = np.concatenate([cells_on(a, b)[0] for a, b in pairwise(corners)])
    return Way(land.space.grid.centres_of(corners), float(land.clearance[tuple(under.T)].min()))


def _across(land: _Land, pair: Pair) -> IntArray | None:
    """(n, 2) the cells of the cheapest way that crosses the border of two submaps once."""
    border = land.borders[pair]
    low, high = (land.trees[submap] for submap in pair)
    step = (land.price[tuple(border.low.T)] + land.price[tuple(border.high.T)]) / 2.0
    cost = low.cost_to(border.low) + step + high.cost_to(border.high)
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        return None
    there, back = low.way_to(border.low[best]), high.way_to(border.high[best])
    return np.concatenate([there, back[::-1]])


def _through_both(land: _Land, pair: Pair) -> IntArray | None:
    """(n, 2) the cells of the cheapest way over the cells of both, whoever's they are."""
    window, mine = _both(land, pair)
    price = land.price[window]
    start, end = (land.anchors[submap].cell for submap in pair)
    found = tree(mine & np.isfinite(price), price, window, start)
    goal = np.array(end)
    return found.way_to(goal) if np.isfinite(found.cost_to(goal[None])[0]) else None


def _widest(land: _Land, pair: Pair) -> float | None:
    """The clearance of the widest way between the anchors over the cells of both, or None."""
    window, mine = _both(land, pair)
    room = np.where(mine, land.clearance[window], 0.0)
    corner = np.array([part.start for part in window])
    ends = [tuple(np.array(land.anchors[submap].cell) - corner) for submap in pair]
    levels = np.unique(room[room > 0.0])
    low, high = 0, len(levels)  # joined at levels below `low`, apart from `high` on
    while low < high:
        middle = (low + high) // 2
        level = (room >= levels[middle]).astype(np.uint8)
        _, parts = cv2.connectedComponents(level, connectivity=4)
        one, other = (int(parts[end]) for end in ends)
        if one == other != 0:
            low = middle + 1
        else:
            high = middle
    return float(levels[low - 1]) if low else None


def _both(land: _Land, pair: Pair) -> tuple[Window, BoolArray]:
    """The window of two submaps, and which of its cells are theirs."""
    one, other = (land.windows[submap] for submap in pair)
    rows, columns = (
        slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(one, other, strict=True)
    )
    return (rows, columns), np.isin(land.space.owner[rows, columns], pair)

"""Ways over cells as lines with few corners."""

from __future__ import annotations

import itertools
import math

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray

_STRAY_CELLS = 2.0  # how far a straight piece may leave the cells that it stands for
_HAIRS = 1e-6 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])  # to all sides
_SLACK = 1e-9  # of prices that are equal but for the last digit


def straightened(way: IntArray, price: FloatArray) -> IntArray:
    """The corners (k, 2) of a line from the first to the last cell of a way (n, 2).

    Cells that a line must not enter have an infinite `price` (H, W). A piece of the line costs no
    more than the corners that it replaces: so it keeps off walls as the way does.
    """
    return _pulled(way[_corners(way, price)], price)


def line_price(start: IntArray, end: IntArray, price: FloatArray) -> float:
    """The price of a straight line between the centres of two cells."""
    cells, lengths = cells_on(start, end)
    prices = price[tuple(cells.T)]
    return float(np.sum(prices * lengths)) if np.isfinite(prices).all() else math.inf


def cells_on(start: IntArray, end: IntArray) -> tuple[IntArray, FloatArray]:
    """(n, 2) every cell under a straight line, and the length (n,) of the line in it, in cells.

    Through a corner the line touches the cells on both sides, at no length.
    """
    along = (end - start).astype(np.float64)
    met = np.concatenate([[0.0, 1.0], *(_edges_met(part) for part in along.tolist())])
    ends = np.unique(met)
    middles = (ends[:-1] + ends[1:]) / 2.0
    under = np.rint(start + middles[:, None] * along)
    touched = np.rint(start + ends[:, None, None] * along + _HAIRS)
    lengths = np.diff(ends) * math.hypot(*along)
    return (
        np.concatenate([under, touched.reshape(-1, 2)]).astype(np.int64),
        np.concatenate([lengths, np.zeros(touched.size // 2)]),
    )


def _edges_met(along: float) -> FloatArray:
    """The shares of a line, between 0 and 1, at which it meets an edge of cells on one axis."""
    count = round(abs(along))
    if not count:
        return np.zeros(0)
    return (np.arange(count) + 0.5) / count


def _corners(way: IntArray, price: FloatArray) -> list[int]:
    """Rows of a way between which a straight line may be drawn: Douglas and Peucker (1973)."""
    kept, waiting = {0, len(way) - 1}, [(0, len(way) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        stray = _stray(way[first : last + 1])
        open_line = math.isfinite(line_price(way[first], way[last], price))
        if float(stray.max()) > _STRAY_CELLS or not open_line:
            corner = first + 1 + int(np.argmax(stray[1:-1]))
            kept.add(corner)
            waiting += [(first, corner), (corner, last)]
    return sorted(kept)


def _stray(way: IntArray) -> FloatArray:
    """(n,) how far the cells of a way lie from the straight line between its ends, in cells."""
    along = way[-1] - way[0]
    length = float(np.sqrt(np.sum(along**2)))
    rows, columns = (way - way[0]).T
    if length == 0.0:
        return np.asarray(np.hypot(rows, columns))
    return np.asarray(np.abs(rows * along[1] - columns * along[0]) / length)


def _pulled(corners: IntArray, price: FloatArray) -> IntArray:
    """The corners without those that a straight line can leave out at no higher price."""
    prices = [line_price(a, b, price) for a, b in itertools.pairwise(corners)]
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

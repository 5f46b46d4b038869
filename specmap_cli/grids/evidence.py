"""What scans prove, in cells: their fans and the robot's footprints, of many scans at once.

One scan has some hundreds of beams: calls on arrays that short cost more than their arithmetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, PlanarScan
from specmap_cli.core.settings import GridConfig

SURFACE_GAP_M = 0.3  # returns this close bound one surface
SUBPIXEL_BITS = 4  # OpenCV draws on a lattice of 1/16 cell, finer than a laser's noise

Cell = tuple[int, int]  # column and row
_Indices = NDArray[np.intp]


class Fan(NamedTuple):
    """What one scan proves about cells `low` to `high`, the latter not among them.

    `star` (k, 2) are the corners of what its beams passed through, in 1/16 cells from the centre of
    cell `low`: from the laser along each surface and back. `columns` and `rows` (m,) are the cells
    of its returns, counted from `low`.
    """

    low: Cell
    high: Cell
    star: NDArray[np.int32]
    columns: _Indices
    rows: _Indices


def fans_of(
    scans: Sequence[PlanarScan], grid_from_laser: FloatArray, config: GridConfig
) -> list[Fan | None]:
    """The fan of each scan, taken at `grid_from_laser` (n, 3); None where nothing came back."""
    ranges = np.concatenate([scan.ranges for scan in scans])
    returned = np.isfinite(ranges) & (ranges > 0.0)
    before = np.cumsum([0, *(len(scan.ranges) for scan in scans)])
    beams = np.flatnonzero(returned)
    bounds = np.searchsorted(beams, before)
    some = np.flatnonzero(np.diff(bounds))  # below, arrays have a row for each of these scans
    fans: list[Fan | None] = [None] * len(scans)
    if not len(some):
        return fans
    bearings = np.concatenate([scan.bearings for scan in scans])[beams]
    ranges, first, counts = ranges[beams], bounds[some], np.diff(bounds)[some]
    x, y = _ends(bearings, ranges, np.repeat(grid_from_laser[some].T, counts, axis=1), config)
    laser = grid_from_laser[some, :2] / config.resolution_m
    low, high = _boxes(x, y, first, laser)
    x -= np.repeat(low[:, 0], counts)
    y -= np.repeat(low[:, 1], counts)
    opens = _openings(beams, x, y, first, SURFACE_GAP_M / config.resolution_m)
    star, starts = _stars(x, y, laser - low, opens, first)
    hit = ranges <= config.max_range_m
    returns = np.concatenate([[0], np.cumsum(np.add.reduceat(hit, first, dtype=np.intp))])
    columns, rows = x[hit].astype(np.intp), y[hit].astype(np.intp)
    for number, one, other, (begin, end), (some_hit, last_hit) in zip(
        some.tolist(),
        _pairs(low),
        _pairs(high),
        pairwise([*starts.tolist(), len(star)]),
        pairwise(returns.tolist()),
        strict=True,
    ):
        own = slice(some_hit, last_hit)
        fans[number] = Fan(one, other, star[begin:end], columns[own], rows[own])
    return fans


def _ends(
    bearings: FloatArray, ranges: FloatArray, lasers: FloatArray, config: GridConfig
) -> tuple[FloatArray, FloatArray]:
    """Where beams end, in cells: (N,) columns and rows with their fractions; `lasers` (3, N)."""
    bearings = bearings + lasers[2]
    ranges = np.minimum(ranges, config.max_range_m)
    x = (np.cos(bearings) * ranges + lasers[0]) / config.resolution_m
    y = (np.sin(bearings) * ranges + lasers[1]) / config.resolution_m
    return x, y


def _boxes(
    x: FloatArray, y: FloatArray, first: _Indices, laser: FloatArray
) -> tuple[_Indices, _Indices]:
    """The box (n, 2) low and high of cells round each scan's ends and its `laser` (n, 2).

    There is a spare cell on each side. The ends of scan i begin at number `first` (n,).
    """
    low, high = (
        np.stack([extreme.reduceat(side, first) for side in (x, y)], axis=1)
        for extreme in (np.minimum, np.maximum)
    )
    low, high = np.floor(np.minimum(low, laser)), np.floor(np.maximum(high, laser))
    return low.astype(np.intp) - 1, high.astype(np.intp) + 2


def _openings(
    beams: _Indices, x: FloatArray, y: FloatArray, first: _Indices, gap: float
) -> _Indices:
    """Numbers of the ends at which another surface begins than that of the beam before."""
    opens = np.empty(len(x), dtype=np.bool_)
    opens[1:] = np.diff(beams) != 1
    opens[1:] |= np.diff(x) ** 2 + np.diff(y) ** 2 > gap * gap
    opens[first] = True
    return np.flatnonzero(opens)


def _stars(
    x: FloatArray, y: FloatArray, laser: FloatArray, opens: _Indices, first: _Indices
) -> tuple[NDArray[np.int32], _Indices]:
    """The stars of all scans, one after the other, and where each begins.

    A star stands at its scan's laser (n, 2) before the first end of each surface.
    """
    scan = np.searchsorted(first, opens, side="right") - 1
    star = np.empty((len(x) + len(opens), 2), dtype=np.int32)
    lasers = opens + np.arange(len(opens))
    ends = np.ones(len(star), dtype=np.bool_)
    ends[lasers] = False
    for side, places in enumerate((x, y)):
        star[ends, side] = _fixed(places)
        star[lasers, side] = _fixed(laser[scan, side])
    return star, lasers[np.searchsorted(opens, first)]


def _fixed(places: FloatArray) -> NDArray[np.int32]:
    """Places, in cells from a corner, as OpenCV counts them: 1/16 from the middle of a cell."""
    return np.round((places - 0.5) * (1 << SUBPIXEL_BITS)).astype(np.int32)


class Footprints(NamedTuple):
    """Discs of cells: each in a box of cells from `low` to `high`, the latter not among them.

    `inside` (n, s, s) says of rows and columns from `low` on whether the cell's centre is covered.
    """

    low: list[Cell]
    high: list[Cell]
    inside: BoolArray

    def cells(self, chosen: Sequence[bool]) -> tuple[_Indices, _Indices]:
        """Columns and rows (m,) of the cells of the chosen discs, a cell of each."""
        disc, rows, columns = np.nonzero(self.inside & np.array(chosen)[:, None, None])
        low = np.array(self.low)[disc]
        return columns + low[:, 0], rows + low[:, 1]


def footprints_of(places: FloatArray, radius_m: float, resolution_m: float) -> Footprints:
    """What a robot of that radius covers that stands at `places` (n, 2 or more columns), metres."""
    centre, reach = places[:, :2] / resolution_m, radius_m / resolution_m
    low = np.floor(centre - reach)
    high = np.floor(centre + reach).astype(np.intp) + 1
    side = np.arange(int(2.0 * reach) + 2)
    off = low[:, None, :] + side[:, None] + 0.5 - centre[:, None, :]
    squares = off * off
    inside = squares[:, :, None, 1] + squares[:, None, :, 0] <= reach * reach
    return Footprints(_pairs(low.astype(np.intp)), _pairs(high), inside)


def _pairs(cells: _Indices) -> list[Cell]:
    """Columns and rows (n, 2) as whole numbers of Python."""
    return [(column, row) for column, row in cells.tolist()]

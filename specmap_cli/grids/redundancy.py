"""Which keyframes of older recordings newer ones repeat: the map can do without them.

A place is shown well by as many scans as it takes for every cell of a surface to be hit, as far as
the grid reaches. Where newer recordings have so many from the same place, in the same direction,
older ones add nothing, but for walls that nobody else looks at.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angles
from specmap_cli.core.records import BoolArray, IntArray, PlanarScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import DIRECTION_RAD, LOOKS, PLACE_M, KeyframeStore

_ROUNDING = 1e-9  # of shares that add up to one
_LASER_M = 1.0  # how far from the middle of the robot a laser may stand
_STRIDE = 8  # neighbours show the same: first one of so many is asked, then the others


def enough_looks(scan: PlanarScan, config: GridConfig) -> int:
    """How many scans from one place show every cell of a surface, as far as the grid reaches.

    There two beams of a scan are as many cells apart, at most; and no cell needs more than `LOOKS`.
    """
    spacing = float(scan.bearings[-1] - scan.bearings[0]) / max(len(scan.bearings) - 1, 1)
    reach_m = min(scan.range_max, config.max_range_m)
    return min(LOOKS, max(1, math.ceil(reach_m * spacing / config.resolution_m)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """Keyframes at `poses` (n, 3) of the recordings `of` (n,), 0, 1, ... in the order of adding.

    For each recording: `enough` (R,) scans of it show a place, and whether these look `all_round`
    (R,), so that it does not matter which way the robot faced.
    """

    poses: FloatArray
    of: IntArray
    enough: IntArray
    all_round: BoolArray


def repeated(recorded: Recorded, needed: BoolArray) -> BoolArray:
    """(n,) the keyframes that the map can do without, none of those `needed` (n,) for themselves.

    The last recording was there, and it and the ones between, of what is kept of them, were there
    often enough.
    """
    gone = np.zeros(len(needed), dtype=bool)
    last = len(recorded.enough) - 1
    for recording in reversed(range(last)):
        own = np.flatnonzero((recorded.of == recording) & ~needed)
        newer = np.flatnonzero((recorded.of > recording) & ~gone)
        old, new = _pairs(recorded, own, newer)
        share = np.bincount(old, 1.0 / recorded.enough[recorded.of[new]], len(own))
        again = np.bincount(old, recorded.of[new] == last, len(own))
        gone[own[(again > 0) & (share >= 1.0 - _ROUNDING)]] = True
    return gone


def _pairs(recorded: Recorded, own: IntArray, newer: IntArray) -> tuple[IntArray, IntArray]:
    """The pairs (P,) of keyframes that look alike: places in `own`, and numbers of newer ones."""
    if not len(own) or not len(newer):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    places, there = (cKDTree(recorded.poses[some, :2]) for some in (own, newer))
    found = places.sparse_distance_matrix(there, PLACE_M, output_type="ndarray")
    old, new = found["i"].astype(np.int64), newer[found["j"]]
    turn = np.abs(wrap_angles(recorded.poses[own[old], 2] - recorded.poses[new, 2]))
    alike = recorded.all_round[recorded.of[new]] | (turn <= DIRECTION_RAD)
    return old[alike], new[alike]


def last_witnesses(
    store: KeyframeStore,
    gone: BoolArray,
    poses: FloatArray,
    walls: GridMap,
    unseen: BoolArray,
    max_range_m: float,
) -> IntArray:
    """Those of the keyframes `gone` (n,) that show walls which no other one shows, ascending (k,).

    The first n keyframes of the store stood at `poses` (n, 3) in the map of the grid `walls`; its
    cells `unseen` (H, W) are those of walls that recordings after these did not look at. Of several
    that show such a wall the last one stays.
    """
    shown = _Shown(store, poses, walls, max_range_m)
    claims, left = {}, np.asarray(unseen).copy()
    for number, cells in shown.among(np.flatnonzero(gone)[::-1], left):
        claims[number] = cells[left[cells[:, 0], cells[:, 1]]]
        _clear(left, cells)
    claimed = np.zeros(unseen.shape, dtype=bool)
    for cells in claims.values():
        claimed[cells[:, 0], cells[:, 1]] = True
    others = np.flatnonzero(~gone)
    for _, cells in shown.among(others[np.argsort(others % _STRIDE, kind="stable")], claimed):
        _clear(claimed, cells)
    stay = [number for number, cells in claims.items() if claimed[cells[:, 0], cells[:, 1]].any()]
    return np.array(sorted(stay), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class _Shown:
    """The cells of a grid that keyframes at `poses` (n, 3) hit."""

    store: KeyframeStore
    poses: FloatArray
    walls: GridMap
    max_range_m: float

    def among(self, numbers: IntArray, wanted: BoolArray) -> Iterator[tuple[int, IntArray]]:
        """Keyframes, in turn, that hit any of the cells `wanted` (H, W) by then, with all they hit.

        It ends when nothing is wanted any more.
        """
        for number in numbers[self._near(numbers, wanted)].tolist():
            cells = self._cells(number)
            if wanted[cells[:, 0], cells[:, 1]].any():
                yield number, cells
                if not wanted.any():
                    return

    def _near(self, numbers: IntArray, wanted: BoolArray) -> BoolArray:
        """Which of some keyframes have a wanted cell within reach."""
        centres = self.walls.centres_of(np.argwhere(wanted))
        if not len(centres) or not len(numbers):
            return np.zeros(len(numbers), dtype=bool)
        places = self.poses[numbers, :2]
        away = cKDTree(centres).query(places, distance_upper_bound=self.max_range_m + _LASER_M)[0]
        return np.asarray(np.isfinite(away))

    def _cells(self, number: int) -> IntArray:
        """(N, 2) rows and columns, on the grid."""
        points = self.store.points(number, self.max_range_m)
        cells = self.walls.cells_of(Pose2(*self.poses[number].tolist()).apply(points))
        return cells[self.walls.inside(cells)]


def _clear(left: BoolArray, cells: IntArray) -> None:
    """Take some cells (N, 2) and those around them, as far as a scan errs, out of a mask."""
    rows, columns = left.shape
    for down, right in product((-1, 0, 1), repeat=2):
        down_to = np.clip(cells[:, 0] + down, 0, rows - 1)
        left[down_to, np.clip(cells[:, 1] + right, 0, columns - 1)] = False

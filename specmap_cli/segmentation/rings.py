"""Rings of corridors: a region that goes round more than it holds is cut into its sides."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import BoolArray, bands_of, looked_up
from specmap_cli.segmentation.cells import spread_labels
from specmap_cli.segmentation.visibility import LabelArray

_BESIDE = np.ones((3, 3), dtype=np.uint8)


def without_rings(labels: LabelArray) -> LabelArray:
    """Regions (h, w) of an upright map of which none is a ring: the sides of one are regions."""
    count = int(labels.max(initial=-1)) + 1
    if not count:
        return labels
    sides = labels.copy()
    for label, window in enumerate(ndimage.find_objects(labels + 1)):
        region = np.pad(labels[window] == label, 1)
        beyond = (~region).view(np.uint8)
        _, around, stats, _ = cv2.connectedComponentsWithStats(beyond, connectivity=4)
        del beyond
        cuts, size = np.zeros_like(region), stats[:, cv2.CC_STAT_AREA]
        for number, (left, top, wide, high, _) in enumerate(stats.tolist()):
            if number not in (0, around[0, 0]):
                large = 2 * size >= size[number]  # an obstacle that is smaller is passed over
                large[[0, around[0, 0]]] = False, True
                rows = slice(max(0, top - high), top + 2 * high)
                near = rows, slice(max(0, left - wide), left + 2 * wide)
                _cut_round(around[near] == number, looked_up(large, around[near]), cuts[near])
        cuts &= region
        if not cuts.any():
            continue
        del around
        rest = (region & ~cuts).view(np.uint8)
        pieces, piece, stats, _ = cv2.connectedComponentsWithStats(rest, connectivity=8)
        beside = np.unique(piece[(cv2.dilate(cuts.view(np.uint8), _BESIDE) & rest).view(np.bool_)])
        scrap = stats[beside, cv2.CC_STAT_AREA] <= np.count_nonzero(cuts)
        names = np.full(pieces, label, dtype=sides.dtype)
        names[beside[scrap]] = -1
        more = beside[~scrap][1:]
        names[more] = count + np.arange(len(more))
        count += len(more)
        names[0] = -1  # the cuts, of all that is of the region
        inner = slice(1, -1), slice(1, -1)
        for rows in bands_of(sides[window].shape):
            own = region[inner][rows]
            sides[window][rows][own] = names[piece[inner][rows][own]]
    spread_labels(sides, labels >= 0)
    return sides


def _cut_round(hole: BoolArray, solid: BoolArray, cuts: BoolArray) -> None:
    """Mark in `cuts` (h, w) where a region is cut that is a ring round a hole (h, w).

    It is one when the hole is larger than the floor round it, as wide as it is at the corners of
    the hole; nothing farther away than the hole is wide can matter. The longer sides own these
    corners: the others end where the longer ones go by.
    """
    sides = [int(np.ptp(_extent(hole.sum(axis=axis)))) + 1 for axis in (0, 1)]
    whole = 1
    for across in (sides[0] >= sides[1], sides[0] < sides[1]):  # the last are the cuts
        views = [one.T if across else one for one in (hole, solid, cuts)]
        corners = [[one[::up, ::left] for one in views] for up in (1, -1) for left in (1, -1)]
        ends = [_cut(*one[:2]) for one in corners]
        beside = [stop - start for _, start, stop in ends]
        whole *= sides[across] + max(beside[0] + beside[1], beside[2] + beside[3])
    if 2 * sides[0] * sides[1] > whole:
        for (_, _, view), (row, start, stop) in zip(corners, ends, strict=True):
            view[row, start:stop] = True


def _cut(hole: BoolArray, solid: BoolArray) -> tuple[int, int, int]:
    """Row, first column and end of the cut from the left of a hole (h, w) to what is solid beyond.

    It is looked for from the first row of the hole to its middle; a row farther has to be shorter
    by as much. So no cut runs along another corridor, or through a bay.
    """
    first, last = _extent(hole.sum(axis=1))
    rows = np.arange(first, (first + last) // 2 + 1)
    stops = hole[rows].argmax(axis=1)
    before = solid[rows] & (np.arange(hole.shape[1]) < stops[:, None])
    last = hole.shape[1] - 1 - before[:, ::-1].argmax(axis=1)
    beyond = np.where(before.any(axis=1), last, -1)
    best = int((stops - beyond + rows).argmin())
    return int(rows[best]), int(beyond[best]) + 1, int(stops[best])


def _extent(counts: IntArray) -> tuple[int, int]:
    """The first and the last place where a hole is at least half as wide as at its widest."""
    wide = np.flatnonzero(2 * counts >= counts.max())
    return int(wide[0]), int(wide[-1])

"""From labelled nodes to labelled cells (last step of section II-B).

Labels are flooded from the nodes, or taken from the nearest one as in the paper; clusters that no
narrowing separates are joined; and several divisions of the same cells become one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import (
    BoolArray,
    CellArray,
    LengthArray,
    bands_of,
    contacts,
    joined,
    looked_up,
    nearest_values,
    window_of,
)
from specmap_cli.segmentation.visibility import IndexArray, LabelArray

Pair = tuple[int, int]

_RINGS = 3  # cells by which labels creep: the fringe of free cells beside a wall of 0.1 m cells
_LEVELS = 126  # heights of the relief that is flooded: the sum of two of them, and one, fit a byte
_BY_ONE = np.array([-1, 0, 1])  # rows, or columns: a cell and those round it
_AT_ONCE = 1 << 16  # cells that are looked round at in one go: bounds the memory
_BESIDE = 1.5  # cells, from one to those round it
_TILE, _AROUND_TILE = 1024, 128  # cells: a tile is flooded with what is around it
_NEAR_TILE, _NEAR = 256, 32  # cells looked at together for the nearest label, and how far at first
_TINY = 1e-9  # cells; keeps a grid without free space from dividing by zero

_RATIO_SLACK = 1e-9  # a border of just the ratio asked for joins, whatever the last digit

_SAME = 0.5  # intersection over union above which regions are the same: each has one such at most


def relief_of(clearance: LengthArray) -> CellArray:
    """(h, w) the heights that labels flood: they fall as the clearance grows; 0 for what is a wall.

    OpenCV's watershed takes cells by the difference between neighbours, so heights stand on a
    checkerboard of signs.
    """
    relief = np.empty(clearance.shape, dtype=np.uint8)
    top = max(float(clearance.max(initial=0.0)), _TINY)
    for rows in bands_of((len(clearance), clearance.shape[1] * 16)):
        height = np.divide(clearance[rows], -top, dtype=np.float64)
        height += 1.0
        height *= _LEVELS
        low = np.rint(height, out=height).astype(np.uint8)
        odd = (np.arange(rows.start, rows.stop)[:, None] + np.arange(low.shape[1])) % 2 == 1
        relief[rows] = np.where(odd, low + np.uint8(_LEVELS + 2), np.uint8(_LEVELS + 1) - low)
        relief[rows][clearance[rows] <= 0.0] = 0
    return relief


def flood_labels(relief: CellArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) labels grown from the nodes (n, 2) in order of falling clearance; -1 unreached.

    A large map is flooded a tile after the other, each with what is around it: a front comes from a
    node of its own block of cells, or of one near by, and tiles without free space cost nothing.
    """
    found = np.full(relief.shape, -1, dtype=np.int16)
    for row, column in product(*(range(0, side, _TILE) for side in relief.shape)):
        shown = window_of(relief[row : row + _TILE, column : column + _TILE] > 0)
        if shown is None:
            continue
        corner = [first + part.start for first, part in zip((row, column), shown, strict=True)]
        size = [part.stop - part.start for part in shown]
        low = np.maximum(np.array(corner) - _AROUND_TILE, 0)
        high = np.add(corner, size) + _AROUND_TILE
        near = ((nodes >= low) & (nodes < high)).all(axis=1)
        if near.any():
            around = relief[low[0] : high[0], low[1] : high[1]]
            flooded = _watershed(around, nodes[near] - low, labels[near])
            own, there = (
                tuple(slice(at, at + side) for at, side in zip(corner - shift, size, strict=True))
                for shift in (low, np.zeros(2, dtype=np.intp))
            )
            found[there] = flooded[own]
    spread_labels(found, relief)
    return found


def flooded_at(
    clearance: LengthArray, nodes: IndexArray, labels: LabelArray, cells: IndexArray
) -> LabelArray:
    """(p,) the labels of a flood from the nodes (n, 2) at cells (p, 2), there being a node.

    Only the box round the nodes and the cells is flooded, and labels are spread only where asked.
    """
    low = np.minimum(nodes.min(axis=0), cells.min(axis=0))
    high = np.maximum(nodes.max(axis=0), cells.max(axis=0)) + 1
    relief, nodes = relief_of(clearance[low[0] : high[0], low[1] : high[1]]), nodes - low
    flooded, cells = _watershed(relief, nodes, labels), cells - low
    found = np.asarray(flooded[tuple(cells.T)])
    lines = np.flatnonzero((found < 0) & (relief[tuple(cells.T)] > 0))
    found[lines] = flooded.take(_around(cells[lines], flooded.shape)).max(axis=1)
    if (found[lines] >= 0).all():
        return found
    spread_labels(flooded, relief)
    return np.asarray(flooded[tuple(cells.T)])


def _watershed(relief: CellArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) labels flooded from the nodes (n, 2); -1 on the lines between two of them and apart.

    Meyer's watershed: two fronts meet where the passage is narrowest, as the relief is highest
    there. A second channel makes the step into a wall the last.
    """
    free = relief > 0
    layers = relief, np.where(free, np.uint8(0), np.uint8(255)), np.zeros_like(relief)
    picture = cv2.copyMakeBorder(
        cv2.merge(layers), *(1, 1, 1, 1), cv2.BORDER_CONSTANT, value=(0, 255, 0)
    )
    del layers
    markers = np.zeros(picture.shape[:2], dtype=np.int32)
    markers[nodes[:, 0] + 1, nodes[:, 1] + 1] = labels + 1
    cv2.watershed(picture, markers)
    del picture
    flooded = markers[1:-1, 1:-1].astype(np.int16)
    del markers
    flooded -= 1
    flooded[(flooded < 0) | ~joined(free, tuple(nodes.T), connectivity=8)] = -1
    return flooded


def nearest_labels(relief: CellArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) the label of the nearest node (n, 2) for every free cell, as in the paper."""
    result = np.full(relief.shape, -1, dtype=np.int16)
    if len(nodes):
        cells = np.argwhere(relief)
        result[tuple(cells.T)] = labels[cKDTree(nodes).query(cells)[1]]
    return result


def spread_labels(
    labels: LabelArray, free: BoolArray | CellArray, rings: int = _RINGS, *, everywhere: bool = True
) -> None:
    """Fill, in place, what is unlabelled (-1) of every piece of `free` (H, W) that holds a label.

    Labels creep `rings` cells through free space, so that none crosses a thin wall; what is left
    takes the nearest label of all, if they are to go `everywhere`. Time and memory go with the
    cells to fill, which are few, and not with the map.
    """
    lacking = [
        np.argwhere((free[rows] > 0) & (labels[rows] < 0)) for rows in bands_of(labels.shape)
    ]
    for rows, some in zip(bands_of(labels.shape), lacking, strict=True):
        some[:, 0] += rows.start
    cells = np.concatenate([np.zeros((0, 2), dtype=np.intp), *lacking])
    for _ in range(rings):
        highest = [labels.take(_around(some, labels.shape)).max(axis=1) for some in _chunks(cells)]
        found = np.concatenate(highest)
        labels[tuple(cells.T)] = found
        cells = cells[found < 0]
    if everywhere and len(cells):
        joins = cKDTree(cells).query_pairs(_BESIDE, output_type="ndarray")
        piece = _joined(len(cells), joins)
        held = np.zeros(len(cells), dtype=np.bool_)
        for some, numbers in zip(_chunks(cells), _chunks(piece), strict=True):
            around = _around(some, labels.shape)
            known = (free.take(around) > 0) & (labels.take(around) >= 0)
            held[numbers[known.any(axis=1)]] = True
        cells = cells[held[piece]]
        if len(cells):
            labels[tuple(cells.T)] = labels_near(labels, cells)


def _around(cells: IndexArray, shape: tuple[int, ...]) -> IndexArray:
    """(n, 9) where in a grid, flat, each of some cells (n, 2) is and those around it are."""
    rows, columns = (
        np.clip(along[:, None] + _BY_ONE, 0, side - 1)
        for along, side in zip(cells.T, shape, strict=True)
    )
    around: IndexArray = rows[:, :, None] * shape[1] + columns[:, None, :]
    return around.reshape(len(cells), _BY_ONE.size**2)


def _chunks(rows: IndexArray) -> list[IndexArray]:
    """Some rows (n, ...) in parts of a bounded size, at least one."""
    return [rows[first : first + _AT_ONCE] for first in range(0, max(len(rows), 1), _AT_ONCE)]


def labels_near(labels: LabelArray | IntArray, cells: IndexArray) -> LabelArray | IntArray:
    """(n,) the label of the cell that is nearest to each of some cells (n, 2) and has one.

    Only what is round the cells is looked at, wider where no label is as near.
    """
    found, tiles = np.empty(len(cells), dtype=labels.dtype), cells // _NEAR_TILE
    order = np.lexsort(tiles.T)
    ends = np.flatnonzero(np.diff(tiles[order], axis=0).any(axis=1)) + 1
    for own in np.split(order, ends):
        low, high, reach = cells[own].min(axis=0), cells[own].max(axis=0) + 1, _NEAR
        while True:
            first = np.maximum(low - reach, 0)
            look = labels[first[0] : high[0] + reach, first[1] : high[1] + reach]
            values, away = nearest_values(look + np.int16(1))
            at = tuple((cells[own] - first).T)
            if look.shape == labels.shape or away[at].max() <= reach:
                break
            reach *= 4
        found[own] = values[at] - np.int16(1)
    return found


def local_widths(
    clearance: LengthArray, lengths: FloatArray, pairs: IndexArray, widest: float
) -> LengthArray:
    """(n,) local thickness at each node: the largest free disc of a visible node that covers it.

    `clearance` (n,) is each node's own, `lengths` (m,) the distances of the visible `pairs` (m, 2).
    No width is above `widest`. A hall falls into pieces no larger than a sight line, and a border
    that is wide compared with those pieces has to count as wide.
    """
    widths = clearance.copy()
    for one, other in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
        covered = lengths < clearance[other]
        np.maximum.at(widths, one[covered], clearance[other[covered]])
    return np.minimum(widths, widest)


def border_widths(labels: LabelArray, clearance: LengthArray) -> dict[Pair, float]:
    """Largest clearance on the common border of each two touching labels (smaller one first)."""
    touching = contacts(labels)
    width = np.minimum(clearance[tuple(touching.one.T)], clearance[tuple(touching.other.T)])
    one, other = touching.labels.T.astype(np.int64)
    pairs, which = np.unique((one << 16) | other, return_inverse=True)  # labels have 16 bits
    widest = np.zeros(len(pairs))
    np.maximum.at(widest, which, width)
    return {(a >> 16, a & 0xFFFF): w for a, w in zip(pairs.tolist(), widest.tolist(), strict=True)}


def joined_wide(borders: dict[Pair, float], widths: list[float], ratio: float) -> LabelArray:
    """(k,) the new label of each cluster, of some `widths` (k,), after joining those it goes on in.

    A border joins two clusters when it is at least `ratio` times as wide as they are, by their
    geometric mean: a corridor goes on where its width goes on, and ends where it opens into a hall.
    """
    joins = [
        (one, other)
        for (one, other), border in borders.items()
        if border >= ratio * (widths[one] * widths[other]) ** 0.5 - _RATIO_SLACK
    ]
    return components(len(widths), joins)


def without_dead_ends(
    labels: LabelArray, clearance: LengthArray, least: float, smallest: float
) -> LabelArray:
    """Regions (h, w) of which none is a dead end of fewer than `smallest` cells.

    A dead end has one neighbour that a robot of the radius `least` gets to, and is a part of it.
    """
    size = np.bincount(labels[labels >= 0], minlength=1)
    around: dict[int, set[int]] = {}
    for (one, other), border in border_widths(labels, clearance).items():
        if border >= least:
            around.setdefault(one, set()).add(other)
            around.setdefault(other, set()).add(one)
    ends = [(one, *near) for one, near in around.items() if len(near) == 1]
    joins = [(one, other) for one, other in ends if size[one] < smallest]
    names = components(len(size), joins)
    return looked_up(np.append(names, np.int16(-1)), labels)  # the last is that of no region


def components(count: int, pairs: Sequence[Pair]) -> LabelArray:
    """(count,) numbers 0, 1, ... that are the same for what the pairs join."""
    return _joined(count, np.array(pairs, dtype=np.intp).reshape(-1, 2)).astype(np.int16)


def _joined(count: int, pairs: IndexArray) -> IndexArray:
    """(count,) as `components`, for pairs (m, 2) of whatever number."""
    graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def consensus(divisions: Sequence[LabelArray]) -> LabelArray:
    """(h, w) labels 0, 1, ... of what some divisions (h, w) agree on; -1 where all have none.

    The division that is most like the others gives the regions; what it leaves without a label, the
    first that has one. Each cell goes to the region in which most divisions have it; a region of
    another division is the one with which it shares more than `_SAME`. Deterministic: of equals
    that division counts, then the first.
    """
    # cells that have the same labels in all divisions are of one kind; a run of a kind is looked at
    # once
    flat = [division.ravel() for division in divisions]
    begins = np.ones(flat[0].size, dtype=np.bool_)
    begins[1:] = False
    for division in flat:
        begins[1:] |= division[1:] != division[:-1]
    runs = np.flatnonzero(begins)
    lengths = np.diff(runs, append=begins.size)
    table = np.column_stack([division[runs] for division in flat]) + np.int16(1)  # 0: no label
    kinds, of_run = np.unique(table, axis=0, return_inverse=True)
    of_run = of_run.ravel()
    cells = np.bincount(of_run, lengths, len(kinds))
    named = _agreed([kind.copy() for kind in kinds.T], np.where(kinds.any(axis=1), cells, 0.0))
    return np.repeat(named[of_run], lengths).reshape(divisions[0].shape)


def _agreed(others: list[LabelArray], cells: FloatArray) -> LabelArray:
    """(k,) `consensus` of kinds of so many `cells` (k,); labels `others` (k,) from 1 on, or 0."""
    likeness = [math.fsum(_alike(one, other, cells)[1] for other in others) for one in others]
    middle = others.pop(int(np.argmax(likeness)))
    for other in others:
        new = (middle == 0) & (other > 0)
        middle = np.where(new, middle.max(initial=0) + other, middle)
    votes = [middle]
    for other in others:
        iou = _alike(middle, other, cells)[0]
        same = np.where(iou.max(axis=0) > _SAME, iou.argmax(axis=0), 0).astype(np.int16)
        votes.append(same[other])
    cast = np.array(votes)
    count = np.where(cast > 0, (cast[:, None] == cast).sum(axis=1), 0)
    agreed = np.take_along_axis(cast, count.argmax(axis=0)[None], axis=0)[0]
    names = np.cumsum(np.bincount(agreed, minlength=1)[1:] > 0)
    return np.asarray(np.append(-1, names - 1).astype(np.int16)[agreed])


def _alike(one: LabelArray, other: LabelArray, cells: FloatArray) -> tuple[FloatArray, float]:
    """IoU (k, l) of regions 1, 2, ... of two divisions (n,) of such `cells`; mean of the best."""
    shape = int(one.max(initial=0)) + 1, int(other.max(initial=0)) + 1
    pairs = np.multiply(one, shape[1], dtype=np.intp) + other
    shared = np.bincount(pairs, cells, shape[0] * shape[1]).reshape(shape)
    mine, theirs = shared.sum(axis=1), shared.sum(axis=0)
    iou = shared / np.maximum(mine[:, None] + theirs - shared, 1)
    iou[0], iou[:, 0] = 0.0, 0.0
    regions = int((mine[1:] > 0).sum() + (theirs[1:] > 0).sum())
    # exact sums: what labels are called changes no digit
    return iou, math.fsum([*iou.max(axis=0), *iou.max(axis=1)]) / max(regions, 1)

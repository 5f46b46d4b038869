"""From labelled nodes to labelled cells (last step of section II-B).

Labels are flooded from the nodes, or taken from the nearest one as in the paper; clusters that no
narrowing separates are joined; and several divisions of the same cells become one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import (
    BoolArray,
    LengthArray,
    contacts,
    looked_up,
    nearest_values,
    window_of,
)
from specmap_cli.segmentation.visibility import IndexArray, LabelArray

Pair = tuple[int, int]

_RINGS = 3  # cells by which labels creep: the fringe of free cells beside a wall of 0.1 m cells
_LEVELS = 126  # heights of the relief that is flooded: the sum of two of them, and one, fit a byte
_AROUND = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])
_TILE, _AROUND_TILE = 2048, 128  # cells, both even: a tile is flooded with what is around it
_TINY = 1e-9  # cells; keeps a grid without free space from dividing by zero

_RATIO_SLACK = 1e-9  # a border of just the ratio asked for joins, whatever the last digit

_SAME = 0.5  # intersection over union above which regions are the same: each has one such at most


def flood_labels(clearance: LengthArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) labels grown from the nodes (n, 2) in order of falling clearance; -1 unreached.

    A large map is flooded a tile after the other, each with what is around it: a front comes from a
    node of its own block of cells, or of one near by, and tiles without free space cost nothing.
    """
    found = np.full(clearance.shape, -1, dtype=np.int16)
    top = float(clearance.max(initial=0.0))
    for row, column in product(*(range(0, side, _TILE) for side in clearance.shape)):
        shown = window_of(clearance[row : row + _TILE, column : column + _TILE] > 0.0)
        if shown is None:
            continue
        corner = [first + part.start for first, part in zip((row, column), shown, strict=True)]
        size = [part.stop - part.start for part in shown]
        low = np.maximum(np.array(corner) // 2 * 2 - _AROUND_TILE, 0)  # even: as of the whole map
        high = np.add(corner, size) + _AROUND_TILE
        near = ((nodes >= low) & (nodes < high)).all(axis=1)
        if near.any():
            around = clearance[low[0] : high[0], low[1] : high[1]]
            flooded = _watershed(around, nodes[near] - low, labels[near], top)
            own, there = (
                tuple(slice(at, at + side) for at, side in zip(corner - shift, size, strict=True))
                for shift in (low, np.zeros(2, dtype=np.intp))
            )
            found[there] = flooded[own]
    return spread_labels(found, clearance > 0.0)


def flooded_at(
    clearance: LengthArray, nodes: IndexArray, labels: LabelArray, cells: IndexArray
) -> LabelArray:
    """(p,) the labels of a flood from the nodes (n, 2) at cells (p, 2), there being a node.

    Only the box round the nodes and the cells is flooded, and labels are spread only where asked.
    """
    low = np.minimum(nodes.min(axis=0), cells.min(axis=0))
    high = np.maximum(nodes.max(axis=0), cells.max(axis=0)) + 1
    clearance, nodes = clearance[low[0] : high[0], low[1] : high[1]], nodes - low
    top = float(clearance.max(initial=0.0))
    flooded, cells = _watershed(clearance, nodes, labels, top), cells - low
    found = np.asarray(flooded[tuple(cells.T)])
    lines = np.flatnonzero((found < 0) & (clearance[tuple(cells.T)] > 0.0))
    around = np.clip(cells[lines, None] + _AROUND, 0, np.array(clearance.shape) - 1)
    found[lines] = flooded[tuple(around.reshape(-1, 2).T)].reshape(-1, 9).max(axis=1)
    if (found[lines] >= 0).all():
        return found
    return np.asarray(spread_labels(flooded, clearance > 0.0)[tuple(cells.T)])


def _watershed(
    clearance: LengthArray, nodes: IndexArray, labels: LabelArray, top: float
) -> LabelArray:
    """(h, w) labels flooded from the nodes (n, 2); -1 on the lines between two of them and apart.

    This is Meyer's watershed on a relief whose height falls with the clearance, from `top` on: two
    fronts meet where the passage between them is narrowest. OpenCV takes cells in the order of the
    difference between neighbours. So the heights stand on a checkerboard of signs, where that
    difference is the sum of both, and a second channel makes the step into a wall the last of all.
    It floods walls, too, and free cells behind them.
    """
    rows, columns = clearance.shape
    share = np.divide(clearance, max(top, _TINY), dtype=np.float64)
    height = np.rint((1.0 - share) * _LEVELS).astype(np.uint8)
    relief = height + np.uint8(_LEVELS + 2)
    for some in (np.s_[::2, ::2], np.s_[1::2, 1::2]):
        relief[some] = np.uint8(_LEVELS + 1) - height[some]
    wall = clearance <= 0.0
    relief[wall] = 0
    picture = np.zeros((rows + 2, columns + 2, 3), dtype=np.uint8)
    picture[:, :, 1] = 255
    picture[1:-1, 1:-1, 0], picture[1:-1, 1:-1, 1] = relief, np.uint8(255) * wall
    markers = np.zeros(picture.shape[:2], dtype=np.int32)
    markers[nodes[:, 0] + 1, nodes[:, 1] + 1] = labels + 1
    cv2.watershed(picture, markers)
    flooded = markers[1:-1, 1:-1].astype(np.int16)
    flooded -= 1
    flooded[(flooded < 0) | ~_held(~wall, tuple(nodes.T))] = -1
    return flooded


def _held(free: BoolArray, seeds: Any) -> BoolArray:
    """(h, w) the cells of the pieces of `free` that hold a seed, joined over edges and corners.

    `seeds` is an index of cells.
    """
    count, piece = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
    held = np.zeros(count, dtype=bool)
    held[piece[seeds]] = True
    held[0] = False
    return looked_up(held, piece)


def nearest_labels(free: BoolArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) the label of the nearest node (n, 2) for every free cell, as in the paper."""
    result = np.full(free.shape, -1, dtype=np.int16)
    if len(nodes):
        cells = np.argwhere(free)
        result[free] = labels[cKDTree(nodes).query(cells)[1]]
    return result


def spread_labels(
    labels: LabelArray, free: BoolArray, rings: int = _RINGS, *, everywhere: bool = True
) -> LabelArray:
    """Fill what is unlabelled (-1) of every piece of `free` (H, W) that holds a label.

    Labels creep `rings` cells through free space, so that none crosses a thin wall; what is left
    takes the nearest label of all, if they are to go `everywhere`.
    """
    missing = free & (labels < 0)
    if not missing.any():
        return labels
    spread, around = labels.astype(np.int16), np.ones((3, 3), dtype=np.uint8)
    for _ in range(rings):
        bigger = cv2.dilate(spread, around)
        open_cells = missing & (spread < 0)
        spread[open_cells] = bigger[open_cells]
    missing &= (spread < 0) & everywhere
    if missing.any():
        missing &= _held(free, spread >= 0)
    if missing.any():
        spread[missing] = nearest_values(spread + np.int16(1))[0][missing] - np.int16(1)
    return spread


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
    pairs, which = np.unique(touching.labels, axis=0, return_inverse=True)
    widest = np.zeros(len(pairs))
    np.maximum.at(widest, which.ravel(), width)
    return {(a, b): w for (a, b), w in zip(pairs.tolist(), widest.tolist(), strict=True)}


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
    ends = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    graph = csr_array((np.ones(ends.shape[1]), (ends[0], ends[1])), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int16)


def consensus(divisions: Sequence[LabelArray]) -> LabelArray:
    """(h, w) labels 0, 1, ... of what some divisions (h, w) agree on; -1 where all have none.

    The division that is most like the others gives the regions; what it leaves without a label, the
    first that has one. Each cell goes to the region in which most divisions have it; a region of
    another division is the one with which it shares more than `_SAME`. Deterministic: of equals
    that division counts, then the first.
    """
    some = np.any([division >= 0 for division in divisions], axis=0)
    others = [division[some] + np.int16(1) for division in divisions]  # 0: no label
    likeness = [math.fsum(_alike(one, other)[1] for other in others) for one in others]
    middle = others.pop(int(np.argmax(likeness)))
    for other in others:
        new = (middle == 0) & (other > 0)
        middle = np.where(new, middle.max(initial=0) + other, middle)
    votes = [middle]
    for other in others:
        iou = _alike(middle, other)[0]
        same = np.where(iou.max(axis=0) > _SAME, iou.argmax(axis=0), 0).astype(np.int16)
        votes.append(same[other])
    cast = np.array(votes)
    split = (cast != middle).any(axis=0)
    cast = cast[:, split]
    count = np.where(cast > 0, (cast[:, None] == cast).sum(axis=1), 0)
    middle[split] = np.take_along_axis(cast, count.argmax(axis=0)[None], axis=0)[0]
    labels = np.full(some.shape, -1, dtype=np.int16)
    labels[some] = np.cumsum(np.bincount(middle, minlength=1)[1:] > 0)[middle - 1] - 1
    return labels


def _alike(one: LabelArray, other: LabelArray) -> tuple[FloatArray, float]:
    """Intersection over union (k, l) of the regions 1, 2, ... of two divisions (n,); 0: no region.

    Also the mean, over the regions of both that have cells, of the best of each.
    """
    shape = int(one.max(initial=0)) + 1, int(other.max(initial=0)) + 1
    pairs = np.multiply(one, shape[1], dtype=np.intp) + other
    shared = np.bincount(pairs, minlength=shape[0] * shape[1]).reshape(shape)
    mine, theirs = shared.sum(axis=1), shared.sum(axis=0)
    iou = shared / np.maximum(mine[:, None] + theirs - shared, 1)
    iou[0], iou[:, 0] = 0.0, 0.0
    regions = int((mine[1:] > 0).sum() + (theirs[1:] > 0).sum())
    # exact sums: what labels are called changes no digit
    return iou, math.fsum([*iou.max(axis=0), *iou.max(axis=1)]) / max(regions, 1)

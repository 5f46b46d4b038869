"""The visibility graph of section II-B: nodes in free space, edges between mutually visible ones.

Lengths inside this module are in coarse cells; the clearance of a node or of a sight line is the
distance to the nearest cell that is not free, from the distance transform.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, LengthArray

LabelArray = NDArray[np.signedinteger[Any]]  # of cells int16: half the memory, and enough
IndexArray = NDArray[np.intp]

_AT_ONCE = 1 << 20  # cells of blocks looked at in one go: bounds the memory
_CHUNK = 1 << 16  # pairs traced at once: bounds the memory
_STEPS = 8  # of all lines before those that have ended are cleared out
_SLACK = 1e-9  # lengths that are equal on paper stay equal in floating point


@dataclass(frozen=True, slots=True)
class VisibilityGraph:
    """Nodes (n, 2), rows and columns; visible pairs i < j (m, 2) and their `lengths` (m,)."""

    nodes: IndexArray
    pairs: IndexArray
    lengths: FloatArray


def visibility_graph(
    clearance: LengthArray, nodes: IndexArray, sight: float, least: float
) -> VisibilityGraph:
    """Edges between all nodes at most `sight` apart whose line keeps more than `least` clear."""
    pairs = near_pairs(nodes, sight)
    pairs = pairs[visible(clearance, nodes, pairs, least)]
    delta = (nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).astype(np.float64)
    return VisibilityGraph(nodes, pairs, np.hypot(delta[:, 0], delta[:, 1]))


def sample_nodes(
    clearance: LengthArray, step: int, least: float, choice: str, before: int = 0
) -> IndexArray:
    """(n, 2) row and column of one node in each block of `step` x `step` cells, in block order.

    `choice` "clearest" takes the cell with the largest clearance of a block, so that nodes stand in
    the middle of rooms and doorways; "centre" takes the block's middle cell. Blocks whose cell has
    no more clearance than `least` give no node. The first block begins `before` rows and columns
    off the grid.
    """
    height, width = clearance.shape
    columns = max(1, -(-(before + width) // step))
    many = step * max(1, _AT_ONCE // (columns * step**2))  # rows of some blocks
    nodes = [np.zeros((0, 2), dtype=np.intp)]
    for top in range(-before, height, many):
        first, end = max(top, 0), min(top + many, height)
        blocks = np.zeros((-(-(end - top) // step) * step, columns * step), dtype=np.float32)
        blocks[first - top : end - top, before : before + width] = clearance[first:end]
        inner = blocks.reshape(-1, step, columns, step).swapaxes(1, 2).reshape(-1, columns, step**2)
        if choice == "clearest":
            chosen = inner.argmax(axis=2)
        else:
            chosen = np.full(inner.shape[:2], (step // 2) * step + step // 2)
        value = np.take_along_axis(inner, chosen[:, :, None], axis=2)[:, :, 0]
        row, column = np.nonzero(value > max(least, 0.0) + _SLACK)
        down, across = np.divmod(chosen[row, column], step)
        nodes.append(np.column_stack([top + row * step + down, column * step + across - before]))
    return np.concatenate(nodes)


def near_pairs(nodes: IndexArray, reach: float) -> IndexArray:
    """(m, 2) pairs i < j of nodes at most `reach` apart, in lexicographic order."""
    if len(nodes) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    if reach >= np.hypot(*np.ptp(nodes, axis=0)):
        return np.column_stack(np.triu_indices(len(nodes), 1))
    pairs = cKDTree(nodes).query_pairs(reach + _SLACK, output_type="ndarray")
    pairs.sort(axis=1)
    order = pairs[:, 0] * len(nodes) + pairs[:, 1]
    del pairs
    order.sort()
    pairs = np.empty((len(order), 2), dtype=np.int32)
    np.floor_divide(order, len(nodes), out=pairs[:, 0], casting="same_kind")
    np.remainder(order, len(nodes), out=pairs[:, 1], casting="same_kind")
    return pairs


def visible(
    clearance: LengthArray, nodes: IndexArray, pairs: IndexArray, least: float
) -> BoolArray:
    """(m,) whether the straight line between each pair keeps more than `least` of clearance.

    A line is walked by the free distance it stands on, which cannot jump over an obstacle, and by
    one cell at least.
    """
    # cells from the first one on as they lie in memory, be they a window of a larger grid
    width, size = clearance.strides[0] // clearance.itemsize, clearance.itemsize
    lying = max((clearance.shape[0] - 1) * width + clearance.shape[1], 0)
    cells = as_strided(clearance, (lying,), (size,), writeable=False)
    seen = np.ones(len(pairs), dtype=bool)
    for first in range(0, len(pairs), _CHUNK):
        start, end = nodes[pairs[first : first + _CHUNK].T]
        delta = (end - start).astype(np.float64)
        length = np.hypot(delta[:, 0], delta[:, 1])
        row, column = start[:, 0].astype(np.float64), start[:, 1].astype(np.float64)
        row_step, column_step = delta[:, 0] / length, delta[:, 1] / length
        gone = np.zeros(len(length))
        alive = first + np.arange(len(length))
        while len(alive):
            # lines that have ended wait at their end, which is clear, until the next clearing out
            for _ in range(_STEPS):
                at, across = row_step * gone, column_step * gone
                at += row
                across += column
                np.rint(at, out=at)
                np.rint(across, out=across)
                at *= width
                at += across
                step = cells.take(at.astype(np.intp))
                step -= least
                blocked = step <= _SLACK
                step -= 1.0
                np.maximum(step, 1.0, out=step)
                step[blocked] = 0.0  # here a line ends
                gone += step
                np.minimum(gone, length, out=gone)
            seen[alive[blocked]] = False
            on = np.flatnonzero(~blocked & (gone < length))
            alive, gone, length = alive[on], gone[on], length[on]
            row, column, row_step, column_step = row[on], column[on], row_step[on], column_step[on]
    return seen

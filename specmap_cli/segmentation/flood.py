"""From labelled nodes to labelled cells (last step of section II-B)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.kmeans import LabelArray
from specmap_cli.segmentation.visibility import IndexArray

RINGS = 3  # cells by which labels creep: the fringe of free cells beside a wall of 0.1 m cells
_LEVELS = 126  # heights of the relief that is flooded: the sum of two of them, and one, fit a byte
_AROUND = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])
_TINY = 1e-9  # cells; keeps a grid without free space from dividing by zero


def flood_labels(clearance: FloatArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) labels grown from the nodes (n, 2) in order of falling clearance; -1 unreached."""
    free = clearance > 0.0
    if not len(nodes):
        return np.full(clearance.shape, -1, dtype=np.int32)
    flooded = _watershed(clearance, nodes, labels)
    piece, held = _pieces(free, nodes)
    flooded[(flooded < 0) | ~held[piece]] = -1
    return spread_labels(flooded, free)


def flooded_at(
    clearance: FloatArray, nodes: IndexArray, labels: LabelArray, cells: IndexArray
) -> LabelArray:
    """(p,) the labels of `flood_labels` at cells (p, 2), there being a node.

    Only the box round the nodes and the cells is flooded, and labels are spread only where asked.
    """
    low = np.minimum(nodes.min(axis=0), cells.min(axis=0))
    high = np.maximum(nodes.max(axis=0), cells.max(axis=0)) + 1
    clearance, nodes, cells = (
        clearance[low[0] : high[0], low[1] : high[1]],
        nodes - low,
        cells - low,
    )
    flooded = _watershed(clearance, nodes, labels)
    piece, held = _pieces(clearance > 0.0, nodes)
    found = _at(flooded, piece, held, cells)
    lines = np.flatnonzero((found < 0) & (piece[cells[:, 0], cells[:, 1]] > 0))
    around = np.clip(cells[lines, None] + _AROUND, 0, np.array(clearance.shape) - 1)
    found[lines] = _at(flooded, piece, held, around.reshape(-1, 2)).reshape(-1, 9).max(axis=1)
    if (found[lines] >= 0).all():
        return found
    return flood_labels(clearance, nodes, labels)[cells[:, 0], cells[:, 1]]


def _at(flooded: LabelArray, piece: LabelArray, held: BoolArray, cells: IndexArray) -> LabelArray:
    """(p,) labels of some cells (p, 2) that the flood reached from a node, -1 of others."""
    rows, columns = cells.T
    return np.where(held[piece[rows, columns]], np.maximum(flooded[rows, columns], -1), -1)


def _watershed(clearance: FloatArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) labels flooded from the nodes (n, 2), below 0 on the lines between two of them.

    This is Meyer's watershed on a relief whose height falls with the clearance: two
    fronts meet where the passage between them is narrowest. OpenCV takes cells in the order of the
    difference between neighbours. So the heights stand on a checkerboard of signs, where that
    difference is the sum of both, and a second channel makes the step into a wall the last of all.
    It floods walls, too, and free cells behind them.
    """
    top = max(float(clearance.max(initial=0.0)), _TINY)
    height = np.rint((1.0 - clearance / top) * _LEVELS).astype(np.uint8)
    relief = height + np.uint8(_LEVELS + 2)
    for black in (np.s_[::2, ::2], np.s_[1::2, 1::2]):
        relief[black] = np.uint8(_LEVELS + 1) - height[black]
    wall = np.uint8(255) * (clearance <= 0.0)
    relief[wall > 0] = 0
    nothing = np.zeros_like(relief)
    picture = cv2.copyMakeBorder(
        cv2.merge([relief, wall, nothing]), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0, 255, 0)
    )
    markers = np.zeros(picture.shape[:2], dtype=np.int32)
    markers[nodes[:, 0] + 1, nodes[:, 1] + 1] = labels + 1
    cv2.watershed(picture, markers)
    return markers[1:-1, 1:-1] - 1


def _pieces(free: BoolArray, nodes: IndexArray) -> tuple[LabelArray, BoolArray]:
    """The piece (h, w) of `free` that a cell is of, 0: none; and which pieces hold a node (n, 2).

    Pieces are joined over edges and corners.
    """
    count, piece = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
    held = np.zeros(count, dtype=bool)
    held[piece[nodes[:, 0], nodes[:, 1]]] = True
    held[0] = False
    return np.asarray(piece, dtype=np.int32), held


def nearest_labels(free: BoolArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) the label of the nearest node (n, 2) for every free cell, as in the paper."""
    result = np.full(free.shape, -1, dtype=np.int32)
    if len(nodes):
        cells = np.argwhere(free)
        result[free] = labels[cKDTree(nodes).query(cells)[1]]
    return result


def spread_labels(labels: LabelArray, free: BoolArray, rings: int = RINGS) -> LabelArray:
    """Fill what is unlabelled (-1) of every piece of `free` (H, W) that holds a label.

    Labels creep `rings` cells through free space, so that none crosses a thin wall; what is left
    takes the nearest label of all.
    """
    missing = free & (labels < 0)
    if not missing.any():
        return labels
    grown = (labels + 1).astype(np.uint16)
    around = np.ones((3, 3), dtype=np.uint8)
    for _ in range(rings):
        bigger = cv2.dilate(grown, around)
        open_cells = missing & (grown == 0)
        grown[open_cells] = bigger[open_cells]
    missing &= grown == 0
    if missing.any():
        _, piece = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
        reached = np.zeros(int(piece.max()) + 1, dtype=bool)
        reached[piece[grown > 0]] = True
        missing &= reached[piece]
    if missing.any():
        grown[missing] = nearest_values(grown)[missing]
    return grown.astype(np.int32) - 1


def nearest_values(values: NDArray[Any]) -> NDArray[Any]:
    """(H, W) each cell's value, or the value of the nearest non-zero cell where it is zero."""
    zero = (values == 0).astype(np.uint8)
    _, source = cv2.distanceTransformWithLabels(
        zero, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(int(source.max()) + 1, dtype=values.dtype)
    table[source[zero == 0]] = values[zero == 0]
    return np.asarray(table[source])

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
_TINY = 1e-9  # cells; keeps a grid without free space from dividing by zero


def flood_labels(clearance: FloatArray, nodes: IndexArray, labels: LabelArray) -> LabelArray:
    """(h, w) labels grown from the nodes (n, 2) in order of falling clearance; -1 unreached.

    This is Meyer's watershed on a relief whose height falls with the clearance: two
    fronts meet where the passage between them is narrowest. OpenCV takes cells in the order of the
    difference between neighbours. So the heights stand on a checkerboard of signs, where that
    difference is the sum of both, and a second channel makes the step into a wall the last of all.
    """
    if not len(nodes):
        return np.full(clearance.shape, -1, dtype=np.int32)
    free = clearance > 0.0
    top = max(float(clearance.max(initial=0.0)), _TINY)
    height = np.rint((1.0 - clearance / top) * _LEVELS).astype(np.int16)
    black = np.add.outer(*(np.arange(side) for side in clearance.shape)) % 2 == 0
    relief = np.where(black, _LEVELS + 1 - height, _LEVELS + 2 + height)
    picture = np.zeros((clearance.shape[0] + 2, clearance.shape[1] + 2, 3), dtype=np.uint8)
    picture[1:-1, 1:-1, 0] = np.where(free, relief, 0)
    picture[..., 1] = 255
    picture[1:-1, 1:-1, 1][free] = 0
    markers = np.zeros(picture.shape[:2], dtype=np.int32)
    markers[nodes[:, 0] + 1, nodes[:, 1] + 1] = labels + 1
    cv2.watershed(picture, markers)
    flooded = markers[1:-1, 1:-1] - 1
    flooded[(flooded < 0) | ~_pieces_of(free, nodes)] = -1
    return spread_labels(flooded.astype(np.int32), free)


def _pieces_of(free: BoolArray, nodes: IndexArray) -> BoolArray:
    """(h, w) the pieces of `free`, joined over edges and corners, that hold a node (n, 2)."""
    count, piece = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
    held = np.zeros(count, dtype=bool)
    held[piece[nodes[:, 0], nodes[:, 1]]] = True
    return np.asarray(held[piece] & free)


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

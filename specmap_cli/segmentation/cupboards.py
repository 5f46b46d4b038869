"""Furniture that stands at a wall: its cells take the label of the room it stands in.

Such furniture is no isolated obstacle. But it is thicker than a wall, and smaller than what is
outside of the building.
"""

from __future__ import annotations

import cv2
import numpy as np

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import UNKNOWN, BoolArray, GridMap, cell_distances
from specmap_cli.segmentation.kmeans import LabelArray

_LONGEST_M = 4.0  # a row of cupboards; larger is what was never seen, and thick walls
_REACH_M = 0.2  # from a piece to the labelled cells of its room


def pieces_at_walls(grid: GridMap, thick_m: float) -> LabelArray:
    """The number (H, W) of each piece at a wall that is `thick_m` or more, 0 where there is none.

    What is outside of the building is none: what is unknown and large, and all at the map's edge.
    """
    unknown = np.asarray(grid.cells == UNKNOWN)
    thick = _thick(~grid.free & ~_large(unknown, grid.resolution), thick_m / grid.resolution)
    if not thick.any():
        return np.zeros(thick.shape, dtype=np.int32)
    pieces, large = _pieces(thick, grid.resolution)
    for edge in (pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1]):
        large[edge] = True
    return np.where(large[pieces] | ~thick, np.int32(0), pieces)


def fill_cupboards(labels: LabelArray, pieces: LabelArray, resolution: float) -> LabelArray:
    """`labels` (H, W) with those of the `pieces` (H, W) at walls, which had none.

    A piece takes the label that more than half of the labelled cells around it have.
    """
    if not pieces.any():
        return labels
    best = _label_around(labels, pieces, round(_REACH_M / resolution))
    return np.where((pieces > 0) & (labels < 0), best[pieces], labels)


def _large(unknown: BoolArray, resolution: float) -> BoolArray:
    """(H, W) what is unknown and larger than furniture, or joined to what is beyond the map."""
    framed = np.pad(unknown, 1, constant_values=True)
    piece, large = _pieces(framed, resolution)
    large[piece[0, 0]] = True
    return np.asarray((large[piece] & framed)[1:-1, 1:-1])


def _pieces(mask: BoolArray, resolution: float) -> tuple[LabelArray, BoolArray]:
    """The number (H, W) of each piece of a mask, 0 outside; which (k,) are longer than furniture.

    Pieces are joined over edges.
    """
    _, piece, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    longest = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    return np.asarray(piece, dtype=np.int32), np.asarray(longest * resolution > _LONGEST_M)


def _thick(blocked: BoolArray, across: float) -> BoolArray:
    """(H, W) the cells of `blocked` that a disc covers which is `across` cells wide and fits in."""
    radius = (round(across) - 1) // 2
    framed = np.pad(blocked, radius + 1).astype(np.uint8)
    middle = cell_distances(framed) > radius
    if radius < 1 or not middle.any():  # of so few cells it could be a wall
        return np.zeros_like(blocked)
    covered = cell_distances((~middle).astype(np.uint8)) <= radius
    return np.asarray(covered[radius + 1 : -radius - 1, radius + 1 : -radius - 1])


def _label_around(labels: LabelArray, pieces: LabelArray, reach: int) -> IntArray:
    """(k,) the label of more than half of the labelled cells round each piece (H, W), -1: none.

    Cells count within `reach` of it.
    """
    grown = pieces.astype(np.float64)
    for _ in range(reach):
        grown = np.where(pieces > 0, grown, cv2.dilate(grown, np.ones((3, 3), np.uint8)))
    around = grown.astype(np.int32)
    ring = (around > 0) & (labels >= 0)
    votes = np.zeros((int(pieces.max()) + 1, int(labels.max(initial=0)) + 1), dtype=np.int64)
    np.add.at(votes, (around[ring], labels[ring]), 1)
    sure = 2 * votes.max(axis=1) > votes.sum(axis=1)
    return np.where(sure, votes.argmax(axis=1), -1).astype(np.int32)

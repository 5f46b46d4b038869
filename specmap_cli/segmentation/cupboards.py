"""Furniture that stands at a wall: its cells take the label of the room it stands in.

Such furniture is no isolated obstacle. But it is thicker than a wall, and smaller than what is
outside of the building.
"""

from __future__ import annotations

import cv2
import numpy as np

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import BoolArray, cell_distances
from specmap_cli.segmentation.kmeans import LabelArray

_LONGEST_M = 4.0  # a row of cupboards; larger is what was never seen, and thick walls
_REACH_M = 0.2  # from a piece to the labelled cells of its room


def fill_cupboards(
    labels: LabelArray, free: BoolArray, unknown: BoolArray, resolution: float, thick_m: float
) -> LabelArray:
    """`labels` (H, W) with those of pieces at walls that are `thick_m` or more, which had none.

    A piece takes the label that most of the cells around it have. `free` and `unknown` (H, W) are
    the cells of the map. What is outside of the building, unknown and large, is no piece.
    """
    thick = _thick(~free & ~_large(unknown, resolution), thick_m / resolution)
    if not thick.any():
        return labels
    pieces, large = _pieces(thick, resolution)
    pieces[large[pieces] | ~thick] = 0
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
    """(k,) the label that most cells within `reach` of each piece (H, W) have, -1: none."""
    grown = pieces.astype(np.float64)
    for _ in range(reach):
        grown = np.where(pieces > 0, grown, cv2.dilate(grown, np.ones((3, 3), np.uint8)))
    around = grown.astype(np.int32)
    ring = (around > 0) & (labels >= 0)
    votes = np.zeros((int(pieces.max()) + 1, int(labels.max(initial=0)) + 1), dtype=np.int64)
    np.add.at(votes, (around[ring], labels[ring]), 1)
    return np.where(votes.any(axis=1), votes.argmax(axis=1), -1).astype(np.int32)

"""What was only seen: free space of a map that no robot enters, and that is no room.

A laser looks through windows, glass, railings and the doors of rooms that nobody entered. What it
sees there lies open to the unknown, where rooms have walls.
"""

from __future__ import annotations

import cv2
import numpy as np

from specmap_cli.grids.gridmap import OCCUPIED, UNKNOWN, BoolArray, GridMap, clearance_of, joined
from specmap_cli.segmentation.cells import border_widths, components
from specmap_cli.segmentation.visibility import LabelArray

_ROBOT_RADIUS_M, _REACH_M = 0.15, 0.5  # of the smallest robot, and how far beside it a room goes
_BESIDE = np.ones((3, 3), dtype=np.uint8)  # a border beside an obstacle is a wall


def entered(labels: LabelArray, grid: GridMap, least: float) -> LabelArray:
    """The regions (h, w) of a map that are rooms; -1 what was only seen.

    Seen only is, in this order:

    1. what is not within reach of any place where the smallest robot finds room: single rays;
    2. a region that borders on the unknown more than on walls, unless all do;
    3. a region that a robot of the radius `least`, in cells, cannot reach from the largest part of
       all that it hangs together with, what was seen only included.
    """
    free = labels >= 0
    if not free.any():
        return labels
    clearance = clearance_of(free)
    roomy = clearance * grid.resolution >= _ROBOT_RADIUS_M
    away = cv2.distanceTransform((~roomy).astype(np.uint8), cv2.DIST_L2, 5) * grid.resolution
    found = np.where(joined(free & (away <= _REACH_M), roomy), labels, np.int16(-1))
    walled = np.where(_open_to_the_unknown(found, grid)[found], np.int16(-1), found)
    found = walled if (walled >= 0).any() else found
    count = int(labels.max(initial=0)) + 1
    size = np.bincount(found[found >= 0], minlength=count)
    borders = border_widths(found, clearance)
    part = components(count, [pair for pair, border in borders.items() if border >= least])
    glimpsed = [pair for pair in border_widths(labels, clearance) if not size[list(pair)].all()]
    piece = components(count, [*borders, *glimpsed])
    area = np.bincount(part, weights=size)[part]
    largest = np.zeros(count)
    np.maximum.at(largest, piece, area)
    return np.where((area < largest[piece])[found], np.int16(-1), found)


def _open_to_the_unknown(labels: LabelArray, grid: GridMap) -> BoolArray:
    """(k,) which regions (h, w) have more sides of cells on the unknown than on walls."""
    wall = cv2.dilate((grid.cells == OCCUPIED).astype(np.uint8), _BESIDE) > 0
    unknown = (grid.cells == UNKNOWN) & ~wall
    count = int(labels.max(initial=0)) + 1
    more = np.zeros(count, dtype=np.int64)
    for one, other in (
        (np.s_[:-1], np.s_[1:]),
        (np.s_[1:], np.s_[:-1]),
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:, 1:], np.s_[:, :-1]),
    ):
        inside, beyond = labels[one], labels[other] < 0
        inside = np.where(beyond, inside, np.int16(-1))
        for kind, sign in ((unknown[other], 1), (wall[other], -1)):
            sides = inside[(inside >= 0) & kind]
            more += sign * np.bincount(sides, minlength=count)
    return np.asarray(more > 0)

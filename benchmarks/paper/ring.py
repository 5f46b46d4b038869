"""A building of our own in the manner of the Stata Center: a corridor that goes round.

The paper's second building differs from its first in this: the way round is one large loop, and
what lies beside it is no row of equal rooms. This drawing needs no data. Lengths are metres, x to
the right and y up.
"""

from __future__ import annotations

import cv2
import numpy as np

from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.simulation.worlds import RoomTruth

RESOLUTION_M = 0.05
SIZE_M = (25.0, 19.0)
_WALL_M = 0.25  # of the outer walls

Point = tuple[float, float]
Box = tuple[float, float, float, float]  # left, bottom, right, top

CORRIDOR = "corridor"
_OUTER: Box = (5.0, 5.0, 19.5, 13.5)
_CORE: Box = (6.9, 6.9, 17.6, 11.6)
ROOMS: dict[str, list[Point]] = {
    "open laboratory": [(0.8, 4.2), (4.85, 5.0), (4.85, 13.5), (2.2, 14.6), (0.8, 13.4)],
    "south west": [(0.8, 0.8), (7.3, 0.8), (6.1, 4.85), (4.2, 4.85), (0.8, 4.0)],
    "south": [(7.5, 0.8), (12.6, 0.8), (12.6, 4.85), (6.3, 4.85)],
    "lecture room": [(12.75, 0.8), (23.2, 0.8), (23.2, 3.2), (19.5, 4.85), (12.75, 4.85)],
    "east": [(19.65, 5.0), (23.2, 3.5), (23.2, 8.9), (19.65, 8.9)],
    "lounge": [(19.65, 9.05), (23.2, 9.05), (24.2, 12.0), (21.4, 14.6), (19.65, 13.5)],
    "north east": [(13.1, 13.65), (19.5, 13.65), (21.2, 14.7), (18.8, 18.2), (13.1, 18.2)],
    "north": [(8.2, 13.65), (12.95, 13.65), (12.95, 17.2), (8.2, 18.2)],
    "north west": [(4.9, 13.65), (8.05, 13.65), (8.05, 18.2), (2.4, 18.2), (2.4, 14.7)],
    "core west": [(7.05, 7.05), (11.4, 7.05), (10.4, 11.45), (7.05, 11.45)],
    "core east": [(11.55, 7.05), (17.45, 7.05), (17.45, 11.45), (10.55, 11.45)],
}
DOORS: list[Box] = [
    (4.85, 8.2, 5.0, 9.9),  # the laboratory is wide open
    (5.1, 4.85, 6.0, 5.0),
    (9.2, 4.85, 10.1, 5.0),
    (15.4, 4.85, 16.3, 5.0),
    (19.5, 6.6, 19.65, 7.5),
    (19.5, 10.6, 19.65, 12.2),  # and so is the lounge
    (14.8, 13.5, 15.7, 13.65),
    (9.6, 13.5, 10.5, 13.65),
    (6.2, 13.5, 7.1, 13.65),
    (8.3, 6.9, 9.2, 7.05),
    (14.6, 11.45, 15.5, 11.6),
]
FURNITURE: list[Box] = [
    (1.6, 7.0, 2.6, 9.0),
    (1.4, 11.2, 3.2, 12.0),
    (1.2, 1.4, 3.0, 2.2),
    (9.2, 1.2, 11.0, 2.0),
    (15.0, 1.6, 15.4, 3.6),
    (17.0, 1.6, 17.4, 3.6),
    (21.6, 5.2, 22.4, 7.4),
    (21.8, 10.4, 22.8, 11.4),
    (15.6, 15.4, 17.8, 16.4),
    (10.0, 15.4, 10.6, 16.6),
    (4.0, 16.4, 6.0, 17.2),
    (9.0, 9.4, 9.8, 10.2),
    (12.4, 8.2, 13.2, 8.9),
    (15.2, 8.2, 15.5, 8.5),
    (7.4, 5.0, 8.8, 5.3),
    (17.1, 12.9, 18.6, 13.5),
]


def plan() -> GridMap:
    """The building with its furniture."""
    floor = _labels() > 0
    for door in DOORS:
        floor[_cells(door)] = True
    thick = 2 * round(_WALL_M / RESOLUTION_M) + 1
    near = cv2.dilate(floor.astype(np.uint8), np.ones((thick, thick), np.uint8)) > 0
    for piece in FURNITURE:
        floor[_cells(piece)] = False
    cells = np.where(floor, FREE, np.where(near, OCCUPIED, UNKNOWN)).astype(np.uint8)
    return GridMap(cells, RESOLUTION_M)


def rooms() -> RoomTruth:
    """Its rooms, empty; the corridor is the first."""
    return RoomTruth(_labels(), RESOLUTION_M)


def _labels() -> np.ndarray:
    """(H, W) number of the room of each cell, 0 for none, row 0 the lowest y."""
    labels = np.zeros([round(side / RESOLUTION_M) for side in SIZE_M[::-1]], dtype=np.int32)
    labels[_cells(_OUTER)] = 1
    labels[_cells(_CORE)] = 0
    for number, outline in enumerate(ROOMS.values(), start=2):
        corners = np.rint(np.array(outline) / RESOLUTION_M).astype(np.int32)
        cv2.fillPoly(labels, [corners], number)
    return labels


def _cells(box: Box) -> tuple[slice, slice]:
    left, bottom, right, top = (round(side / RESOLUTION_M) for side in box)
    return slice(bottom, top), slice(left, right)

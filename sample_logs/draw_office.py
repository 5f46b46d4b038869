"""Draws the floor plan of the sample logs: an office of nine rooms along a corridor with a bend.

Run it as `python sample_logs/draw_office.py`; it writes beside itself

- `office.png` and `office.yaml`: the plan in the map_server convention (254 free, 0 occupied,
  205 outside), 0.05 m a pixel;
- `office_rooms.png`: the same rooms, empty and white on black, as ground truth.

Lengths are metres from the upper left corner of the picture, x to the right and y down.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

RESOLUTION = 0.05
SIZE = (19.0, 14.0)
WALL = 0.25  # thickness of the outer walls
OCCUPIED, OUTSIDE, FREE = 0, 205, 254

Point = tuple[float, float]
Box = tuple[float, float, float, float]  # left, top, right, bottom

ROOMS: dict[str, list[Point]] = {
    "corridor": [
        (0.75, 5.3), (12.7, 5.3), (13.4, 6.0), (13.4, 13.25), (11.8, 13.25), (11.8, 6.9),
        (0.75, 6.9),
    ],
    "meeting room": [(0.75, 1.75), (1.75, 0.75), (5.25, 0.75), (5.25, 5.15), (0.75, 5.15)],
    "office 1": [(5.4, 0.75), (8.2, 0.75), (8.2, 5.15), (5.4, 5.15)],
    "office 2": [(8.35, 0.75), (11.5, 0.75), (11.5, 5.15), (8.35, 5.15)],
    "open office": [(11.65, 0.75), (18.25, 0.75), (18.25, 5.15), (11.65, 5.15)],
    "kitchen": [(13.55, 6.0), (14.25, 5.3), (18.25, 5.3), (18.25, 8.2), (13.55, 8.2)],
    "laboratory": [(13.55, 8.35), (18.25, 8.35), (18.25, 13.25), (13.55, 13.25)],
    "store": [(0.75, 7.05), (3.0, 7.05), (3.0, 13.25), (0.75, 13.25)],
    "office 3": [(3.15, 7.05), (6.75, 7.05), (6.75, 9.75), (3.15, 9.75)],
    "library": [
        (6.9, 7.05), (11.65, 7.05), (11.65, 13.25), (3.15, 13.25), (3.15, 9.9), (6.9, 9.9),
    ],
}  # fmt: skip

DOORS: list[Box] = [
    (3.9, 5.15, 4.8, 5.3),  # meeting room
    (6.9, 5.15, 7.8, 5.3),  # office 1
    (8.8, 5.15, 9.7, 5.3),  # office 2
    (11.75, 5.15, 12.65, 5.3),  # open office
    (15.2, 5.15, 16.1, 5.3),  # open office to kitchen
    (13.4, 7.0, 13.55, 7.9),  # kitchen
    (13.4, 11.9, 13.55, 12.8),  # laboratory
    (1.2, 6.9, 2.1, 7.05),  # store
    (3.7, 6.9, 4.6, 7.05),  # office 3
    (8.4, 6.9, 9.4, 7.05),  # library
    (11.65, 10.8, 11.8, 11.7),  # library to the end of the corridor
]

FURNITURE: list[Box] = [
    # meeting room: a table with chairs, a sideboard
    (1.9, 1.9, 3.9, 3.0), (0.75, 3.9, 1.15, 5.0),
    *[(x, y, x + 0.4, y + 0.4) for x in (2.0, 2.7, 3.4) for y in (1.4, 3.1)],
    # office 1: desks along both walls, a cabinet behind the door
    (5.4, 1.5, 6.2, 3.0), (7.4, 0.75, 8.2, 2.2), (5.4, 4.3, 5.8, 5.15),
    # office 2: a desk in each corner at the window, shelves, a plant
    (8.35, 0.75, 9.15, 2.3), (9.9, 0.75, 11.5, 1.5), (11.1, 2.6, 11.5, 4.6),
    (8.45, 3.6, 8.8, 3.95),
    # open office: two pillars, islands of desks, lockers
    (13.6, 2.9, 13.95, 3.25), (16.3, 2.9, 16.65, 3.25), (12.6, 0.75, 14.0, 2.0),
    (15.0, 0.75, 16.4, 2.0), (16.9, 3.7, 18.25, 4.4), (13.0, 4.75, 14.8, 5.15),
    # kitchen: units along two walls, a table with stools
    (16.0, 7.65, 18.25, 8.2), (17.65, 6.0, 18.25, 7.65), (15.5, 6.2, 16.3, 7.0),
    (15.1, 6.5, 15.3, 6.7), (16.5, 6.5, 16.7, 6.7),
    # laboratory: benches, a machine
    (14.6, 9.5, 17.0, 10.2), (17.6, 8.35, 18.25, 11.4), (15.6, 12.4, 16.5, 13.25),
    # store: shelves along both long walls
    (0.75, 8.6, 1.15, 13.0), (2.6, 7.8, 3.0, 11.8),
    # office 3: a desk, a sofa, a shelf
    (5.3, 9.0, 6.75, 9.75), (3.15, 8.2, 3.8, 9.6), (5.6, 7.05, 6.75, 7.4),
    # library: rows of shelves, shelves along the walls, reading tables
    (7.6, 8.2, 8.0, 10.1), (10.1, 8.2, 10.5, 10.1), (7.4, 11.5, 8.8, 12.2),
    (9.6, 12.0, 11.0, 12.7), (3.15, 10.8, 3.5, 12.8), (4.4, 12.85, 6.6, 13.25),
    (4.6, 10.9, 5.6, 11.5),
    # corridor: a cabinet, a plant at the dead end, a bench
    (5.4, 5.3, 6.5, 5.6), (0.85, 5.9, 1.15, 6.2), (13.05, 8.9, 13.4, 10.2),
]  # fmt: skip


def cells(metres: float) -> int:
    """Metres in whole pixels."""
    return round(metres / RESOLUTION)


def box_of(box: Box) -> tuple[slice, slice]:
    """The pixels of a box."""
    left, top, right, bottom = map(cells, box)
    return slice(top, bottom), slice(left, right)


def draw_rooms() -> NDArray[np.uint8]:
    """Mask (H, W) of the rooms' floors, 255 inside."""
    mask = np.zeros((cells(SIZE[1]), cells(SIZE[0])), dtype=np.uint8)
    for outline in ROOMS.values():
        # a polygon of OpenCV holds the pixels on its outline, these end before right and bottom
        middle = np.mean(outline, axis=0)
        corners = [[cells(v) - (v > m) for v, m in zip(p, middle, strict=True)] for p in outline]
        cv2.fillPoly(mask, [np.array(corners, dtype=np.int32)], 255)
    return mask


def draw_plan(rooms: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The plan (H, W): floors, walls round them, doors through these, furniture."""
    floor = rooms > 0
    for door in DOORS:
        floor[box_of(door)] = True
    reach = 2 * cells(WALL) + 1
    near = cv2.dilate(floor.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    # what lies between the walls of two rooms is not outside either
    _, part = cv2.connectedComponents((~floor & ~near).astype(np.uint8))
    outside = np.isin(part, np.setdiff1d(part[0], [0]))
    plan = np.where(floor, FREE, np.where(outside, OUTSIDE, OCCUPIED)).astype(np.uint8)
    for piece in FURNITURE:
        plan[box_of(piece)] = OCCUPIED
    return plan


def main() -> None:
    """Write the three files beside this script."""
    folder = Path(__file__).resolve().parent
    rooms = draw_rooms()
    cv2.imwrite(str(folder / "office_rooms.png"), rooms)
    cv2.imwrite(str(folder / "office.png"), draw_plan(rooms))
    (folder / "office.yaml").write_text(
        "image: office.png\n"
        f"resolution: {RESOLUTION}\n"
        "origin: [0.0, 0.0, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()

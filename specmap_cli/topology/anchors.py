"""Anchors: for each submap a place where a robot can stand."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.topology.space import Space, Window, windows_of

_STRAY_M = 2.0  # on foot from the robot's way: farther off lies what was seen through glass
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_SQUARE = cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3))


@dataclass(frozen=True, slots=True)
class Anchor:
    """A free cell of a submap, by row and column, and its clearance in metres."""

    cell: tuple[int, int]
    clearance_m: float


def anchors_of(
    space: Space, stood: IntArray, radius_m: float, margin_m: float
) -> dict[int, Anchor]:
    """The anchor of each submap that has a free cell.

    It is the cell nearest to the middle of the submap that keeps the robot's radius and a margin
    off all that is not free. Where no cell keeps so much, it is the one that keeps the most. Of a
    submap in pieces that one counts in which the robot stood most often: rows and columns `stood`
    (k, 2). Nor is what is far from the robot's way a place to stand, such as the floor behind a
    railing or glass.
    """
    clearance = space.clearance
    visits = np.zeros(space.owner.shape, dtype=np.int64)
    np.add.at(visits, tuple(stood.T), 1)
    anchors = {}
    for submap, window in windows_of(space.owner).items():
        mine, room = space.owner[window] == submap, clearance[window]
        wide = mine & (room >= radius_m)
        piece = _piece(wide if wide.any() else mine, visits[window])
        piece = _near_on_foot(piece, visits[window] > 0, _STRAY_M / space.grid.resolution)
        anchors[submap] = _anchor(piece, room, window, radius_m + margin_m)
    return anchors


def _anchor(roomy: BoolArray, clearance: FloatArray, window: Window, kept_m: float) -> Anchor:
    """The cell of some of a window of the map that keeps enough, nearest to their middle."""
    kept = np.where(roomy, clearance, -1.0)
    cells = np.argwhere(kept >= min(kept_m, float(kept.max())))
    middle = np.argwhere(roomy).mean(axis=0)
    cell = cells[np.argmin(np.sum((cells - middle) ** 2, axis=1))]
    row, column = (cell + [window[0].start, window[1].start]).tolist()
    return Anchor((row, column), float(clearance[tuple(cell)]))


def _near_on_foot(cells: BoolArray, stood: BoolArray, reach: float) -> BoolArray:
    """Which of the cells are within reach of one where the robot stood; all where it never did.

    A way goes through these cells only. It is as long as around an octagon: at most a tenth off.
    """
    if not (cells & stood).any():
        return cells
    near = cells & stood
    for step in range(int(reach)):
        near = cells & (cv2.dilate(near.astype(np.uint8), _SQUARE if step % 2 else _CROSS) > 0)
    return near


def _piece(cells: BoolArray, visits: IntArray) -> BoolArray:
    """The connected part of some cells with the most visits; of equals the largest."""
    count, parts = cv2.connectedComponents(cells.astype(np.uint8), connectivity=4)
    size = np.bincount(parts.ravel(), minlength=count)
    often = np.bincount(parts.ravel(), weights=visits.ravel(), minlength=count)
    size[0] = often[0] = -1
    return np.asarray(parts == np.lexsort([size, often])[-1])

"""Rooms of a map that was built of a recording, against the rooms drawn in a plan of its building.

fr079 was recorded in the building of the plan Freiburg79_scan. The plan is a drawing: it is laid on
the map by turn, scale and shift, the overlap of free space being largest, and then by the best
affine motion. Bormann's measures (ICRA 2016) are taken on the cells that both show as free; rooms
count of which the map shows two fifths. Part of what is missing is the drawing's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import fft

from benchmarks.data import plan, rooms_of
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from benchmarks.scores import overlap_table
from specmap_cli.maps.store import Map, read_map

PLAN = "Freiburg79_scan"
_COARSE, _FINE = 8, 2  # cells of the map in one of the search
_SCALES = np.arange(1.0, 1.41, 0.05)
_SEEN, _LEAST_CELLS, _LEAST_PIECE = 0.4, 400, 100

ROWS = (
    Row("iou", "fr079: IoU", 0.82, 0.90),
    Row("recall", "recall"),
    Row("precision", "precision"),
    Row("segments", "submaps on 15 rooms", form=".0f", better="less"),
    Row("overlap", "how well the plan lies on the map", better="none"),
)


@dataclass(frozen=True, slots=True)
class Laid:
    """A picture scaled, turned (degrees) and shifted by (rows, columns); how much overlaps."""

    overlap: float
    scale: float
    turn: float
    shift: tuple[int, int]


def measure(bench: Bench) -> Figures:
    """Lay the plan on the map and score its submaps."""
    stored = read_map(bench.recorded("fr079"))
    grid, rooms = plan(PLAN), rooms_of(PLAN)
    room, overlap = drawn_on(stored, grid.free[::-1], rooms.labels[::-1])
    owner = np.where(stored.regions.grid.free, stored.regions.owner, -1)[::-1]
    table = overlap_table(room - 1, owner).astype(np.float64)
    whole = np.bincount(room[room > 0] - 1, minlength=len(table))
    seen = (table.sum(axis=1) > _SEEN * whole) & (whole > _LEAST_CELLS)
    table = table[:, table.sum(axis=0) > _LEAST_PIECE]
    pieces = table.sum(axis=0)
    table = table[seen]
    area = table.sum(axis=1)
    iou = (table / (area[:, None] + pieces - table)).max(axis=1)
    print(
        f"the plan lies on the map with an overlap of {overlap:.3f}; {len(area)} rooms, IoU each:"
    )
    print(" ".join(f"{value:.2f}" for value in iou))
    return {
        "iou": float(iou.mean()),
        "recall": float((table.max(axis=1) / area).mean()),
        "precision": float((table.max(axis=0) / pieces).mean()),
        "segments": table.shape[1],
        "overlap": overlap,
    }


def drawn_on(stored: Map, free: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, float]:
    """(H, W) the room of each cell of a map, 0 for none, and the overlap of its free space.

    `free` and `labels` (h, w) are the plan's; all with y down.
    """
    known = (stored.regions.owner >= 0)[::-1] & stored.regions.grid.free[::-1]
    rows, columns = np.nonzero(free)
    window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    free, labels = free[window].astype(np.uint8), labels[window].astype(np.uint8)
    best = max(
        (
            laid(known, free, scale, turn, _COARSE)
            for turn in np.arange(0.0, 360.0, 2.0).tolist()
            for scale in _SCALES.tolist()
        ),
        key=lambda one: one.overlap,
    )
    best = max(
        (
            laid(known, free, best.scale + scale, best.turn + turn, _FINE)
            for turn in np.arange(-2.0, 2.1, 0.25).tolist()
            for scale in np.arange(-0.04, 0.041, 0.01).tolist()
        ),
        key=lambda one: one.overlap,
    )
    space, room = (shifted(picture, best, known.shape) for picture in (free, labels))
    room, space = straightened(known, space, room)
    return room.astype(np.int64), overlap_of(known, space > 0)


def laid(known: np.ndarray, free: np.ndarray, scale: float, turn: float, coarse: int) -> Laid:
    """The best shift of a scaled and turned plan, by correlation of free space."""
    other = turned(free, scale, turn).astype(np.float32)
    one, two = (
        cv2.resize(
            x.astype(np.float32), None, fx=1 / coarse, fy=1 / coarse, interpolation=cv2.INTER_AREA
        )
        for x in (known, other)
    )
    shape = [fft.next_fast_len(one.shape[k] + two.shape[k]) for k in (0, 1)]
    found = fft.irfft2(fft.rfft2(one, shape) * np.conj(fft.rfft2(two, shape)), shape)
    at = np.unravel_index(int(found.argmax()), found.shape)
    shift = [int(at[k]) - (shape[k] if at[k] >= one.shape[k] else 0) for k in (0, 1)]
    overlap = 2 * float(found.max()) / float(one.sum() + two.sum())
    return Laid(overlap, scale, turn, (shift[0] * coarse, shift[1] * coarse))


def turned(picture: np.ndarray, scale: float, turn: float) -> np.ndarray:
    """A picture (h, w) scaled and turned by degrees, in the middle of a square."""
    height, width = picture.shape
    side = int(math.hypot(height, width) * scale) + 4
    motion = cv2.getRotationMatrix2D((width / 2, height / 2), turn, scale)
    motion[:, 2] += side / 2 - width / 2, side / 2 - height / 2
    return cv2.warpAffine(picture, motion, (side, side), flags=cv2.INTER_NEAREST)


def shifted(picture: np.ndarray, where: Laid, shape: tuple[int, ...]) -> np.ndarray:
    """A plan's picture as it lies on a map of a shape."""
    made = turned(picture, where.scale, where.turn)
    out = np.zeros(shape, dtype=np.uint8)
    (row, column), (height, width) = where.shift, made.shape
    top, left = max(row, 0), max(column, 0)
    low, right = min(row + height, shape[0]), min(column + width, shape[1])
    out[top:low, left:right] = made[top - row : low - row, left - column : right - column]
    return out


def straightened(
    known: np.ndarray, space: np.ndarray, room: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rooms and free space of a plan after the best affine motion, where that is better."""
    one, two = (cv2.GaussianBlur(x.astype(np.float32), (0, 0), 6) for x in (known, space > 0))
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 300, 1e-6)
    motion: Any = np.eye(2, 3, dtype=np.float32)
    everywhere = np.ones(known.shape, dtype=np.uint8)
    try:
        _, motion = cv2.findTransformECC(one, two, motion, cv2.MOTION_AFFINE, until, everywhere, 5)
    except cv2.error:  # it did not converge
        return room, space
    size, flags = known.shape[::-1], cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    again = [cv2.warpAffine(x, motion, size, flags=flags) for x in (room, space)]
    if overlap_of(known, again[1] > 0) <= overlap_of(known, space > 0) + 0.02:
        return room, space
    return again[0], again[1]


def overlap_of(one: np.ndarray, other: np.ndarray) -> float:
    """Twice the common cells over the sum of both."""
    return 2 * float((one & other).sum()) / float(one.sum() + other.sum())

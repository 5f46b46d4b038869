"""Scores of a segmentation against rooms drawn by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Labels = NDArray[np.integer]


@dataclass(frozen=True, slots=True)
class RoomScores:
    """Recall, precision and mean best IoU in [0, 1]; segments over rooms."""

    recall: float
    precision: float
    iou: float
    segments_per_room: float


def overlap_table(rooms: Labels, segments: Labels) -> NDArray[np.int64]:
    """(R, S) number of cells of each room and segment, both numbered 0, 1, ..., -1 for none."""
    both = (rooms >= 0) & (segments >= 0)
    size = int(rooms.max(initial=-1)) + 1, int(segments.max(initial=-1)) + 1
    flat = rooms[both].astype(np.int64) * size[1] + segments[both]
    return np.bincount(flat, minlength=size[0] * size[1]).reshape(size)


def room_scores(rooms: Labels, segments: Labels) -> RoomScores:
    """Compare `segments` (H, W) with hand-drawn `rooms` (H, W), -1 for none in both.

    Recall and precision as by Bormann et al., "Room Segmentation: Survey, Implementation, and
    Analysis", ICRA 2016: the largest overlap of a room with a segment over the room, the largest
    overlap of a segment with a room over the painted part of the segment, each averaged. Segments
    without any painted cell are not counted. IoU is the mean over rooms of the best
    intersection over union with a segment, of its painted part.
    """
    table = overlap_table(rooms, segments)
    table = table[:, table.any(axis=0)]
    room_size = np.bincount(rooms[rooms >= 0], minlength=len(table)).astype(np.float64)
    present = room_size > 0
    table, room_size = table[present], room_size[present]
    if not table.size:
        return RoomScores(0.0, 0.0, 0.0, 0.0)
    segment_size = table.sum(axis=0)
    union = room_size[:, None] + segment_size[None, :] - table
    return RoomScores(
        recall=float((table.max(axis=1) / room_size).mean()),
        precision=float((table.max(axis=0) / segment_size).mean()),
        iou=float((table / union).max(axis=1).mean()),
        segments_per_room=table.shape[1] / table.shape[0],
    )

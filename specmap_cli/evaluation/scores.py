"""Scores of a segmentation against rooms drawn by hand."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

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


@dataclass(frozen=True, slots=True)
class StayScores:
    """Homogeneity and completeness in [0, 1]; regions left over stays in a room."""

    homogeneity: float
    completeness: float
    segments_per_visit: float


def homogeneity(truth: Labels, found: Labels) -> float:
    """1 - H(truth | found) / H(truth): 1 when no found label (n,) mixes labels of `truth` (n,).

    Rosenberg and Hirschberg, "V-Measure", EMNLP 2007, section 2. Completeness is the same with the
    arguments exchanged.
    """
    whole = _entropy(np.unique(truth, return_counts=True)[1])
    if whole == 0.0:
        return 1.0
    _, first = np.unique(truth, return_inverse=True)
    names, second = np.unique(found, return_inverse=True)
    joint = np.bincount(first * len(names) + second)
    both, alone = _entropy(joint), _entropy(np.bincount(second))
    return 1.0 - (both - alone) / whole


def stay_scores(rooms: Labels, visits: Labels, submaps: Labels, regions: Labels) -> StayScores:
    """Compare an online segmentation of n keyframes with the rooms they were taken in.

    All (n,): the true room, the true visit (`visits_of`), the submap each keyframe ended in and the
    region it was split off with. Homogeneity asks whether submaps lie within rooms, completeness
    whether one visit stays in one submap.
    """
    return StayScores(
        homogeneity=homogeneity(rooms, submaps),
        completeness=homogeneity(submaps, visits),
        segments_per_visit=len(np.unique(regions)) / len(np.unique(visits)),
    )


def visits_of(rooms: Labels, steps_m: NDArray[np.floating], least_m: float = 1.0) -> Labels:
    """(n,) the number of the stay in a room, 0, 1, ..., for keyframes in order.

    `rooms` (n,) is the true room and `steps_m` (n,) the way since the keyframe before. A stay of
    less than `least_m` belongs to the stay before it.
    """
    travelled = np.cumsum(steps_m)
    starts = [0, *(np.flatnonzero(np.diff(rooms)) + 1).tolist(), len(rooms)]
    visits = np.zeros(len(rooms), dtype=np.int64)
    number, here = -1, -1
    for first, end in pairwise(starts):
        short = travelled[end - 1] - travelled[first] < least_m
        if number < 0 or not (short or rooms[first] == here):
            number, here = number + 1, int(rooms[first])
        visits[first:end] = number
    return visits


def _entropy(counts: NDArray[np.integer]) -> float:
    share = counts[counts > 0] / counts.sum()
    return float(-(share * np.log(share)).sum())

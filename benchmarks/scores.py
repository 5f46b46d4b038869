"""Scores against rooms drawn by hand: of a divided plan, of a robot's way, and of a whole map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import runs
from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.simulation.worlds import RoomTruth

Labels = NDArray[np.integer]
_LEAST_SHARE = 0.1  # a submap with less of a room's keyframes only looks in through the door
_WHOLE_PIECES = 2  # a room in two submaps is still whole: half of it may be furnished otherwise


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomScores:
    """Recall, precision and mean best IoU in [0, 1]; the number of segments over that of rooms."""

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
        return RoomScores(recall=0.0, precision=0.0, iou=0.0, segments_per_room=0.0)
    segment_size = table.sum(axis=0)
    union = room_size[:, None] + segment_size[None, :] - table
    return RoomScores(
        recall=float((table.max(axis=1) / room_size).mean()),
        precision=float((table.max(axis=0) / segment_size).mean()),
        iou=float((table / union).max(axis=1).mean()),
        segments_per_room=table.shape[1] / table.shape[0],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class VisitScores:
    """Homogeneity and completeness in [0, 1]; the regions split off over the visits of rooms."""

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


def visit_scores(*, rooms: Labels, visits: Labels, submaps: Labels, regions: Labels) -> VisitScores:
    """Compare an online segmentation of n keyframes with the rooms they were taken in.

    All (n,), n >= 1: the true room, the true visit (`visits_of`), the submap each keyframe ended in
    and the region it was split off with. Homogeneity asks whether submaps lie within rooms,
    completeness whether one visit lies within one submap.
    """
    return VisitScores(
        homogeneity=homogeneity(rooms, submaps),
        completeness=homogeneity(submaps, visits),
        segments_per_visit=len(np.unique(regions)) / len(np.unique(visits)),
    )


def visits_of(rooms: Labels, steps_m: NDArray[np.floating], least_m: float = 1.0) -> Labels:
    """(n,) the number 0, 1, ... of the visit of a room, for keyframes in order.

    `rooms` (n,) is the true room and `steps_m` (n,) the way since the keyframe before. A run of
    less than `least_m` in a room, such as a step through a door and back, is part of the visit
    before it.
    """
    way = np.cumsum(steps_m)
    visits = np.zeros(len(rooms), dtype=np.int64)
    number, here = -1, -1
    for first, end in runs(rooms):
        short = way[end - 1] - way[first] < least_m
        if number < 0 or not (short or rooms[first] == here):
            number, here = number + 1, int(rooms[first])
        visits[first:end] = number
    return visits


def _entropy(counts: NDArray[np.integer]) -> float:
    """Of labels that occur so many times, in nats."""
    share = counts[counts > 0] / counts.sum()
    return float(-(share * np.log(share)).sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class MapScores:
    """How submaps and rooms correspond.

    `pieces` is the number of submaps that each visited room is part of; `reopened` the rooms seen
    on the first lap in which the second one opened a submap of its own; `doors` counts true pairs
    of rooms driven between, `found` those of them that are edges, `invented` the edges between
    rooms that are no such pair. `purity` is the share of keyframes taken in the commonest room of
    their submap.
    """

    pieces: Mapping[int, int]
    reopened: tuple[int, ...]
    doors: int
    found: int
    invented: int
    purity: float

    @property
    def whole(self) -> float:
        """Share of the visited rooms that are part of at most two submaps."""
        return sum(n <= _WHOLE_PIECES for n in self.pieces.values()) / max(len(self.pieces), 1)

    @property
    def recognised(self) -> float:
        """Share of the visited rooms in which the second lap opened no new submap."""
        return 1.0 - len(self.reopened) / max(len(self.pieces), 1)


def map_scores(truth: RoomTruth, places: FloatArray, labels: IntArray) -> MapScores:
    """Scores of submap `labels` (n,) of keyframes taken at true `places` (n, 2 or 3) of the plan.

    Keyframes outside the painted rooms, or in no submap, are left out; the second half of the
    keyframes is taken for the second lap. Raises InputError when none is left.
    """
    rooms = truth.at(places).astype(np.int64)
    inside = (rooms > 0) & (labels >= 0)
    if not inside.any():
        raise InputError(
            "no keyframe lies in a painted room: are the true poses in the frame of the plan?"
        )
    rooms, labels, order = rooms[inside], labels[inside], np.flatnonzero(inside)
    table = np.zeros((int(rooms.max()) + 1, int(labels.max()) + 1), dtype=np.int64)
    np.add.at(table, (rooms, labels), 1)
    room_of = table.argmax(axis=0)
    visited = [room for room in range(len(table)) if table[room].any()]
    pieces = {
        room: int((table[room] >= _LEAST_SHARE * table[room].sum()).sum()) for room in visited
    }
    first_lap = order < len(places) // 2
    late = np.setdiff1d(labels, labels[first_lap])
    doors = _pairs(rooms.tolist())
    edges = _pairs(room_of[labels].tolist())
    return MapScores(
        pieces=pieces,
        reopened=tuple(np.intersect1d(room_of[late], rooms[first_lap]).tolist()),
        doors=len(doors),
        found=len(doors & edges),
        invented=len(edges - doors),
        purity=float(table.max(axis=0).sum() / table.sum()),
    )


def _pairs(sequence: list[int]) -> set[tuple[int, int]]:
    """Unordered pairs of different successive values."""
    return {(min(a, b), max(a, b)) for a, b in pairwise(sequence) if a != b}

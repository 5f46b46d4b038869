"""A finished map against the rooms of the plan it was simulated in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.simulation.room_truth import RoomTruth

_LEAST_SHARE = 0.1  # a submap with less of a room's keyframes only looks in through the door
_WHOLE_PIECES = 2  # a room in two submaps is still whole: half of it may be furnished otherwise


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

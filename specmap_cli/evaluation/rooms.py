"""A finished map against the rooms of the plan it was simulated in."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.simulation.worlds import RoomTruth

_LEAST_SHARE = 0.1  # a submap with less of a room's keyframes is no part of it


@dataclass(frozen=True, slots=True)
class MapScores:
    """How submaps and rooms correspond.

    `pieces` is the number of submaps that each visited room is part of; `reopened` the rooms in
    which the second half of the visits opened a submap of its own; `doors` true pairs of rooms
    driven between, `found` those that are edges, `invented` edges between rooms that are not.
    `purity` is the share of keyframes taken in the commonest room of their submap.
    """

    pieces: dict[int, int]
    reopened: list[int]
    doors: int
    found: int
    invented: int
    purity: float

    @property
    def whole(self) -> float:
        """Share of the visited rooms that are part of at most two submaps."""
        return sum(count <= 2 for count in self.pieces.values()) / max(len(self.pieces), 1)

    @property
    def recognised(self) -> float:
        """Share of the visited rooms in which later visits opened no new submap."""
        return 1.0 - len(self.reopened) / max(len(self.pieces), 1)


def map_scores(truth: RoomTruth, places: FloatArray, labels: IntArray) -> MapScores:
    """Scores of submap `labels` (n,) of keyframes taken at true `places` (n, 2 or 3) of the plan.

    Keyframes outside the painted rooms are left out; the second half of the keyframes is taken for
    the second lap.
    """
    rooms = truth.at(places).astype(np.int64)
    inside = rooms > 0
    rooms, labels, order = rooms[inside], labels[inside], np.flatnonzero(inside)
    table = np.zeros((int(rooms.max()) + 1, int(labels.max()) + 1), dtype=np.int64)
    np.add.at(table, (rooms, labels), 1)
    room_of = table.argmax(axis=0)
    visited = [room for room in range(len(table)) if table[room].any()]
    pieces = {
        room: int((table[room] >= _LEAST_SHARE * table[room].sum()).sum()) for room in visited
    }
    second = len(places) // 2
    opened = {int(label): int(order[np.argmax(labels == label)]) for label in np.unique(labels)}
    seen_before = set(rooms[order < second].tolist())
    reopened = sorted(
        {
            int(room_of[label])
            for label, first in opened.items()
            if first >= second and int(room_of[label]) in seen_before
        }
    )
    doors = _pairs(rooms.tolist())
    edges = _pairs(room_of[labels].tolist())
    purity = float(table.max(axis=0).sum() / table.sum())
    return MapScores(pieces, reopened, len(doors), len(doors & edges), len(edges - doors), purity)


def _pairs(sequence: list[int]) -> set[tuple[int, int]]:
    """Unordered pairs of different successive values."""
    return {(min(a, b), max(a, b)) for a, b in pairwise(sequence) if a != b}

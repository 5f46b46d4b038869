"""A floor plan while it is drawn: rooms, doors between them, and furniture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from specmap_cli.grids.gridmap import FREE, OCCUPIED, BoolArray, GridMap
from specmap_cli.segmentation.visibility import LabelArray

RESOLUTION_M = 0.05
_MARGIN_M = 0.5  # of wall around the plan
_PASSAGE_CELLS = 10  # a robot half a metre wide gets past all furniture
_BEFORE_DOORS_M = 0.7  # nothing stands there

Box = tuple[float, float, float, float]  # x0, y0, x1, y1 in metres


@dataclass(slots=True)
class Drawing:
    """Free space and painted rooms of a plan of so many metres.

    `free` (H, W); `labels` (H, W) 0, 1, ... of the rooms, -1 elsewhere, doors among it; `rooms`
    their boxes, of a corridor with corners the first of its boxes.
    """

    width_m: float
    height_m: float
    free: BoolArray = field(init=False)
    labels: LabelArray = field(init=False)
    rooms: list[Box] = field(init=False, default_factory=list)
    doors: list[Box] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        sides = (self.height_m + 2 * _MARGIN_M, self.width_m + 2 * _MARGIN_M)
        shape = tuple(round(side / RESOLUTION_M) for side in sides)
        self.free = np.zeros(shape, dtype=np.bool_)
        self.labels = np.full(shape, -1, dtype=np.int32)

    def room(self, *box: float, of: int | None = None) -> int:
        """Make a box a room, or a part of room `of`; returns its label."""
        label = len(self.rooms) if of is None else of
        if of is None:
            self.rooms.append((box[0], box[1], box[2], box[3]))
        self.free[self._cells(*box)] = True
        self.labels[self._cells(*box)] = label
        return label

    def door(self, *box: float) -> None:
        """Open a wall."""
        self.doors.append((box[0], box[1], box[2], box[3]))
        self.free[self._cells(*box)] = True

    def is_within_one_room(self, *box: float) -> bool:
        """Whether a box lies in one room alone."""
        inside = self.labels[self._cells(*box)]
        return bool(inside.size and inside.min() >= 0 and inside.min() == inside.max())

    def grid(self) -> GridMap:
        """The plan as a map."""
        cells = np.where(self.free, FREE, OCCUPIED).astype(np.uint8)
        return GridMap(cells, RESOLUTION_M, (-_MARGIN_M, -_MARGIN_M))

    def furnish(self, rng: np.random.Generator) -> None:
        """Desks, cupboards and tables; none before a door, and none that shuts anything off."""
        kept = np.zeros_like(self.free)
        for x0, y0, x1, y1 in self.doors:
            off = _BEFORE_DOORS_M
            kept[self._cells(x0 - off, y0 - off, x1 + off, y1 + off)] = True
        parts = self._parts(self.free)
        for room in self.rooms:
            for _ in range(int(_area(room) / rng.uniform(4.0, 8.0))):
                box = _piece(room, rng)
                if box is None or kept[self._cells(*box)].any():
                    continue
                fuller = self.free.copy()
                fuller[self._cells(*box)] = False
                if self._parts(fuller) == parts:
                    self.free = fuller

    def _parts(self, free: BoolArray) -> int:
        """Into how many parts free space falls for a robot."""
        reachable = ndimage.binary_erosion(free, iterations=_PASSAGE_CELLS // 2)
        return int(ndimage.label(reachable)[1])

    def _cells(self, x0: float, y0: float, x1: float, y1: float) -> tuple[slice, slice]:
        columns, rows = (
            slice(*(max(0, round((end + _MARGIN_M) / RESOLUTION_M)) for end in ends))
            for ends in ((x0, x1), (y0, y1))
        )
        return rows, columns


def _area(room: Box) -> float:
    """Square metres, of a corridor a third: little stands in it."""
    sides = room[2] - room[0], room[3] - room[1]
    return sides[0] * sides[1] / (3.0 if _is_corridor(room) else 1.0)


def _is_corridor(room: Box) -> bool:
    sides = room[2] - room[0], room[3] - room[1]
    return min(sides) < 2.9 and max(sides) > 9.0


def _piece(room: Box, rng: np.random.Generator) -> Box | None:
    """A desk, a cupboard or a table in a room; None when there is no way past it."""
    kind = 1.0 if _is_corridor(room) else rng.random()
    if kind >= 0.8 and not _is_corridor(room):  # a table, anywhere
        sides, at_wall = rng.uniform((0.8, 0.8), (2.0, 1.2)), False
    elif kind < 0.45:  # a desk
        sides, at_wall = rng.uniform((1.2, 0.6), (1.8, 0.8)), rng.random() < 0.8
    else:  # a cupboard
        sides, at_wall = rng.uniform((0.4, 0.3), (2.0, 0.5)), True
    along, across = sides if rng.random() < 0.5 else sides[::-1]
    x0, y0, x1, y1 = room
    if along > x1 - x0 - 0.9 or across > y1 - y0 - 0.9:
        return None
    x, y = rng.uniform((x0, y0), (x1 - along, y1 - across))
    if at_wall and along < across:
        x = float(rng.choice([x0, x1 - along]))
    elif at_wall:
        y = float(rng.choice([y0, y1 - across]))
    return float(x), float(y), float(x + along), float(y + across)

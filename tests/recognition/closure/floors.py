"""Floors of offices along a corridor as finished maps, drawn without a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.recognition.closure.prepared import MapToAlign

CELL_M = 0.05
_WALL_M, _CORRIDOR_M, _DOOR_M, _BESIDE_M = 0.2, 2.0, 0.9, 1.0

Box = tuple[float, float, float, float]  # left, bottom, right, top, metres


@dataclass(frozen=True)
class Floor:
    """A plan in its own frame, and the boxes of its rooms, the corridor last."""

    cells: CellArray
    rooms: tuple[Box, ...]

    @property
    def grid(self) -> GridMap:
        return GridMap(self.cells, CELL_M)

    def with_boxes(self, *boxes: Box, state: int = OCCUPIED) -> Floor:
        """The floor with things put into it, or with holes in its walls."""
        cells = self.cells.copy()
        for box in boxes:
            _fill(cells, box, state)
        return Floor(cells, self.rooms)

    def mirrored(self) -> Floor:
        width = self.cells.shape[1] * CELL_M
        rooms = tuple((width - c, b, width - a, d) for a, b, c, d in self.rooms)
        return Floor(np.ascontiguousarray(self.cells[:, ::-1]), rooms)


def floor(sizes: Sequence[tuple[float, float]], doors: Sequence[float]) -> Floor:
    """Rooms of some widths and depths above a corridor; `doors` are their places in [0, 1]."""
    width = sum(w for w, _ in sizes) + _WALL_M * (len(sizes) + 1)
    above = _CORRIDOR_M + 2 * _WALL_M
    height = above + max(depth for _, depth in sizes) + _WALL_M
    cells = np.full((round(height / CELL_M), round(width / CELL_M)), OCCUPIED, dtype=np.uint8)
    corridor = (_WALL_M, _WALL_M, width - _WALL_M, _WALL_M + _CORRIDOR_M)
    rooms, left = [], _WALL_M
    for (wide, deep), place in zip(sizes, doors, strict=True):
        rooms.append((left, above, left + wide, above + deep))
        hinge = left + 0.3 + place * (wide - _DOOR_M - 0.6)
        _fill(cells, (hinge, above - _WALL_M, hinge + _DOOR_M, above), FREE)
        left += wide + _WALL_M
    for room in (*rooms, corridor):
        _fill(cells, room, FREE)
    return Floor(cells, (*rooms, corridor))


def random_floor(seed: int, rooms: int = 6) -> Floor:
    """Rooms of different sizes with a cupboard or two each."""
    rng = np.random.default_rng(seed)
    sizes = [tuple(rng.uniform((2.5, 3.0), (6.0, 6.0)).tolist()) for _ in range(rooms)]
    made = floor(sizes, rng.uniform(size=rooms).tolist())
    boxes: list[Box] = []
    for left, _, right, top in made.rooms[:-1]:
        wide, deep = rng.uniform((0.4, 0.3), (1.5, 0.6)).tolist()
        at = rng.uniform(left, right - wide)
        boxes.append((at, top - deep, at + wide, top))
    return made.with_boxes(*boxes)


def seen(plan: Floor, rooms: Sequence[int], plan_from_map: Pose2) -> MapToAlign:
    """The map of a robot that visited some rooms of a plan, drawn from another frame."""
    whole = _drawn(plan, [plan.rooms[k] for k in rooms], plan_from_map)
    frames, grids, tracks = {}, {}, {}
    for number, k in enumerate(rooms):
        left, bottom, right, top = plan.rooms[k]
        middle = Pose2((left + right) / 2, (bottom + top) / 2, 0.3 * number)
        frames[number] = plan_from_map.inverse() @ middle
        grids[number] = _drawn(plan, [plan.rooms[k]], middle)
        tracks[number] = np.array([frames[number]])
    return MapToAlign(whole=whole, grids=grids, frames=frames, tracks=tracks)


def _drawn(plan: Floor, boxes: Sequence[Box], plan_from_map: Pose2) -> GridMap:
    """What is within a metre of some boxes, on cells of another frame."""
    corners = np.array([[box[k], box[m]] for box in boxes for k in (0, 2) for m in (1, 3)])
    placed = plan_from_map.inverse().apply(corners)
    low = np.floor(placed.min(axis=0) - 2.0)
    size = np.ceil((placed.max(axis=0) + 2.0 - low) / CELL_M).astype(int)
    grid = GridMap(
        np.full((size[1], size[0]), UNKNOWN, dtype=np.uint8), CELL_M, (float(low[0]), float(low[1]))
    )
    places = plan_from_map.apply(grid.centres_of(np.argwhere(grid.cells == UNKNOWN)))
    near = np.zeros(len(places), dtype=bool)
    for box in boxes:
        inside = (places > np.array(box[:2]) - _BESIDE_M) & (places < np.array(box[2:]) + _BESIDE_M)
        near |= inside.all(axis=1)
    values = plan.grid.values_at(places)
    surface = values == OCCUPIED  # a robot sees the faces of walls, and nothing behind them
    shape = grid.cells.shape
    free = ((values == FREE) & near).reshape(shape)
    grid.cells[free] = FREE
    grid.cells[surface.reshape(shape) & binary_dilation(free)] = OCCUPIED
    return grid


def _fill(cells: CellArray, box: Box, state: int) -> None:
    left, bottom, right, top = (round(side / CELL_M) for side in box)
    cells[bottom:top, left:right] = state

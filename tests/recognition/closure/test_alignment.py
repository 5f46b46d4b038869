"""Where one map lies in another: found, or refused with the reason, on drawn floors of offices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from specmap_cli.core.geometry import IDENTITY, Pose2, wrap_angle
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.recognition.closure.alignment import Alignment, align
from specmap_cli.recognition.closure.common_ground import MapToAlign, SubmapWalls, bent_motion
from specmap_cli.recognition.closure.verification import prepared

ALL, CELL_M = range(7), 0.05
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


def seen(plan: Floor, rooms: Sequence[int] = ALL, plan_from_map: Pose2 = IDENTITY) -> MapToAlign:
    """The map of a robot that visited some rooms of a plan, drawn from another frame."""
    whole = _drawn(plan, [plan.rooms[k] for k in rooms], plan_from_map)
    frames, grids = {}, {}
    for number, k in enumerate(rooms):
        left, bottom, right, top = plan.rooms[k]
        middle = Pose2((left + right) / 2, (bottom + top) / 2, 0.3 * number)
        frames[number] = plan_from_map.inverse() @ middle
        grids[number] = _drawn(plan, [plan.rooms[k]], middle)
    return MapToAlign(whole=whole, grids=grids, frames=frames)


def _drawn(plan: Floor, boxes: Sequence[Box], plan_from_map: Pose2) -> GridMap:
    """What is within a metre of some boxes, on cells of another frame."""
    corners = np.array([[box[k], box[m]] for box in boxes for k in (0, 2) for m in (1, 3)])
    placed = plan_from_map.inverse().apply(corners)
    low = np.floor(placed.min(axis=0) - 2.0)
    size = np.ceil((placed.max(axis=0) + 2.0 - low) / CELL_M).astype(int)
    cells = np.full((size[1], size[0]), UNKNOWN, dtype=np.uint8)
    grid = GridMap(cells, CELL_M, (float(low[0]), float(low[1])))
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


ALIKE = floor([(3.5, 4.5)] * 6, [0.5] * 6)


def refused(old: MapToAlign, new: MapToAlign) -> Alignment:
    """What is told of maps that are not aligned."""
    found = align(old, new)
    assert found.old_from_new is None
    assert found.reason
    return found


def assert_right(found: Alignment, truth: Pose2, metres: float = 0.02) -> None:
    assert found.old_from_new is not None, found.reason
    error = truth.inverse() @ found.old_from_new
    assert error.distance < metres
    assert abs(wrap_angle(error.theta)) < math.radians(0.1)


@pytest.mark.parametrize(("seed", "turn"), [(0, 0.0), (1, 2.0), (2, -0.7), (3, math.pi)])
def test_two_maps_of_one_floor(seed: int, turn: float) -> None:
    plan, frame = random_floor(seed), Pose2(3.0, 2.0, turn)
    old, new = seen(plan), seen(plan, ALL, frame)
    found = align(old, new)
    assert_right(found, frame)
    assert_right(align(new, old), frame.inverse())
    assert found.submaps >= 6
    assert {(joint.old, joint.new) for joint in found.joints} >= {(k, k) for k in range(6)}
    assert all(math.dist(joint.map_from_map[:2], frame[:2]) < 0.3 for joint in found.joints)
    assert found.area_m2 == pytest.approx(plan.grid.free_area_m2, rel=0.05)


def test_maps_that_share_some_rooms_but_two_may_be_of_two_buildings() -> None:
    plan, frame = random_floor(1, rooms=9), Pose2(5.0, 1.0, 0.4)
    assert_right(align(seen(plan, range(6)), seen(plan, range(3, 9), frame)), frame)
    plan = random_floor(1, rooms=7)
    told = refused(seen(plan, range(4)), seen(plan, range(2, 6), frame)).reason
    assert "too little in common" in told


def test_a_large_place_that_was_divided_otherwise_is_found_by_few_submaps() -> None:
    plan, frame = random_floor(6), Pose2(2.0, 0.0, 0.8)
    whole = seen(plan, ALL, frame).whole
    found = align(seen(plan), MapToAlign(whole=whole, grids={0: whole}, frames={0: IDENTITY}))
    assert found.submaps == 1
    assert_right(found, frame)


def test_furniture_that_was_moved_does_not_matter() -> None:
    plan, frame = random_floor(4), Pose2(1.0, 1.0, -2.0)
    boxes = [(a + 0.5, b + 1.2, a + 1.3, b + 1.6) for a, b, _, _ in plan.rooms[:3]]
    assert_right(align(seen(plan), seen(plan.with_boxes(*boxes), ALL, frame)), frame)


def test_rooms_are_found_where_those_beside_them_lie_when_a_layout_is_longer() -> None:
    """The last room lies 0.8 m from where the motion of the first one puts it."""
    rng = np.random.default_rng(7)
    sizes = [tuple(rng.uniform((3.0, 3.0), (5.0, 6.0)).tolist()) for _ in range(14)]
    doors = rng.uniform(size=len(sizes)).tolist()
    plan, longer = floor(sizes, doors), floor([(w + 0.06, d) for w, d in sizes], doors)
    maps = [seen(each, range(14)) for each in (plan, longer)]
    wholes = [prepared(each.whole) for each in maps]
    assert wholes[0] is not None
    assert wholes[1] is not None
    fits = SubmapWalls(maps[1], wholes[1]).fits(SubmapWalls(maps[0], wholes[0]), IDENTITY)
    middles, there = (
        np.array([((a + c) / 2, (b + d) / 2) for a, b, c, d in one.rooms[:14]])
        for one in (longer, plan)
    )
    away = np.hypot(*(middles - there).T)
    assert away.max() > 0.75
    off = np.hypot(*(bent_motion(IDENTITY, fits).apply(middles) - there).T)
    assert np.median(off) < 0.05
    assert off[-3:].max() < 0.1
    assert max(fit.off_m for fit in fits) < 0.5


@pytest.mark.parametrize(("one", "other"), [(0, 1), (2, 3), (4, 5), (6, 7)])
def test_other_buildings_are_refused(one: int, other: int) -> None:
    old = seen(random_floor(one))
    for rooms in (ALL, (0, 1), (2,)):
        refused(old, seen(random_floor(other), rooms, Pose2(1.0, 2.0, 0.5)))


def test_what_looks_alike_is_refused() -> None:
    """A mirrored floor, one empty room, and some of a row of equal offices."""
    plan = random_floor(3)
    refused(seen(plan), seen(plan.mirrored(), ALL, Pose2(0.0, 0.0, 1.0)))
    plan = floor([(3.0, 4.0), (5.0, 4.5)], [0.5, 0.2])
    refused(seen(plan, range(3)), seen(plan, [0], Pose2(0.0, 0.0, 0.3)))
    found = refused(seen(ALIKE, range(6)), seen(ALIKE, [1, 2], Pose2(1.0, 0.0, 0.2)))
    assert "too little in common" in found.reason


def test_a_bare_corridor_is_refused_since_it_slides() -> None:
    cells = np.full((60, 800), UNKNOWN, dtype=np.uint8)
    _fill(cells, (0.0, 0.5, 40.0, 2.5), FREE)
    _fill(cells, (0.0, 0.45, 40.0, 0.5), OCCUPIED)
    _fill(cells, (0.0, 2.5, 40.0, 2.55), OCCUPIED)
    grid = GridMap(cells, CELL_M)
    bare = MapToAlign(whole=grid, grids={0: grid}, frames={0: IDENTITY})
    assert "ambiguous" in refused(bare, bare).reason


def turned_twice(plan: Floor) -> Floor:
    """A floor, and below it the same floor turned by half a circle: it looks so from both ends."""
    height, width = (side * CELL_M for side in plan.cells.shape)
    cells = np.vstack([plan.cells[::-1, ::-1], plan.cells])
    above = [(a, b + height, c, d + height) for a, b, c, d in plan.rooms]
    below = [(width - c, height - d, width - a, height - b) for a, b, c, d in plan.rooms]
    return Floor(cells, (*above, *below))


def test_a_building_that_is_nearly_the_same_when_turned_is_refused() -> None:
    plain = turned_twice(random_floor(7, rooms=7))
    left, low, _, _ = plain.rooms[0]
    plan = plain.with_boxes((left + 0.4, low + 0.9, left + 1.6, low + 1.9))
    rooms = range(len(plan.rooms))
    found = refused(seen(plan, rooms), seen(plan, rooms, Pose2(1.0, -2.0, 0.4)))
    assert "ambiguous: the maps fit in more than one way" in found.reason
    assert "180 degrees apart" in found.reason
    assert found.rival > 0.7


def test_a_floor_with_another_wing_is_refused() -> None:
    first, second = random_floor(1), random_floor(2)
    left = first.cells.shape[1] // 2
    height = max(first.cells.shape[0], second.cells.shape[0])
    cells = np.ones((height, first.cells.shape[1]), dtype=np.uint8)
    cells[: first.cells.shape[0], :left] = first.cells[:, :left]
    wing = second.cells[:, left : first.cells.shape[1]]
    cells[: wing.shape[0], left : left + wing.shape[1]] = wing
    other = seen(Floor(cells, first.rooms), ALL, Pose2(2.0, 0.0, 0.1))
    assert refused(seen(first), other).evidence_m < 30.0


def test_maps_without_walls_say_so() -> None:
    empty = GridMap(np.full((40, 40), FREE, dtype=np.uint8), CELL_M)
    bare = MapToAlign(whole=empty, grids={0: empty}, frames={0: IDENTITY})
    assert "too few walls" in refused(bare, bare).reason
    unknown = GridMap(np.full((1, 1), UNKNOWN, dtype=np.uint8), CELL_M)
    refused(MapToAlign(whole=unknown, grids={}, frames={}), seen(ALIKE, [0]))


_STEPS = [-1.5, -1.0, -0.5, 0.5, 1.0, 1.5]


def of_length(bare_m: float, longer_m: float = 0.0) -> MapToAlign:
    """Two rooms at either end of a corridor that is bare between them, and was made longer."""
    sizes = [(4.0, 5.0), (3.0, 4.0), (bare_m + longer_m, 3.0), (5.0, 3.5), (3.5, 5.5)]
    made = floor(sizes, [0.2, 0.6, 0.5, 0.8, 0.3])
    left, low, right, high = made.rooms[2]
    hallway = made.with_boxes((left, low - _WALL_M, right, high))
    return replace(seen(hallway, (0, 1, 3, 4, 5)), longer_m=longer_m)


@pytest.mark.parametrize("longer_m", [-1.0, 0.0, 1.0])
def test_a_hallway_whose_length_was_guessed_is_found_by_another_length(longer_m: float) -> None:
    old, new = of_length(10.0), of_length(10.0 - longer_m)
    bent = [of_length(10.0 - longer_m, step) for step in _STEPS]
    found = align(old, new, bent)
    assert_right(found, IDENTITY)
    assert found.longer_m == longer_m
    if longer_m:
        refused(old, new)
        assert f"was made 1.0 m {'longer' if longer_m > 0 else 'shorter'}" in found.reason
    else:  # another building stays refused, whatever the length
        assert align(seen(random_floor(7)), new, bent).old_from_new is None


def test_what_fits_with_two_lengths_is_refused() -> None:
    """The rival lies at the same place: only what is beyond the stretch is elsewhere."""
    old = new = of_length(10.0)
    told = align(old, new, [replace(new, longer_m=3.0)])
    assert told.old_from_new is None
    assert told.reason == "ambiguous: the maps fit in more than one way, 3.0 m and 0 degrees apart"

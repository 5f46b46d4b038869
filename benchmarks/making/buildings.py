"""Kinds of buildings with sizes, walls and doors at random. Lengths are in metres."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.making.drawing import Box, Drawing

_LEAST_M = 2.0  # side of a room of a flat
_TRIES = 60  # places of a door


def office(rng: np.random.Generator) -> Drawing:
    """A corridor with rooms on both sides, some of them joined by a door."""
    length, wide = rng.uniform(18.0, 45.0), rng.uniform(1.4, 2.8)
    depths, wall = rng.uniform(3.5, 6.5, 2), _wall(rng)
    below, above = depths[0], depths[0] + 2 * wall + wide
    plan = Drawing(length, above + depths[1])
    plan.room(0.0, below + wall, length, below + wall + wide)
    for low, high, door in ((0.0, below, below), (above, above + depths[1], above - wall)):
        for x0, x1 in _row(rng, 0.0, length, 2.4, 7.0, wall):
            plan.room(x0, low, x1, high)
            width = min(rng.uniform(0.75, 1.1), x1 - x0 - 0.4)
            x = rng.uniform(x0 + 0.15, x1 - width - 0.15)
            plan.door(x, door, x + width, door + wall)
            if x0 > 0.0 and rng.random() < 0.15:
                y = rng.uniform(low + 0.3, high - 1.2)
                plan.door(x0 - wall, y, x0, y + 0.8)
    return plan


def ring(rng: np.random.Generator) -> Drawing:
    """A corridor around a core of one to three rooms, with rooms along its outside."""
    wide, wall, depth = rng.uniform(1.6, 2.6), _wall(rng), rng.uniform(3.5, 5.5)
    near = depth + wall
    sides = np.array([rng.uniform(10.0, 22.0), rng.uniform(5.0, 10.0)])
    width, height = (sides + 2 * (near + wide + wall)).tolist()
    plan = Drawing(width, height)
    loop = plan.room(near, near, width - near, near + wide)
    plan.room(near, height - near - wide, width - near, height - near, of=loop)
    plan.room(near, near, near + wide, height - near, of=loop)
    plan.room(width - near - wide, near, width - near, height - near, of=loop)
    core = near + wide + wall
    every = sides[0] / rng.integers(1, 4)
    for x0, x1 in _row(rng, core, width - core, every - 0.01, every, wall):
        plan.room(x0, core, x1, height - core)
        x, y = rng.uniform(x0 + 0.2, x1 - 1.1), rng.choice([core - wall, height - core])
        plan.door(x, y, x + 0.9, y + wall)
    for low, high, y in ((0.0, depth, depth), (height - depth, height, height - near)):
        for x0, x1 in _row(rng, near, width - near, 2.8, 7.0, wall):
            plan.room(x0, low, x1, high)
            x = rng.uniform(x0 + 0.2, x1 - 1.1)
            plan.door(x, y, x + 0.9, y + wall)
    return plan


def hall(rng: np.random.Generator) -> Drawing:
    """A hall with rooms along two of its sides."""
    width, height = rng.uniform(14.0, 28.0), rng.uniform(9.0, 16.0)
    depth, wall = rng.uniform(3.0, 5.0), _wall(rng)
    near = depth + wall
    plan = Drawing(width, height + 2 * near)
    plan.room(0.0, near, width, near + height)
    for low, y in ((0.0, depth), (near + height + wall, near + height)):
        for x0, x1 in _row(rng, 0.0, width, 3.0, 9.0, wall):
            plan.room(x0, low, x1, low + depth)
            door = rng.choice([0.9, 1.0, 1.8])
            x = rng.uniform(x0 + 0.2, x1 - door - 0.2)
            plan.door(x, y, x + door, y + wall)
    return plan


def flat(rng: np.random.Generator) -> Drawing:
    """Rooms halved again and again, with a door in each wall; a quarter of the doors are wide."""
    plan, wall = Drawing(*rng.uniform((9.0, 7.0), (14.0, 11.0)).tolist()), _wall(rng)
    walls: list[tuple[bool, Box]] = []
    for room in _halved(rng, (0.0, 0.0, plan.width_m, plan.height_m), wall, walls):
        plan.room(*room)
    for upright, (x0, y0, x1, y1) in walls:
        for _ in range(_TRIES):
            side = y1 - y0 if upright else x1 - x0
            wide = rng.uniform(1.2, 1.8) if rng.random() < 0.25 else rng.uniform(0.75, 1.0)
            width = min(wide, side - 0.4)
            start = 0.2 + rng.random() * (side - width - 0.4)
            if upright:
                box, off = (x0, y0 + start, x1, y0 + start + width), (0.2 + wall, 0.0)
            else:
                box, off = (x0 + start, y0, x0 + start + width, y1), (0.0, 0.2 + wall)
            sides = [np.add(box, [*(s * np.array(off)), *(s * np.array(off))]) for s in (-1, 1)]
            if all(plan.is_within_one_room(*side.tolist()) for side in sides):
                plan.door(*box)
                break
    return plan


BUILDINGS: dict[str, Callable[[np.random.Generator], Drawing]] = {
    "office": office,
    "ring": ring,
    "hall": hall,
    "flat": flat,
}


def _wall(rng: np.random.Generator) -> float:
    """How thick the walls of a building are."""
    return float(rng.choice([0.1, 0.15, 0.2, 0.3]))


def _row(
    rng: np.random.Generator, start: float, end: float, least: float, most: float, wall: float
) -> Iterator[tuple[float, float]]:
    """Rooms in a row: where each begins and ends, a wall between them."""
    while end - start > 0.5 * least:
        side = min(rng.uniform(least, most), end - start)
        if end - start - side < least:
            side = end - start
        last = end - start - side < 1e-6
        yield start, start + side - (0.0 if last else wall)
        start += side


def _halved(
    rng: np.random.Generator, box: Box, wall: float, walls: list[tuple[bool, Box]]
) -> Iterator[Box]:
    """The rooms that a box is divided into; `walls` gets those between them, upright or not."""
    x0, y0, x1, y1 = box
    upright = x1 - x0 > y1 - y0
    long, area = max(x1 - x0, y1 - y0), (x1 - x0) * (y1 - y0)
    if area < rng.uniform(9.0, 22.0) or long < 2 * _LEAST_M + wall + 0.2:
        yield box
        return
    share = max(_LEAST_M, 0.35 * long)
    cut = rng.uniform(share, long - share - wall)
    if upright:
        parts = (x0, y0, x0 + cut, y1), (x0 + cut + wall, y0, x1, y1)
        between = (x0 + cut, y0, x0 + cut + wall, y1)
    else:
        parts = (x0, y0, x1, y0 + cut), (x0, y0 + cut + wall, x1, y1)
        between = (x0, y0 + cut, x1, y0 + cut + wall)
    walls.append((upright, between))
    for part in parts:
        yield from _halved(rng, part, wall, walls)

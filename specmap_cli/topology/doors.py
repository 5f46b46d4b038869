"""Doors: the narrow passages between submaps, driven through or only seen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.topology.narrows import Narrow, narrows
from specmap_cli.topology.space import Border, Pair, Space, borders_of
from specmap_cli.topology.topological_map import Door, Traversal


@dataclass(frozen=True, slots=True)
class Passages:
    """How one can go from submap to submap: through `doors`, and across `openings`.

    An opening is a border without a narrow place: the space is as wide there as on one side of it.
    `openings` holds the middles (m, 2) of their cells, metres of the map, by pair.
    """

    doors: tuple[Door, ...]
    openings: Mapping[Pair, FloatArray]


def passages(
    space: Space, traversals: Mapping[Pair, Sequence[Traversal]], least_m: float
) -> Passages:
    """The doors and openings at least `least_m` wide between the submaps of a map.

    Doors are numbered by the pair of submaps, then from the lowest y on. Of the `traversals` of a
    pair each counts for the door that is nearest to it, unless an opening is nearer.
    """
    least = least_m / space.grid.resolution
    places: dict[Pair, list[Narrow]] = {}
    openings: dict[Pair, list[FloatArray]] = {}
    for border in borders_of(space.owner):
        if 2.0 * border.clearance(space.away) >= least:
            found = list(narrows(space, border, least))
            if found:
                places.setdefault(border.pair, []).extend(found)
            else:
                openings.setdefault(border.pair, []).append(_cells(space, border))
    open_borders = {pair: np.concatenate(cells) for pair, cells in openings.items()}
    doors: list[Door] = []
    for pair in sorted(places):
        mine = [_door(space, pair, place) for place in _different(places[pair])]
        mine.sort(key=lambda door: (door.y, door.x))
        doors.extend(_crossed(mine, traversals.get(pair, ()), open_borders.get(pair)))
    numbered = tuple(replace(door, id=number) for number, door in enumerate(doors))
    return Passages(numbered, open_borders)


def _cells(space: Space, border: Border) -> FloatArray:
    """(m, 2) the middles of a border's pairs of cells, metres of the map."""
    return space.grid.centres_of((border.low + border.high) / 2.0)


def _different(found: Iterable[Narrow]) -> list[Narrow]:
    """Narrow places without those that were found from another stretch of the border, too."""
    kept: list[Narrow] = []
    for place in found:
        if all(
            float(np.linalg.norm(place.middle - other.middle)) >= (place.width + other.width) / 2.0
            for other in kept
        ):
            kept.append(place)
    return kept


def _door(space: Space, pair: Pair, place: Narrow) -> Door:
    """The door at a narrow place, not yet numbered."""
    x, y = space.place(place.middle)
    theta = math.atan2(place.along[0], place.along[1])  # rows run along y, columns along x
    width_m = place.width * space.grid.resolution
    return Door(id=0, x=x, y=y, width_m=width_m, theta=theta, between=pair)


def _crossed(
    doors: Sequence[Door], traversals: Iterable[Traversal], opening: FloatArray | None
) -> list[Door]:
    """The doors of one pair with the traversals that went through them."""
    crossings: list[list[Traversal]] = [[] for _ in doors]
    for traversal in traversals:
        here = np.array([traversal.x, traversal.y])
        away = [math.dist(here, (door.x, door.y)) - door.width_m / 2.0 for door in doors]
        nearest = int(np.argmin(away))
        in_the_open = math.inf if opening is None else _distance(opening, here)
        if away[nearest] <= in_the_open:
            crossings[nearest].append(traversal)
    return [
        replace(door, crossings=tuple(mine), driven=bool(mine))
        for door, mine in zip(doors, crossings, strict=True)
    ]


def _distance(places: FloatArray, here: FloatArray) -> float:
    """Metres from a place to the nearest of some (m, 2)."""
    return float(np.linalg.norm(places - here, axis=1).min())

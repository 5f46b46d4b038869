"""What differs between two maps in one frame: submaps, the ways between them, what stands where."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.bent import BentMotion
from specmap_cli.topology.blocked import Crossing, blocked_ways
from specmap_cli.topology.identity import Identity, identify
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.things import Surveyed, Thing, things_in

_DOORWAY_M = 0.5  # from a way, besides half its width: what stands there is its door
_NEAR_M = 1.0  # from a submap's floor: what stands there stands in it


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedThing:
    """A thing with its place in the old map, and the submap that it stands in, by either map."""

    thing: Thing
    old_submap: int | None
    new_submap: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """Two maps against each other; all places are in the old map.

    `closed`: ways of the old map, between its submaps, that are blocked in the new one; `opened`:
    ways of the new map, between its submaps, that were blocked. `appeared` and `vanished`: what
    stands in one map where the other saw free space.
    """

    identity: Identity
    closed: tuple[Crossing, ...] = ()
    opened: tuple[Crossing, ...] = ()
    appeared: tuple[PlacedThing, ...] = ()
    vanished: tuple[PlacedThing, ...] = ()


def differences(
    old: Regions, new: Regions, tracks: tuple[FloatArray, FloatArray], old_from_new: BentMotion
) -> Differences:
    """What differs between two divided maps; `tracks` (n, 2 or more) of the robot are theirs."""
    new_from_old = old_from_new.inverse()
    before, after = Surveyed(old.grid, tracks[0]), Surveyed(new.grid, tracks[1])
    closed = blocked_ways(old, after, new_from_old)
    opened = [_moved(way, old_from_new) for way in blocked_ways(new, before, old_from_new)]
    things = things_in(new.grid, before, old_from_new)
    appeared = [_turned(thing, old_from_new) for thing in things]
    vanished = things_in(old.grid, after, new_from_old)
    placed = [
        tuple(_placed(thing, old, new, new_from_old) for thing in _outside(things, ways))
        for things, ways in ((appeared, closed), (vanished, opened))
    ]
    return Differences(
        identity=identify(old, new, old_from_new.rigid),
        closed=tuple(closed),
        opened=tuple(opened),
        appeared=placed[0],
        vanished=placed[1],
    )


def _moved(way: Crossing, old_from_new: BentMotion) -> Crossing:
    return replace(way, place=old_from_new.apply(way.place[None])[0])


def _turned(thing: Thing, old_from_new: BentMotion) -> Thing:
    near = old_from_new.near(thing.centre)
    return replace(
        thing, centre=near.apply(thing.centre[None])[0], corners=near.apply(thing.corners)
    )


def _outside(things: Iterable[Thing], ways: Sequence[Crossing]) -> list[Thing]:
    """The things that are not the doors of some ways."""
    return [
        thing
        for thing in things
        if all(
            math.dist(thing.centre, way.place) > way.width_m / 2 + _DOORWAY_M
            or thing.length_m > way.width_m + 2 * _DOORWAY_M
            for way in ways
        )
    ]


def _placed(thing: Thing, old: Regions, new: Regions, new_from_old: BentMotion) -> PlacedThing:
    there = new_from_old.apply(thing.centre[None])[0]
    return PlacedThing(
        thing=thing, old_submap=_submap_at(old, thing.centre), new_submap=_submap_at(new, there)
    )


def _submap_at(regions: Regions, place: FloatArray) -> int | None:
    """The submap whose floor is nearest to a place (2,), if one is near."""
    cell_m = regions.grid.resolution
    row, column = regions.grid.cells_of(place[None])[0].tolist()
    reach = math.ceil(_NEAR_M / cell_m)
    top, left = max(0, row - reach), max(0, column - reach)
    window = regions.owner[top : max(0, row + reach + 1), left : max(0, column + reach + 1)]
    cells = np.argwhere(window != NOBODY)
    if not len(cells):
        return None
    away = ((cells + (top, left) - (row, column)) ** 2).sum(axis=1)
    nearest = int(away.argmin())
    return int(window[tuple(cells[nearest])]) if away[nearest] * cell_m**2 <= _NEAR_M**2 else None

"""Doors that robots must not go through, and links that they must not take, by a person's word."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from specmap_cli.topology.borders import Border, heirs
from specmap_cli.topology.topological_map import Door, Edge, TopologicalMap

_AT_M = 2.0  # a person who points at a door points beside it

Pair = tuple[int, int]
Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Forbidden:
    """A person forbade the way between two submaps, or the one `at` a place in the map.

    `later` are the borders made after it was said: it holds for what the submaps became.
    """

    between: Pair
    at: Place | None = None
    later: tuple[Border, ...] = ()


@dataclass(frozen=True, slots=True)
class Shut:
    """What a person's word shuts: links, and doors by their ids."""

    links: frozenset[Pair] = frozenset()
    doors: frozenset[int] = frozenset()

    def __or__(self, other: Shut) -> Shut:
        return Shut(self.links | other.links, self.doors | other.doors)


def shut_by(topology: TopologicalMap, wish: Forbidden) -> Shut | str:
    """The links and doors that are meant, or why there are none.

    Without a place all of them between the two; with one the door nearest to it, or where the two
    meet in the open the link that crosses there.
    """
    one, other = (heirs(id_, wish.later) for id_ in wish.between)
    edges = {
        pair: edge
        for pair, edge in topology.edges.items()
        if _joins(pair, one, other) or _joins(pair[::-1], one, other)
    }
    if not edges:
        return f"there is no link between {wish.between[0]} and {wish.between[1]}"
    doors = [door for door in topology.doors if door.between in edges]
    if wish.at is None:
        return Shut(frozenset(edges), frozenset(door.id for door in doors))
    return _at(edges.values(), doors, wish.at)


def with_shut(topology: TopologicalMap, shut: Shut) -> TopologicalMap:
    """The map in which these links and doors are forbidden, and no others.

    A link is forbidden, too, when its way leads through a forbidden door: see `with_detours`.
    """
    return replace(
        topology,
        edges={
            pair: replace(edge, forbidden=pair in shut.links or bool(shut.doors & {*edge.doors}))
            for pair, edge in topology.edges.items()
        },
        doors=tuple(replace(door, forbidden=door.id in shut.doors) for door in topology.doors),
    )


def _at(edges: Iterable[Edge], doors: Iterable[Door], place: Place) -> Shut | str:
    """The door or the open link at a place."""
    through = {(math.dist((door.x, door.y), place), door.id): door for door in doors}
    open_ = {
        (math.dist(edge.crossing, place), edge.source, edge.target): edge
        for edge in edges
        if edge.crossing is not None and not edge.doors
    }
    door, link = min(through, default=(math.inf, 0)), min(open_, default=(math.inf, 0, 0))
    if min(door[0], link[0]) > _AT_M:
        return f"no door between the two is within {_AT_M:g} m of {place[0]:g}, {place[1]:g}"
    if door[0] <= link[0]:
        return Shut(doors=frozenset({door[1]}))
    return Shut(links=frozenset({(link[1], link[2])}))


def _joins(pair: Pair, one: frozenset[int], other: frozenset[int]) -> bool:
    return pair[0] in one and pair[1] in other

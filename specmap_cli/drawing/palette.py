"""Colours of submaps: neighbours differ for all eyes, and a submap keeps its colour."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from specmap_cli.core.arrays import Neighbours, neighbours
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions
from specmap_cli.topology.topological_map import TopologicalMap

Colour = tuple[int, int, int]  # blue, green, red

INK: Colour = (46, 42, 38)
PAPER: Colour = (255, 255, 255)
SHADE: Colour = (236, 236, 236)
SEEN: Colour = (216, 211, 206)  # what was only seen: of all light greys the farthest from all fills
QUIET: Colour = (130, 124, 118)
TRAVERSED: Colour = (190, 112, 40)
RIGHT: Colour = (92, 52, 20)
CLOSURE: Colour = (48, 30, 196)
WRONG: Colour = (40, 24, 214)
LOOSE: Colour = (0, 110, 214)
BORDER: Colour = (104, 98, 92)
DOOR: Colour = (36, 74, 122)

# Fills of regions, and a dark line for each. Found by a search for pale colours of which any two
# are CIEDE2000 15 apart for eyes of the usual kind and for each kind of colour blindness
# (protanopia, deuteranopia, tritanopia, by Machado et al., 2009), and the lines, too. With eight
# colours some would have to be muddy; the map of a floor needs six at the most.
_FILLS = ("afadff", "ffc8c5", "73a682", "f6f599", "cc86ac", "a1f3ff", "b2b651")
_LINES = ("5242e2", "f3527b", "0b6f4d", "7b8a00", "722f5c", "009ab5", "414704")


def _bgr(code: str) -> Colour:
    return int(code[4:], 16), int(code[2:4], 16), int(code[:2], 16)


FILLS: tuple[Colour, ...] = tuple(map(_bgr, _FILLS))
LINES: tuple[Colour, ...] = tuple(map(_bgr, _LINES))
_STEP = 3  # from a fill that is taken to the next one tried
# Regions this near, across a wall, are neighbours; looked for on cells of this size. Two thin walls
# with a shaft between them are 0.6 m thick in many plans.
_NEAR_M, _THINNED_M = 0.9, 0.15


def darker(colour: Colour, share: float = 0.55) -> Colour:
    """The same hue, darker."""
    blue, green, red = (round(channel * share) for channel in colour)
    return blue, green, red


def paler(colour: Colour, share: float = 0.55) -> Colour:
    """The colour with a share of paper mixed in: 0 leaves it, 1 is paper."""
    blue, green, red = (
        round(channel + share * (paper - channel))
        for channel, paper in zip(colour, PAPER, strict=True)
    )
    return blue, green, red


def vivid(fill: Colour) -> Colour:
    """The line that goes with one of the FILLS: of its hue, dark enough for a pale ground."""
    return LINES[FILLS.index(fill)]


def colours_of(topology: TopologicalMap, regions: Regions) -> dict[int, Colour]:
    """A fill for each submap, which its neighbours do not have.

    Neighbours are submaps with an edge, and regions that touch or lie across a wall.
    """
    thin = max(1, round(_THINNED_M / regions.grid.resolution))
    reach = max(1, round(_NEAR_M / regions.grid.resolution / thin))
    pairs = set(topology.edges) | touching(regions.owner[::thin, ::thin], reach)
    return colour_graph(sorted(topology.submaps), pairs)


def colour_graph(ids: Iterable[int], pairs: Iterable[tuple[int, int]]) -> dict[int, Colour]:
    """A fill for each of the `ids`, in their order: no pair shares one, as far as that can be.

    Each id has a fill of its own, which it leaves only to an earlier neighbour. So nearly all ids
    keep their colours when the map grows, or when a wall moves. Where the neighbours of one wear
    all fills, the fewest of them that can do so change. Pairs with an end that is none of the ids
    are left out.
    """
    order = list(ids)
    near_to = neighbours(order, (pair for pair in pairs if set(pair) <= set(order)))
    worn: dict[int, int] = {}
    for id_ in order:
        free = _free(id_, near_to, worn)
        if free:
            worn[id_] = free[0]
            continue
        # all are worn by neighbours: those that wear one of them change, or else it is shared
        wearers = {
            fill: [other for other in sorted(near_to[id_]) if worn.get(other) == fill]
            for fill in _free(id_, near_to, {})  # all of them
        }
        by_number = sorted(wearers, key=lambda fill: len(wearers[fill]))
        for fill in by_number:
            others = {other: _free(other, near_to, worn, fill) for other in wearers[fill]}
            if all(others.values()):
                worn |= {id_: fill} | {other: free[0] for other, free in others.items()}
                break
        else:
            worn[id_] = by_number[0]
    return {id_: FILLS[worn[id_]] for id_ in order}


def _free(
    id_: int, near_to: Neighbours, worn: Mapping[int, int], without: int | None = None
) -> list[int]:
    """The fills that no neighbour of an id wears, but for `without`, the preferred ones first."""
    taken = {worn[other] for other in near_to[id_] if other in worn} | {without}
    preferred = [(id_ + _STEP * k) % len(FILLS) for k in range(len(FILLS))]
    return [fill for fill in preferred if fill not in taken]


def touching(owner: OwnerArray, reach: int) -> set[tuple[int, int]]:
    """Pairs (smaller id, larger id) of regions that come within `reach` cells along an axis."""
    found: set[tuple[int, int]] = set()
    for step in sorted({1, max(1, reach // 2), reach}):
        for a, b in ((owner[step:], owner[:-step]), (owner[:, step:], owner[:, :-step])):
            border = (a != b) & (a != NOBODY) & (b != NOBODY)
            ends = np.stack([np.minimum(a[border], b[border]), np.maximum(a[border], b[border])])
            found.update((int(low), int(high)) for low, high in np.unique(ends, axis=1).T)
    return found

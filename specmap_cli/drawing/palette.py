"""Colours of submaps, chosen so that neighbours differ strongly."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.labels import neighbours
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions
from specmap_cli.topology.topological_map import TopologicalMap

Colour = tuple[int, int, int]  # blue, green, red

INK: Colour = (46, 42, 38)
PAPER: Colour = (255, 255, 255)
SHADE: Colour = (236, 236, 236)
QUIET: Colour = (130, 124, 118)
TRAVERSED: Colour = (160, 88, 24)
RIGHT: Colour = (92, 52, 20)
CLOSURE: Colour = (48, 30, 196)
WRONG: Colour = (40, 24, 214)
LOOSE: Colour = (0, 110, 214)
DOOR: Colour = (36, 74, 122)

_FILLS = (
    "8fc7ea", "f9c06a", "92d3a2", "f3a0a0", "c6b1ee", "f1e37a",
    "74cfc6", "f1addb", "bfd870", "98a9ea", "dfb48c", "aeb9c2",
)  # fmt: skip
FILLS: tuple[Colour, ...] = tuple(
    (int(code[4:], 16), int(code[2:4], 16), int(code[:2], 16)) for code in _FILLS
)
# Regions this near, across a wall, are neighbours; looked for on cells of this size.
_NEAR_M, _THINNED_M = 0.6, 0.15
_VIVID = (1.0, 2.2, 0.82)  # factors of hue, saturation and value, by eye
# Two fills further apart than this in CIELAB are told apart at a glance.
DISTINCT = 40.0


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


def vivid(colour: Colour) -> Colour:
    """The same hue, saturated and darker: for lines on a pale ground."""
    hsv = cv2.cvtColor(np.array([[colour]], dtype=np.float32) / 255.0, cv2.COLOR_BGR2HSV)
    hsv *= np.array(_VIVID, dtype=np.float32)
    bgr = cv2.cvtColor(np.minimum(hsv, (360.0, 1.0, 1.0)).astype(np.float32), cv2.COLOR_HSV2BGR)
    blue, green, red = (round(float(channel) * 255.0) for channel in bgr[0, 0])
    return blue, green, red


def colours_of(topology: TopologicalMap, regions: Regions) -> dict[int, Colour]:
    """A fill for each submap: far from those of its neighbours, then the least used.

    Neighbours are submaps with an edge, and regions that touch or lie across a wall.
    """
    thin = max(1, round(_THINNED_M / regions.grid.resolution))
    reach = max(1, round(_NEAR_M / regions.grid.resolution / thin))
    pairs = set(topology.edges) | touching(regions.owner[::thin, ::thin], reach)
    return colour_graph(sorted(topology.submaps), pairs)


def colour_graph(ids: Iterable[int], pairs: Iterable[tuple[int, int]]) -> dict[int, Colour]:
    """A fill for each of the `ids`, in their order, greedily: the same one every time.

    Pairs with an end that is none of the ids are left out.
    """
    order = list(ids)
    near_to = neighbours(order, (pair for pair in pairs if set(pair) <= set(order)))
    chosen: dict[int, int] = {}
    uses = np.zeros(len(FILLS), dtype=np.int64)
    for id_ in order:
        near = sorted({chosen[other] for other in near_to[id_] if other in chosen})
        gaps = fill_distances()[:, near].min(axis=1) if near else np.full(len(FILLS), DISTINCT)
        rank = np.lexsort((uses, -np.minimum(gaps, DISTINCT)))
        chosen[id_] = int(rank[0])
        uses[chosen[id_]] += 1
    return {id_: FILLS[index] for id_, index in chosen.items()}


def touching(owner: OwnerArray, reach: int) -> set[tuple[int, int]]:
    """Pairs (smaller id, larger id) of regions that come within `reach` cells along an axis."""
    found: set[tuple[int, int]] = set()
    for step in sorted({1, max(1, reach // 2), reach}):
        for a, b in ((owner[step:], owner[:-step]), (owner[:, step:], owner[:, :-step])):
            border = (a != b) & (a != NOBODY) & (b != NOBODY)
            ends = np.stack([np.minimum(a[border], b[border]), np.maximum(a[border], b[border])])
            found.update((int(low), int(high)) for low, high in np.unique(ends, axis=1).T)
    return found


@cache
def fill_distances() -> FloatArray:
    """(F, F) CIELAB distances between the fills."""
    fills = np.array(FILLS, dtype=np.float32)[None] / 255.0
    lab = cv2.cvtColor(fills, cv2.COLOR_BGR2Lab)[0].astype(np.float64)
    return np.asarray(np.linalg.norm(lab[:, None] - lab[None], axis=-1))

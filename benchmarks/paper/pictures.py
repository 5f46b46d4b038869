"""The pictures of the page: a map in the colours of its regions, and what stands on it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.drawing import symbols
from specmap_cli.drawing.canvas import Canvas, Image
from specmap_cli.drawing.overview import spread
from specmap_cli.drawing.palette import (
    FILLS,
    INK,
    PAPER,
    TRAVERSED,
    Colour,
    colour_graph,
    darker,
    touching,
)
from specmap_cli.drawing.sheet import MARGIN, TITLE, Sheet, extent_of, round_length, strokes
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.topology.regions import Regions, divide

WIDTH = 1000  # pixels of a picture on the page; what follows is of the sheet, twice as large
_ABOVE, _BELOW = 24, 84  # of paper over the map, and under it for the scale bar
_BADGE, _LETTERS, _LINK = 32.0, 26.0, 9
_SCALE_BAR = 400.0  # at the most
_NEAR_CELLS = 12  # regions so near, across a wall, differ in colour

Pair = tuple[int, int]


def divided(grid: GridMap, owner: NDArray[Any]) -> Image:
    """A finished map in regions: `owner` (H, W) is the number of the region of each cell, or -1."""
    regions = Regions.of(grid, np.asarray(owner, dtype=np.int64))
    sheet = Sheet(*extent_of(regions), ())
    sheet.ground(regions, _fills(regions))
    return _cut(sheet)


def topology(
    whole: GridMap, labels: Labels, edges: Iterable[Pair] = (), *, way: bool = True
) -> Image:
    """The map in the colours of the submaps of its keyframes, with the way and the links."""
    regions = divide(whole, labels)
    fills = _fills(regions) | _unseen(labels.submaps, regions)
    sheet = Sheet(*_extent(regions, labels.poses), ())
    sheet.ground(regions, fills)
    if way:
        for stroke in strokes(labels.poses[:, :2]):
            line = labels.poses[stroke.first : stroke.drawn_to, :2]
            sheet.canvas.line(sheet.pixels(line), symbols.PATH, 2)
    _draw_graph(sheet, labels, edges, fills)
    first, last = sheet.pixels(labels.poses[[0, -1], :2])
    symbols.start(sheet.canvas, first)
    symbols.end(sheet.canvas, last)
    return _cut(sheet)


def links(submaps: IntArray) -> list[Pair]:
    """Which submaps the robot drove between, by those of its keyframes (n,)."""
    driven = pairwise(submaps[submaps != NO_SUBMAP].tolist())
    return sorted({(min(pair), max(pair)) for pair in driven if pair[0] != pair[1]})


def kinds(whole: GridMap, labels: Labels) -> Image:
    """The map in two colours, by the kind 0 or 1 of its keyframes' scans."""
    regions = divide(whole, labels)
    sheet = Sheet(*_extent(regions, labels.poses), ())
    sheet.ground(regions, {0: FILLS[2], 1: FILLS[1]})
    return _cut(sheet)


def shrunk(image: Image, width: int = WIDTH) -> Image:
    """A picture no wider than the page shows it."""
    scale = min(1.0, width / image.shape[1])
    return np.asarray(
        cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8
    )


def _fills(regions: Regions) -> dict[int, Colour]:
    ids = np.unique(regions.owner[regions.owner >= 0]).tolist()
    return colour_graph(ids, touching(regions.owner, _NEAR_CELLS))


def _unseen(submaps: IntArray, regions: Regions) -> dict[int, Colour]:
    """A colour for the submaps that own no cell."""
    none = set(np.unique(submaps).tolist()) - set(regions.outlines) - {NO_SUBMAP}
    return dict.fromkeys(none, FILLS[0])


def _extent(regions: Regions, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = extent_of(regions)
    places = poses[:, :2]
    return np.minimum(low, places.min(axis=0) - 0.3), np.maximum(high, places.max(axis=0) + 0.3)


def _draw_graph(
    sheet: Sheet, labels: Labels, edges: Iterable[Pair], fills: dict[int, Colour]
) -> None:
    """A link for each edge, and a badge on each submap, at the middle one of its keyframes."""
    ids = [int(id_) for id_ in np.unique(labels.submaps) if id_ != NO_SUBMAP]
    places = np.array([_middle(labels.poses[labels.submaps == id_, :2]) for id_ in ids])
    at = dict(zip(ids, spread(sheet.pixels(places), 2.2 * _BADGE), strict=True))
    for a, b in edges:
        if a in at and b in at:
            for colour, width in ((PAPER, _LINK + 6), (TRAVERSED, _LINK)):
                sheet.canvas.line(np.array([at[a], at[b]]), colour, width)
    for id_ in ids:
        sheet.canvas.disc(at[id_], _BADGE, PAPER, darker(fills[id_]))
        x, y = at[id_].tolist()
        sheet.canvas.text(x, y, str(id_), _LETTERS, INK, "centre", bold=True)


def _middle(places: FloatArray) -> FloatArray:
    """That of the places (n, 2) which is nearest to their mean: it lies on the way."""
    away = np.linalg.norm(places - places.mean(axis=0), axis=1)
    return np.asarray(places[int(away.argmin())])


def _cut(sheet: Sheet) -> Image:
    """The map without the paper for a title and a legend; a scale bar under it."""
    bottom = TITLE + sheet.map_height
    picture = sheet.canvas.image[TITLE - _ABOVE : bottom + _BELOW]
    picture[-_BELOW + 8 :] = PAPER
    length, _ = round_length(_SCALE_BAR / sheet.pixels_per_m)
    canvas, end = Canvas.over(picture), MARGIN + length * sheet.pixels_per_m
    level = float(len(picture) - _BELOW // 2)
    canvas.box(np.array([MARGIN, level - 5]), np.array([end, level + 5]), INK)
    canvas.text(end + 20.0, level, f"{length:g} m", _LETTERS)
    return shrunk(picture)

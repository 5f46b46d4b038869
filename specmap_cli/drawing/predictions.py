"""The pictures of predicted submaps: along a trajectory (the paper's figure 6), and counted."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray
from specmap_cli.core.text import legible
from specmap_cli.drawing import symbols
from specmap_cli.drawing.canvas import Canvas, Image, text_width
from specmap_cli.drawing.palette import (
    INK,
    PAPER,
    QUIET,
    RIGHT,
    SHADE,
    WRONG,
    Colour,
    colour_graph,
    colours_of,
    paler,
    vivid,
)
from specmap_cli.drawing.sheet import Sheet, extent_of, strokes
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import TopologicalMap

_BORDER_M = 1.0  # of paper round the trajectory
_CLEAR_OF_BADGES = 3.0 * symbols.BADGE_RADIUS  # of an id on the ground
_SAME_ID_GAP = 5.0  # badges of one submap are this many times farther apart than others

# Pixels, chosen by eye for a page as wide as a screen.
_SIDE = 1400  # of all cells of the longer side together, while they are of a size to be seen
_SMALLEST_CELL, _LARGEST_CELL = 14, 72
_SMALLEST_LETTERS, _LARGEST_LETTERS = 8.0, 15.0
_FIGURES_FROM = 26  # a smaller cell has no room for its percent
_MARGIN, _TITLE, _GAP, _COUNTS, _NARROWEST = 48, 96, 12, 110, 700
_MISTAKES: Colour = (40, 24, 200)
_PALEST = 0.12  # weight of the hue in the cell of a single scan: it must be seen
_DARK = 0.45  # share from which letters are white


def render_labels(
    places: FloatArray,
    submaps: IntArray,
    title: str,
    figures: str = "",
    *,
    fills: Mapping[int, Colour] | None = None,
    map_with_regions: tuple[TopologicalMap, Regions] | None = None,
    truth: IntArray | None = None,
) -> Image:
    """The trajectory `places` (n, 2) in the colours of the predicted `submaps` (n,).

    NO_SUBMAP is unknown. With a map, `places` are in its frame and lie over its regions, in the
    colours of its overview. Without one they may be in any frame; `fills` are then the colours, by
    `colours_of` a map, else such that differ along the trajectory. `truth` (n,) marks the scans
    that were told another submap. Scans without a place (NaN) are left out.
    """
    known = np.isfinite(places[:, :2]).all(axis=1)
    places, submaps = np.asarray(places)[known, :2], np.asarray(submaps)[known]
    if fills is None and map_with_regions is not None:
        fills = colours_of(*map_with_regions)
    elif fills is None:  # such that differ along the trajectory
        ids = [int(id_) for id_ in np.unique(submaps) if id_ != NO_SUBMAP]
        fills = colour_graph(ids, set(itertools.pairwise(submaps.tolist())))
    shown = {"predicted submap, with its id", "start", "end"}
    shown |= {"wall"} if map_with_regions is not None else set()
    shown |= {"unknown"} if (submaps == NO_SUBMAP).any() else set()
    shown |= {"wrong"} if truth is not None else set()
    regions = None if map_with_regions is None else map_with_regions[1]
    sheet = Sheet(*extent_of(regions, places, _BORDER_M), symbols.legend_of(shown))
    if map_with_regions is not None:
        sheet.ground(map_with_regions[1], fills)
    if truth is not None:
        wrong = (submaps != np.asarray(truth)[known]) & (submaps != NO_SUBMAP)
        for stroke in strokes(places, wrong):
            if wrong[stroke.first]:
                way = sheet.pixels(places[stroke.first : stroke.drawn_to])
                sheet.canvas.line(way, WRONG, symbols.MISTAKEN)
    badges = _draw_predicted(sheet, places, submaps, fills)
    if map_with_regions is not None:
        topology, ground = map_with_regions
        for id_, submap in sorted(topology.submaps.items()):
            centroid = ground.outline(id_).centroid
            if centroid is not None:
                place = sheet.pixels(centroid[None])[0]
                if (np.linalg.norm(badges - place, axis=1) > _CLEAR_OF_BADGES).all():
                    symbols.ground_id(sheet.canvas, place, id_)
                symbols.name_under(sheet.canvas, place, legible(submap.given_name))
    sheet.title(title, figures)
    return sheet.canvas.image


def _draw_predicted(
    sheet: Sheet, places: FloatArray, submaps: IntArray, fills: Mapping[int, Colour]
) -> FloatArray:
    """Runs of one prediction in its colour, each with a badge where there is room for one.

    Returns the places of the badges (N, 2), in pixels.
    """
    pixels = sheet.pixels(places)
    drawn = strokes(places, submaps)
    told = [stroke for stroke in drawn if submaps[stroke.first] != NO_SUBMAP]
    for stroke in told:
        sheet.canvas.line(pixels[stroke.first : stroke.drawn_to], PAPER, symbols.RIM)
    for stroke in told:
        way = pixels[stroke.first : stroke.drawn_to]
        sheet.canvas.line(way, vivid(fills[int(submaps[stroke.first])]), symbols.PREDICTED)
    for pixel in pixels[submaps == NO_SUBMAP]:
        symbols.unknown(sheet.canvas, pixel)
    taken: list[tuple[int, FloatArray]] = []
    for stroke in sorted(drawn, key=lambda stroke: stroke.first - stroke.end):  # longest first
        id_, middle = int(submaps[stroke.first]), pixels[(stroke.first + stroke.end) // 2]
        # clear of all others, and well away from one of the same id
        if id_ != NO_SUBMAP and all(
            np.linalg.norm(middle - other)
            > symbols.BADGE_GAP * (_SAME_ID_GAP if id_ == other_id else 1.0)
            for other_id, other in taken
        ):
            symbols.badge(sheet.canvas, middle, str(id_), fills[id_])
            taken.append((id_, middle))
    if len(pixels):
        symbols.end(sheet.canvas, pixels[-1])
        symbols.start(sheet.canvas, pixels[0])
    return np.array([middle for _, middle in taken]).reshape(-1, 2)


def render_confusion(
    matrix: NDArray[Any], names: Sequence[str], predicted_names: Sequence[str] | None = None
) -> Image:
    """Counts `matrix` (k, m), a row per true submap, a column per prediction; BGR (H, W, 3).

    Each cell shows its share of the row in percent: blue where right, red where wrong. `names` are
    those of the rows, `predicted_names` of the columns where they differ (such as "unknown" added).
    """
    counts = np.asarray(matrix, dtype=np.float64)
    columns = list(names if predicted_names is None else predicted_names)
    if counts.shape != (len(names), len(columns)):
        raise ValueError(f"matrix {counts.shape} for {len(names)} rows, {len(columns)} columns")
    # the largest cells that fit, to the right of and below the names
    side = _SIDE / max(1, *counts.shape)
    cell = int(np.clip(side, _SMALLEST_CELL, _LARGEST_CELL))
    letters = float(np.clip(cell * 0.3, _SMALLEST_LETTERS, _LARGEST_LETTERS))
    left = _MARGIN + 40 + max([text_width(name, letters) for name in names], default=0)
    top = _TITLE + 40 + max([text_width(name, letters) for name in columns], default=0)
    right = left + cell * len(columns)
    width = max(right + _COUNTS + _MARGIN, _NARROWEST)
    canvas = Canvas(width, top + cell * len(names) + _MARGIN)
    canvas.text(_MARGIN, 46, "Confusion", 20, bold=True)
    canvas.text(
        _MARGIN, 80, "row: where it was;  column: what was said;  percent of the row", 13, QUIET
    )
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    for (i, j), share in np.ndenumerate(shares):
        hue = RIGHT if names[i] == columns[j] else _MISTAKES
        weight = _PALEST + (1.0 - _PALEST) * float(share)
        corner = np.array([left + j * cell, top + i * cell])
        canvas.box(corner, corner + cell - 2, paler(hue, 1.0 - weight) if share else SHADE)
        if share and cell >= _FIGURES_FROM:
            percent = f"{100 * share:.0f}"
            colour = PAPER if share > _DARK else INK
            x, y = corner + (cell - 2) / 2
            words = "<1" if percent == "0" else percent
            canvas.text(x, y, words, cell * 0.26, colour, "centre")
    for i, name in enumerate(names):
        y = top + (i + 0.5) * cell
        canvas.text(left - _GAP, y, name, letters, INK, "right")
        canvas.text(right + _GAP, y, f"{counts[i].sum():,.0f} scans", letters, QUIET)
    for j, name in enumerate(columns):
        x, y = left + (j + 0.5) * cell, top - _GAP
        if text_width(name, letters) > cell - 4:
            canvas.upright_text(x, y, name, letters)
        else:
            canvas.text(x, y - letters / 2, name, letters, align="centre")
    return canvas.image

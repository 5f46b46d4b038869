"""The pictures of predicted submaps: along a trajectory (the paper's figure 6), and counted."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from specmap_cli.grids.gridmap import BoolArray
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
    if fills is None:
        fills = _fills(submaps, map_with_regions)
    shown = {"predicted submap, with its id", "start"}
    shown |= {"wall"} if map_with_regions is not None else set()
    shown |= {"unknown"} if (submaps == NO_SUBMAP).any() else set()
    shown |= {"wrong"} if truth is not None else set()
    regions = None if map_with_regions is None else map_with_regions[1]
    sheet = Sheet(*extent_of(regions, places, _BORDER_M), symbols.legend_of(shown))
    if map_with_regions is not None:
        sheet.ground(map_with_regions[1], fills)
    if truth is not None:
        wrong = (submaps != np.asarray(truth)[known]) & (submaps != NO_SUBMAP)
        _draw_wrong(sheet, places, wrong)
    badges = _draw_predicted(sheet, places, submaps, fills)
    if map_with_regions is not None:
        _draw_names(sheet, *map_with_regions, badges)
    sheet.title(title, figures)
    return sheet.canvas.image


def _fills(
    submaps: IntArray, map_with_regions: tuple[TopologicalMap, Regions] | None
) -> dict[int, Colour]:
    """The colours of the map's own overview, or colours that differ along the trajectory."""
    if map_with_regions is not None:
        return colours_of(*map_with_regions)
    ids = [int(id_) for id_ in np.unique(submaps) if id_ != NO_SUBMAP]
    return colour_graph(ids, set(itertools.pairwise(submaps.tolist())))


def _draw_names(
    sheet: Sheet, topology: TopologicalMap, regions: Regions, badges: FloatArray
) -> None:
    """The ids on the ground, where no badge is near, and the names that a person gave."""
    for id_, submap in sorted(topology.submaps.items()):
        centroid = regions.outline(id_).centroid
        if centroid is None:
            continue
        place = sheet.pixels(centroid[None])[0]
        if (np.linalg.norm(badges - place, axis=1) > _CLEAR_OF_BADGES).all():
            symbols.ground_id(sheet.canvas, place, id_)
        symbols.name_under(sheet.canvas, place, legible(submap.given_name))


def _draw_wrong(sheet: Sheet, places: FloatArray, wrong: BoolArray) -> None:
    for stroke in strokes(places, wrong):
        if wrong[stroke.first]:
            way = sheet.pixels(places[stroke.first : stroke.drawn_to])
            sheet.canvas.line(way, WRONG, symbols.MISTAKEN)


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
        if id_ != NO_SUBMAP and _has_room(id_, middle, taken):
            symbols.badge(sheet.canvas, middle, str(id_), fills[id_])
            taken.append((id_, middle))
    if len(pixels):
        symbols.start(sheet.canvas, pixels[0])
    return np.array([middle for _, middle in taken]).reshape(-1, 2)


def _has_room(id_: int, middle: FloatArray, taken: list[tuple[int, FloatArray]]) -> bool:
    """Whether a badge fits: clear of all others, and well away from one of the same id."""
    return all(
        np.linalg.norm(middle - other)
        > symbols.BADGE_GAP * (_SAME_ID_GAP if id_ == other_id else 1.0)
        for other_id, other in taken
    )


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
    table = _Table.of(list(names), columns)
    width = max(table.right + _COUNTS + _MARGIN, _NARROWEST)
    canvas = Canvas(width, table.top + table.cell * len(names) + _MARGIN)
    canvas.text(_MARGIN, 46, "Confusion", 20, bold=True)
    canvas.text(
        _MARGIN, 80, "row: where it was;  column: what was said;  percent of the row", 13, QUIET
    )
    _draw_cells(canvas, counts, table)
    _draw_classes(canvas, counts, table)
    return canvas.image


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    """Where the cells lie, in pixels: `left` and `top` of the first one, and the side of each."""

    names: list[str]
    columns: list[str]
    left: int
    top: int
    cell: int
    letters: float

    @classmethod
    def of(cls, names: list[str], columns: list[str]) -> _Table:
        """The largest cells that fit, to the right of and below the names."""
        side = _SIDE / max(1, len(names), len(columns))
        cell = int(np.clip(side, _SMALLEST_CELL, _LARGEST_CELL))
        letters = float(np.clip(cell * 0.3, _SMALLEST_LETTERS, _LARGEST_LETTERS))
        return cls(
            names=names,
            columns=columns,
            left=_MARGIN + 40 + max([text_width(name, letters) for name in names], default=0),
            top=_TITLE + 40 + max([text_width(name, letters) for name in columns], default=0),
            cell=cell,
            letters=letters,
        )

    @property
    def right(self) -> int:
        """The end of the last column."""
        return self.left + self.cell * len(self.columns)

    def corner(self, row: int, column: int) -> NDArray[np.int64]:
        """(2,) upper left corner of a cell."""
        return np.array([self.left + column * self.cell, self.top + row * self.cell])


def _draw_classes(canvas: Canvas, counts: NDArray[np.float64], table: _Table) -> None:
    """The names of rows and columns, and the scans of each row."""
    cell, letters = table.cell, table.letters
    for i, name in enumerate(table.names):
        y = table.top + (i + 0.5) * cell
        canvas.text(table.left - _GAP, y, name, letters, INK, "right")
        canvas.text(table.right + _GAP, y, f"{counts[i].sum():,.0f} scans", letters, QUIET)
    for j, name in enumerate(table.columns):
        x, y = table.left + (j + 0.5) * cell, table.top - _GAP
        if text_width(name, letters) > cell - 4:
            canvas.upright_text(x, y, name, letters)
        else:
            canvas.text(x, y - letters / 2, name, letters, align="centre")


def _draw_cells(canvas: Canvas, counts: NDArray[np.float64], table: _Table) -> None:
    """Every cell in its colour, with its percent where there is room."""
    cell = table.cell
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    for (i, j), share in np.ndenumerate(shares):
        hue = RIGHT if table.names[i] == table.columns[j] else _MISTAKES
        weight = _PALEST + (1.0 - _PALEST) * float(share)
        corner = table.corner(i, j)
        canvas.box(corner, corner + cell - 2, paler(hue, 1.0 - weight) if share else SHADE)
        if share and cell >= _FIGURES_FROM:
            percent = f"{100 * share:.0f}"
            colour = PAPER if share > _DARK else INK
            x, y = corner + (cell - 2) / 2
            words = "<1" if percent == "0" else percent
            canvas.text(x, y, words, cell * 0.26, colour, "centre")

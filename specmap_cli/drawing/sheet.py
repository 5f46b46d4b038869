"""A sheet of paper with a map on it: ground, title, scale bar and legend."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing.canvas import Canvas, text_width
from specmap_cli.drawing.palette import INK, PAPER, QUIET, SHADE, Colour
from specmap_cli.drawing.symbols import Legend, Symbol
from specmap_cli.grids.gridmap import FREE, UNKNOWN, BoolArray, GridMap
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions

# Pixels, chosen by eye for a picture that fills a page or a screen.
LONG_SIDE = 1800  # of the map
NARROWEST = 1100  # of what is between the margins: the legend needs room, too
MARGIN = 56
TITLE = 122  # of paper above the map
_BELOW = 44.0  # from the map to the scale bar
_ROW = 44  # of the legend
_LETTERS = 14.0
_SYMBOL_AT, _WORDS_AT, _ENTRY_GAP = 22, 52.0, 38.0  # inside and after an entry of the legend
_SCALE_BAR = 360.0  # at the most
_WALL_STRENGTH = 1.6  # a wall of one cell is drawn as if it were at least this wide
_SQUARES_FROM = 16.0  # larger cells have sharp edges: smooth ones would blur over the margin
_LEAST_EXTENT_M = 0.5  # a map of a few cells, or of none, is drawn as if it were this large


class Sheet:
    """A map drawn to scale on a canvas with room for a title above and a legend below.

    `pixels_per_m` is chosen so that the longer side of the map is LONG_SIDE pixels.
    """

    def __init__(self, low: NDArray[Any], high: NDArray[Any], legend: Legend) -> None:
        extent = np.maximum(np.asarray(high) - low, _LEAST_EXTENT_M)
        self.pixels_per_m = LONG_SIDE / float(extent.max())
        self.low = np.asarray(low, dtype=np.float64)
        width, self.map_height = (math.ceil(side) for side in extent * self.pixels_per_m)
        total = max(width, NARROWEST) + 2 * MARGIN
        self.left = (total - width) // 2
        rows = _legend_rows(legend, total - 2 * MARGIN)
        self.canvas = Canvas(
            total, TITLE + self.map_height + 30 + _ROW * (len(rows) + 1) + MARGIN // 2
        )
        self._draw_scale_bar()
        self._draw_legend(rows)

    def pixels(self, points: NDArray[Any]) -> FloatArray:
        """(N, 2) places on the canvas of points (N, 2) of the map."""
        x, y = ((np.asarray(points, dtype=np.float64) - self.low) * self.pixels_per_m).T
        return np.column_stack([self.left + x, TITLE + self.map_height - y])

    def title(self, words: str, below: str) -> None:
        """The headline, and a line of figures under it; both shrink to fit."""
        width = self.canvas.image.shape[1] - 2 * MARGIN
        for text, y, height, colour, bold in (
            (words, 46.0, 24.0, INK, True),
            (below, 90.0, 15.0, QUIET, False),
        ):
            fitting = height * min(1.0, width / max(1, text_width(text, height, bold)))
            self.canvas.text(MARGIN, y, text, fitting, colour, bold=bold)

    def ground(self, regions: Regions, fills: Mapping[int, Colour]) -> None:
        """Paint regions in their colours, unowned free cells grey, walls dark."""
        self.floor(regions, fills)
        self.walls(regions.grid, regions.grid.occupied, INK)

    def floor(self, regions: Regions, fills: Mapping[int, Colour]) -> None:
        """Paint regions in their colours, unowned free cells grey."""
        grid, owner = _at_most_a_pixel_each(regions, self.pixels_per_m)
        table = np.full((max([int(owner.max(initial=0)), *fills]) + 2, 3), SHADE, dtype=np.uint8)
        for id_, fill in fills.items():
            table[id_ + 1] = fill
        colours = table[owner + 1]
        colours[grid.cells != FREE] = PAPER
        inside = slice(TITLE, TITLE + self.map_height)
        painted = self._to_scale(colours, grid, PAPER)
        self.canvas.image[inside] = painted[inside]

    def walls(self, grid: GridMap, walls: BoolArray, colour: Colour) -> None:
        """Paint some cells (H, W) of a grid in one colour over what is there."""
        step = _thinning(grid, self.pixels_per_m)
        padded = _padded(walls, step, fill=False)
        height, width = padded.shape
        by_block = padded.reshape(height // step, step, width // step, step)
        blocks = np.asarray(by_block.any(axis=(1, 3)))
        thinned = GridMap(blocks.astype(np.uint8), grid.resolution * step, grid.origin)
        cover = self._to_scale(blocks.astype(np.float32), thinned)[..., None]
        scale = thinned.resolution * self.pixels_per_m
        cover = np.minimum(cover * max(1.0, _WALL_STRENGTH / scale), 1.0)
        inside = slice(TITLE, TITLE + self.map_height)
        painted = self.canvas.image[inside]
        inked = painted * (1.0 - cover[inside])
        inked = inked + np.array(colour, dtype=np.float32) * cover[inside]
        self.canvas.image[inside] = np.round(inked).astype(np.uint8)

    def _to_scale(
        self, picture: NDArray[Any], grid: GridMap, border: Colour = (0, 0, 0)
    ) -> NDArray[Any]:
        """A picture of the cells of a grid, as large as the canvas and where it belongs."""
        scale = grid.resolution * self.pixels_per_m
        left, bottom = self.pixels(np.array([grid.origin]))[0]
        # the pixel of the centre of cell (row, column); pixel centres are whole numbers
        to_pixels = np.array(
            [
                [scale, 0.0, left + 0.5 * scale - 0.5],
                [0.0, -scale, bottom - 0.5 * scale - 0.5],
            ]
        )
        size = (self.canvas.image.shape[1], self.canvas.image.shape[0])
        edges = cv2.INTER_NEAREST if scale > _SQUARES_FROM else cv2.INTER_LINEAR
        return cv2.warpAffine(picture, to_pixels, size, flags=edges, borderValue=border)

    def _draw_scale_bar(self) -> None:
        """A bar of a round length, alternately dark and light."""
        length = _round_length(_SCALE_BAR / self.pixels_per_m)
        y = TITLE + self.map_height + _BELOW
        step = length * self.pixels_per_m / 4
        for i in range(4):
            x = MARGIN + i * step
            self.canvas.box(np.array([x, y]), np.array([x + step, y + 9]), INK)
            if i % 2:
                self.canvas.box(np.array([x, y + 2]), np.array([x + step - 2, y + 7]), PAPER)
        end = MARGIN + 4 * step
        self.canvas.text(end + 12, y + 4, f"{length:g} m", _LETTERS)

    def _draw_legend(self, rows: Sequence[Legend]) -> None:
        for number, row in enumerate(rows):
            x, y = float(MARGIN), TITLE + self.map_height + _BELOW + _ROW * (number + 1)
            for words, symbol in row:
                symbol(self.canvas, x + _SYMBOL_AT, y)
                self.canvas.text(x + _WORDS_AT, y, words, _LETTERS)
                x += _entry_width(words)


def _at_most_a_pixel_each(regions: Regions, pixels_per_m: float) -> tuple[GridMap, OwnerArray]:
    """Cells and owners, thinned out until a cell is more than half a pixel.

    Blocks of cells keep the state and the owner of their middle one.
    """
    step = _thinning(regions.grid, pixels_per_m)
    cells = _padded(regions.grid.cells, step, UNKNOWN)
    owner = _padded(regions.owner, step, NOBODY)
    middle = (slice(step // 2, None, step), slice(step // 2, None, step))
    thinned = GridMap(cells[middle], regions.grid.resolution * step, regions.grid.origin)
    return thinned, owner[middle]


def _thinning(grid: GridMap, pixels_per_m: float) -> int:
    """How many cells a side make one that is more than half a pixel."""
    step = max(1, int(1.0 / (grid.resolution * pixels_per_m)))
    return int(min(step, max(1, *grid.cells.shape)))  # a way may lead far out of a small grid


def _padded(cells: NDArray[Any], step: int, fill: int) -> NDArray[Any]:
    """Cells (H, W) with some more of a kind, until whole blocks of `step` by `step` are full."""
    if step == 1:
        return cells
    return np.pad(cells, [(0, -side % step) for side in cells.shape], constant_values=fill)


def extent_of(regions: Regions) -> tuple[FloatArray, FloatArray]:
    """Lower left and upper right corner of the known cells, metres; half a metre when none is."""
    grid = regions.grid
    known = grid.cells != UNKNOWN
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        low = np.array(grid.origin, dtype=np.float64)
        return low, low + _LEAST_EXTENT_M
    low = np.array([columns[0], rows[0]]) * grid.resolution + grid.origin
    high = np.array([columns[-1] + 1, rows[-1] + 1]) * grid.resolution + grid.origin
    return low, high


def _entry_width(words: str) -> float:
    return _WORDS_AT + text_width(words, _LETTERS) + _ENTRY_GAP


def _legend_rows(legend: Legend, width: int) -> list[Legend]:
    """Break the entries into rows that fit."""
    rows: list[list[tuple[str, Symbol]]] = []
    used = math.inf
    for entry in legend:
        needed = _entry_width(entry[0])
        if used + needed > width:
            rows.append([])
            used = 0.0
        rows[-1].append(entry)
        used += needed
    return [tuple(row) for row in rows]


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten up to `length`."""
    power = 10.0 ** math.floor(math.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))

"""A sheet of paper with a map on it: ground, title, scale bar and legend.

Also which pieces of a trajectory are drawn on it as one line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import runs
from specmap_cli.core.geometry import FloatArray, step_lengths
from specmap_cli.drawing.canvas import Canvas, fitting_height, text_width
from specmap_cli.drawing.palette import BORDER, INK, PAPER, QUIET, SEEN, Colour
from specmap_cli.drawing.symbols import Legend, Symbol
from specmap_cli.grids.gridmap import FREE, UNKNOWN, BoolArray, GridMap, looked_up, window_of
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions

# Pixels, chosen by eye for a picture that fills a page or a screen.
LONG_SIDE = 1800  # of the map
NARROWEST = 1100  # of what is between the margins: the legend needs room, too
MARGIN = 56
TITLE = 122  # of paper above the map
_BELOW = 32.0  # from the map to the scale bar
_BAR = 62  # from the map to the first row of the legend, less a row
_ROW = 44  # of the legend
_LETTERS = 14.0
_SYMBOL_AT, _WORDS_AT, _ENTRY_GAP = 22, 52.0, 38.0  # inside and after an entry of the legend
_SCALE_BAR = 360.0  # at the most
_PARTS = {1: 5, 2: 4, 5: 5}  # of a scale bar, by the first figure of its length
_FIGURES = 26.0  # from the bar to the figures below it
_BORDER_BLUR, _BORDER_STRENGTH = 0.8, 1.5  # sigma in pixels; two pixels are then nearly full
_WALL_STRENGTH = 1.6  # a wall of one cell is drawn as if it were at least this wide
_SQUARES_FROM = 16.0  # larger cells have sharp edges: smooth ones would blur over the margin
_STRIP = 64  # rows that are coloured at a time
_LEAST_EXTENT_M = 0.5  # a map of a few cells, or of none, is drawn as if it were this large

# A longer step from scan to scan is no way driven: the robot was lost and turned up elsewhere.
# Logs with few scans have long steps throughout, so a jump is longer than nearly all of them, too.
_JUMP_M = 1.5
_USUAL_STEPS, _USUAL_PERCENTILE = 3.0, 90.0


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
        placed: list[tuple[float, int, str, Symbol]] = []  # entries, in as many rows as they need
        x, row = math.inf, -1
        for words, symbol in legend:
            needed = _WORDS_AT + text_width(words, _LETTERS) + _ENTRY_GAP
            if x + needed > total - MARGIN:
                x, row = float(MARGIN), row + 1
            placed.append((x, row, words, symbol))
            x += needed
        below = TITLE + self.map_height + _BAR
        self.canvas = Canvas(total, below + _ROW * (row + 2) + MARGIN // 2)
        self._draw_scale_bar()
        for x, row, words, symbol in placed:
            y = below + 14.0 + _ROW * (row + 1)
            symbol(self.canvas, np.array([x + _SYMBOL_AT, y]))
            self.canvas.text(x + _WORDS_AT, y, words, _LETTERS)

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
            fitting = fitting_height(text, height, width, bold)
            self.canvas.text(MARGIN, y, text, fitting, colour, bold=bold)

    def margin(self, words: str) -> None:
        """A line at the right below the map, beside the scale bar."""
        width = self.canvas.image.shape[1]
        room = width - 3 * MARGIN - _SCALE_BAR - text_width("0 m", _LETTERS)
        height = fitting_height(words, _LETTERS, room)
        y = TITLE + self.map_height + _BELOW + _FIGURES / 2
        self.canvas.text(width - MARGIN, y, words, height, QUIET, "right")

    def ground(self, regions: Regions, fills: Mapping[int, Colour]) -> None:
        """Paint regions in their colours with borders, what was only seen grey, walls dark."""
        self.floor(regions, fills)
        # lines where one region ends and another begins without a wall
        grid, owner = _at_most_a_pixel_each(regions, self.pixels_per_m)
        owned = np.where(grid.cells == FREE, owner + 1, 0).astype(np.uint16)
        labels = self._to_scale(owned, grid, edges=cv2.INTER_NEAREST)
        del owned
        line = np.zeros(labels.shape, dtype=np.uint8)
        here, right, below = labels[:-1, :-1], labels[:-1, 1:], labels[1:, :-1]
        for other in (right, below):
            line[:-1, :-1][(here != other) & (here > 0) & (other > 0)] = 255
        # two pixels wide, and no staircase of cells; whole numbers are blurred alike everywhere
        blurred = cv2.GaussianBlur(line, (0, 0), _BORDER_BLUR)
        self._blend(blurred, _BORDER_STRENGTH / 255.0, BORDER)
        self.walls(regions.grid, regions.grid.occupied, INK)

    def floor(self, regions: Regions, fills: Mapping[int, Colour]) -> None:
        """Paint regions in their colours, what was only seen grey."""
        grid, owner = _at_most_a_pixel_each(regions, self.pixels_per_m)
        table = np.full((max([int(owner.max(initial=0)), *fills]) + 2, 3), SEEN, dtype=np.uint8)
        for id_, fill in fills.items():
            table[id_] = fill
        inside, blocked = slice(TITLE, TITLE + self.map_height), grid.cells != FREE
        for channel, paper in enumerate(PAPER):  # one at a time: this bounds the memory
            shades = looked_up(table[:, channel], owner)  # the last is that of nobody, -1
            shades[blocked] = paper
            painted = self._to_scale(shades, grid, paper)
            self.canvas.image[inside, :, channel] = painted[inside]

    def walls(self, grid: GridMap, walls: BoolArray, colour: Colour) -> None:
        """Paint some cells (H, W) of a grid in one colour over what is there."""
        step = _thinning(grid, self.pixels_per_m)
        padded = _padded(walls, step, fill=False)
        height, width = padded.shape
        by_block = padded.reshape(height // step, step, width // step, step)
        blocks = np.asarray(by_block.any(axis=(1, 3)))
        thinned = GridMap(blocks.astype(np.uint8), grid.resolution * step, grid.origin)
        cover = self._to_scale(blocks.astype(np.float32), thinned)
        scale = thinned.resolution * self.pixels_per_m
        self._blend(cover, max(1.0, _WALL_STRENGTH / scale), colour)

    def _blend(self, cover: NDArray[Any], strength: float, colour: Colour) -> None:
        """Colour the map's rows by `cover` (H, W) times `strength`, in strips to save memory.

        Lines cover little: only what they touch is computed.
        """
        ink, end = np.array(colour, dtype=np.float32), TITLE + self.map_height
        for first in range(TITLE, end, _STRIP):
            rows = slice(first, min(first + _STRIP, end))
            painted, touched = self.canvas.image[rows], cover[rows] != 0
            share = np.minimum(cover[rows][touched][:, None] * strength, 1.0)
            painted[touched] = np.round(painted[touched] * (1.0 - share) + ink * share)

    def _to_scale(
        self,
        picture: NDArray[Any],
        grid: GridMap,
        border: int = 0,
        edges: int | None = None,
    ) -> NDArray[Any]:
        """A picture of the cells of a grid, as large as the canvas and where it belongs."""
        scale = grid.resolution * self.pixels_per_m
        left, bottom = self.pixels(np.array([grid.origin]))[0]
        # the pixel of the centre of cell (row, column); pixel centres are whole numbers
        to_pixels = np.array(
            [[scale, 0.0, left + 0.5 * scale - 0.5], [0.0, -scale, bottom - 0.5 * scale - 0.5]]
        )
        size = (self.canvas.image.shape[1], self.canvas.image.shape[0])
        if edges is None:
            edges = cv2.INTER_NEAREST if scale > _SQUARES_FROM else cv2.INTER_LINEAR
        return cv2.warpAffine(picture, to_pixels, size, flags=edges, borderValue=border)

    def _draw_scale_bar(self) -> None:
        """A bar of a round length, its dark and light parts round as well, with figures below."""
        length, parts = round_length(_SCALE_BAR / self.pixels_per_m)
        y = TITLE + self.map_height + _BELOW
        step = length * self.pixels_per_m / parts
        for i in range(parts):
            x = MARGIN + i * step
            self.canvas.box(np.array([x, y]), np.array([x + step, y + 9]), INK)
            if i % 2:
                self.canvas.box(np.array([x, y + 2]), np.array([x + step - 2, y + 7]), PAPER)
        y += _FIGURES
        self.canvas.text(MARGIN, y, "0", _LETTERS)
        first, end = f"{length / parts:g}", f"{length:g}"
        if text_width(first, _LETTERS) < step:
            self.canvas.text(MARGIN + step, y, first, _LETTERS, align="centre")
        x = MARGIN + parts * step - text_width(end, _LETTERS) / 2
        self.canvas.text(x, y, f"{end} m", _LETTERS)


def _at_most_a_pixel_each(regions: Regions, pixels_per_m: float) -> tuple[GridMap, OwnerArray]:
    """Cells and owners, of blocks the middle one, so that a cell is more than half a pixel."""
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


def extent_of(
    regions: Regions | None, places: FloatArray | None = None, beside_m: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Lower left and upper right corner of the known cells and of places (n, 2), metres.

    There is paper `beside_m` round the places. It is half a metre when nothing is known, and a
    metre when there is neither a map nor a place.
    """
    corners: list[FloatArray] = []
    if regions is not None:
        grid = regions.grid
        low = np.array(grid.origin, dtype=np.float64)
        corners = [low, low + _LEAST_EXTENT_M]
        window = window_of(np.asarray(grid.cells != UNKNOWN))
        if window is not None:
            rows, columns = window
            ends = [[columns.start, rows.start], [columns.stop, rows.stop]]
            corners = [np.array(end) * grid.resolution + low for end in ends]
    if places is not None and len(places):
        corners += [places.min(axis=0) - beside_m, places.max(axis=0) + beside_m]
    if not corners:
        return np.zeros(2), np.ones(2)
    return np.min(corners, axis=0), np.max(corners, axis=0)


def round_length(length: float) -> tuple[float, int]:
    """The largest of 1, 2, 5 times a power of ten up to `length`, and into how many parts it goes.

    The parts are of a round length, too.
    """
    power = 10.0 ** math.floor(math.log10(length))
    step = max(step for step in _PARTS if step * power <= length * (1 + 1e-9))
    return float(power * step), _PARTS[step]


class Stroke(NamedTuple):
    """Scans first..end - 1 share one label; their line is drawn up to scan drawn_to - 1."""

    first: int
    end: int
    drawn_to: int


def strokes(places: FloatArray, labels: NDArray[Any] | None = None) -> list[Stroke]:
    """Runs of one of the `labels` (n,) along `places` (n, 2), broken where the robot jumps.

    The line of a stroke reaches the first place of the next one, unless the robot jumped there.
    Without labels only jumps break the line.
    """
    values = np.zeros(len(places), dtype=np.int64) if labels is None else np.asarray(labels)
    steps = step_lengths(places)
    usual = float(np.percentile(steps, _USUAL_PERCENTILE)) if len(steps) else 0.0
    jumps = steps > max(_JUMP_M, _USUAL_STEPS * usual)
    passages = np.cumsum(np.concatenate([[False], jumps]))[: len(places)]  # (n,) between jumps
    return [
        Stroke(first + start, first + stop, min(first + stop + 1, end))
        for first, end in runs(passages)
        for start, stop in runs(values[first:end])
    ]

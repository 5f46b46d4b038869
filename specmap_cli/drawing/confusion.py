"""The picture of a confusion matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.drawing.canvas import Canvas, Image, text_width
from specmap_cli.drawing.palette import INK, PAPER, QUIET, RIGHT, SHADE, Colour, paler

# Pixels, chosen by eye for a page as wide as a screen.
_SIDE = 1400  # of all cells of the longer side together, while they are of a size to be seen
_SMALLEST_CELL, _LARGEST_CELL = 14, 72
_SMALLEST_LETTERS, _LARGEST_LETTERS = 8.0, 15.0
_FIGURES_FROM = 26  # a smaller cell has no room for its percent
_MARGIN, _TITLE, _GAP, _COUNTS, _NARROWEST = 48, 96, 12, 110, 700
_RIGHT: Colour = RIGHT
_WRONG: Colour = (40, 24, 200)
_PALEST = 0.12  # weight of the hue in the cell of a single scan: it must be seen
_DARK = 0.45  # share from which letters are white


def render_confusion(
    matrix: NDArray[Any],
    names: Sequence[str],
    predicted_names: Sequence[str] | None = None,
    title: str = "Confusion",
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
    canvas.text(_MARGIN, 46, title, 20, bold=True)
    canvas.text(
        _MARGIN, 80, "row: where it was;  column: what was said;  percent of the row", 13, QUIET
    )
    _draw_cells(canvas, counts, table)
    _draw_names(canvas, counts, table)
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


def _draw_names(canvas: Canvas, counts: NDArray[np.float64], table: _Table) -> None:
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
            canvas.text(x, y - letters / 2, name, letters, anchor="centre")


def _draw_cells(canvas: Canvas, counts: NDArray[np.float64], table: _Table) -> None:
    """Every cell in its colour, with its percent where there is room."""
    cell = table.cell
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    for (i, j), share in np.ndenumerate(shares):
        hue = _RIGHT if table.names[i] == table.columns[j] else _WRONG
        weight = _PALEST + (1.0 - _PALEST) * float(share)
        corner = table.corner(i, j)
        canvas.box(corner, corner + cell - 2, paler(hue, 1.0 - weight) if share else SHADE)
        if share and cell >= _FIGURES_FROM:
            percent = f"{100 * share:.0f}"
            colour = PAPER if share > _DARK else INK
            x, y = corner + (cell - 2) / 2
            words = "<1" if percent == "0" else percent
            canvas.text(x, y, words, cell * 0.26, colour, "centre")

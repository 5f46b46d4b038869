"""The picture of a confusion matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.drawing.canvas import Canvas, Image, text_width
from specmap_cli.drawing.palette import INK, PAPER, QUIET, SHADE, TRAVERSED, Colour

_SIDE = 1400
_MARGIN = 48
_TITLE = 96
_RIGHT: Colour = TRAVERSED
_WRONG: Colour = (40, 24, 200)


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
    cell = int(np.clip(_SIDE / max(1, *counts.shape), 14, 72))
    letters = float(np.clip(cell * 0.3, 8, 15))
    left = _MARGIN + 40 + max([text_width(name, letters) for name in names], default=0)
    top = _TITLE + 40 + max([text_width(name, letters) for name in columns], default=0)
    width = max(left + cell * len(columns) + 110 + _MARGIN, 700)
    canvas = Canvas(width, top + cell * len(names) + _MARGIN)
    canvas.text(_MARGIN, 46, title, 20, bold=True)
    canvas.text(
        _MARGIN, 80, "row: where it was;  column: what was said;  percent of the row", 13, QUIET
    )
    _draw_cells(canvas, counts, names, columns, (left, top, cell))
    for i, name in enumerate(names):
        y = top + (i + 0.5) * cell
        canvas.text(left - 12, y, name, letters, INK, "right")
        canvas.text(
            left + cell * len(columns) + 12, y, f"{counts[i].sum():,.0f} scans", letters, QUIET
        )
    for j, name in enumerate(columns):
        x = left + (j + 0.5) * cell
        if text_width(name, letters) > cell - 4:
            canvas.upright_text(x, top - 12, name, letters)
        else:
            canvas.text(x, top - 12 - letters / 2, name, letters, anchor="centre")
    return canvas.image


def _draw_cells(
    canvas: Canvas,
    counts: NDArray[np.float64],
    names: Sequence[str],
    columns: Sequence[str],
    frame: tuple[int, int, int],
) -> None:
    left, top, cell = frame
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    for (i, j), share in np.ndenumerate(shares):
        hue = _RIGHT if names[i] == columns[j] else _WRONG
        corner = np.array([left + j * cell, top + i * cell])
        canvas.box(corner, corner + cell - 2, _mix(hue, float(share)) if share else SHADE)
        if share and cell >= 26:
            percent = f"{100 * share:.0f}" if share >= 0.005 else "<1"
            colour = PAPER if share > 0.45 else INK
            x, y = corner + (cell - 2) / 2
            canvas.text(x, y, percent, cell * 0.26, colour, "centre")


def _mix(hue: Colour, share: float) -> Colour:
    """From nearly white at a share of nothing to the full hue."""
    weight = 0.12 + 0.88 * share
    blue, green, red = (round(255 + weight * (channel - 255)) for channel in hue)
    return blue, green, red

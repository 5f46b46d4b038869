"""The drawing of a map in a page: whole centimetres, y down, lines as SVG path data, colours.

Colours are those of the palette by day, and made of them by night.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.drawing import palette
from specmap_cli.drawing.palette import Colour, darker, paler
from specmap_cli.grids.gridmap import GridMap

_CM = 100.0
_MARGIN_M = 0.5  # of paper round what is known
_TOLERANCE = 1.2  # of a simplified outline, half cells: the stairs of a slanted wall are gone
STEPS = 12  # of the colours of time
_LATE = darker(palette.LOOSE, 0.9)
_DARKEST, _LIGHTEST = 12.0, 90.0  # CIELAB lightness of the paper and of the ink by night
_FILL_DROP, _FILL_CHROMA = 44.0, 0.8  # by night a region is so much darker, and less colourful


@dataclass(frozen=True, slots=True)
class Frame:
    """The part of the map that is drawn: `left` and `top` in metres, `width` and `height` in cm."""

    left: float
    top: float
    width: int
    height: int

    @classmethod
    def around(cls, points: FloatArray) -> Frame:
        """The frame round some points (N, 2) of the map, with a margin; a square without any."""
        if not len(points):
            points = np.zeros((1, 2))
        (left, low), (right, top) = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
        width, height = (round(float(side) * _CM) for side in (right - left, top - low))
        return cls(float(left), float(top), width, height)

    def places(self, points: FloatArray) -> IntArray:
        """(N, 2) points of the map in the drawing."""
        corner = np.array([self.left, self.top])
        moved = (np.asarray(points, dtype=np.float64).reshape(-1, 2) - corner) * (_CM, -_CM)
        return np.asarray(np.rint(moved), dtype=np.int64)

    def place(self, point: Iterable[float]) -> tuple[int, int]:
        """One point of the map in the drawing."""
        ((x, y),) = self.places(np.array([*point])).tolist()
        return x, y

    def line(self, points: Sequence[Sequence[float]] | FloatArray, *, closed: bool = False) -> str:
        """A polyline through points of the map, as path data in the drawing."""
        return path_data([self.places(np.array(points))], closed=closed)


def path_data(lines: Iterable[IntArray], *, closed: bool = False) -> str:
    """The data of an SVG path for polylines (n, 2) in the drawing: the first point, then steps."""
    parts = []
    for line in lines:
        if len(line) < 2:
            continue
        (x, y), *_ = line.tolist()
        steps = np.diff(line, axis=0)
        moved = steps[(steps != 0).any(axis=1)]
        # a minus sign parts numbers as well as a space does
        joined = " ".join(map(str, moved.reshape(-1).tolist())).replace(" -", "-")
        parts.append(f"M{x} {y}l{joined}" if len(moved) else f"M{x} {y}h0")
        if closed:
            parts.append("z")
    return "".join(parts)


def outlines(cells: BoolArray, grid: GridMap) -> list[FloatArray]:
    """Outlines and holes of `cells` (H, W) of a grid as rings (n, 2), metres.

    They run a quarter of a cell inside: drawn with a pen half a cell wide they have their size.
    """
    if not cells.any():
        return []
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    low, left = int(rows[0]), int(columns[0])
    part = cells[low : rows[-1] + 1, left : columns[-1] + 1]
    doubled = cv2.resize(
        part.astype(np.uint8), None, fx=2.0, fy=2.0, interpolation=cv2.INTER_NEAREST
    )
    rings, _ = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    found = []
    for ring in rings:
        simple = cv2.approxPolyDP(ring, _TOLERANCE, True) if len(ring) > 4 else ring
        kept = simple if len(simple) > 2 else ring  # one thinner than the tolerance as it is
        halves = kept.reshape(-1, 2).astype(np.float64) + 0.5
        found.append((halves / 2.0 + (left, low)) * grid.resolution + grid.origin)
    return found


def simplified(line: IntArray, tolerance: float) -> IntArray:
    """A polyline (n, 2) in the drawing without the points that stray less than the tolerance."""
    if len(line) < 3:
        return line
    kept = cv2.approxPolyDP(line.astype(np.int32)[:, None], tolerance, False)
    return np.asarray(kept.reshape(-1, 2), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Tone:
    """A colour of the page by day and by night, as CSS writes it."""

    day: str
    night: str


def tones(fills: Iterable[Colour]) -> dict[str, Tone]:
    """Every colour of the map by the name of its variable; `fills` are those of its regions."""
    greys = (("shade", palette.SHADE, 24.0), ("seen", palette.SEEN, 34.0))  # lightness by night
    names = fill_names(fills)
    lines: dict[str, Colour] = {
        "ink": palette.INK,
        "quiet": darker(palette.QUIET, 0.8),
        "hair": paler(palette.QUIET, 0.7),
        "way": palette.TRAVERSED,
        "closure": palette.CLOSURE,
        "wrong": palette.WRONG,
        "loose": darker(palette.LOOSE, 0.85),
        "door": palette.DOOR,
    }
    # from early to late: ever lighter, so that it reads without telling hues apart
    for k, colour in enumerate(_blend((palette.INK, palette.CLOSURE, _LATE), STEPS)):
        lines[f"time-{k}"] = colour
    # from scans that do not fit the walls to those that do
    for k, colour in enumerate(_blend((palette.WRONG, _LATE, darker(palette.QUIET, 0.8)), 5)):
        lines[f"fit-{k}"] = colour
    by_night = {
        fill: _from_lab(light - _FILL_DROP, green_red * _FILL_CHROMA, blue_yellow * _FILL_CHROMA)
        for fill in names
        for light, green_red, blue_yellow in [_to_lab(fill)]
    }
    return {
        "paper": Tone(css(palette.PAPER), css(_inverted(palette.PAPER))),
        **{name: Tone(css(c), css(_from_lab(night, *_to_lab(c)[1:]))) for name, c, night in greys},
        **{name: Tone(css(colour), css(_inverted(colour))) for name, colour in lines.items()},
        **{name: Tone(css(fill), css(by_night[fill])) for fill, name in names.items()},
    }


def fill_names(fills: Iterable[Colour]) -> dict[Colour, str]:
    """The name of the variable of each colour of a region."""
    return {fill: f"fill-{number}" for number, fill in enumerate(sorted(set(fills)))}


def css(colour: Colour) -> str:
    """A colour as CSS writes it."""
    blue, green, red = colour
    return f"#{red:02x}{green:02x}{blue:02x}"


def _blend(stops: Sequence[Colour], steps: int) -> list[Colour]:
    """Colours evenly spread between some stops, in CIELAB."""
    lab = np.array([_to_lab(stop) for stop in stops])
    at = np.linspace(0.0, len(stops) - 1.0, steps)
    mixed = [np.interp(at, range(len(stops)), lab[:, axis]) for axis in range(3)]
    return [_from_lab(*map(float, row)) for row in np.column_stack(mixed)]


def _inverted(colour: Colour) -> Colour:
    """The same hue, light where it was dark."""
    light, a, b = _to_lab(colour)
    span = _LIGHTEST - _DARKEST
    return _from_lab(_DARKEST + span * min(1.0, (100.0 - light) / 85.0), a, b)


def _to_lab(colour: Colour) -> tuple[float, float, float]:
    pixel = np.array([[colour]], dtype=np.float32) / 255.0
    light, a, b = cv2.cvtColor(pixel, cv2.COLOR_BGR2Lab)[0, 0].tolist()
    return light, a, b


def _from_lab(light: float, a: float, b: float) -> Colour:
    pixel = np.array([[[light, a, b]]], dtype=np.float32)
    bgr = np.clip(cv2.cvtColor(pixel, cv2.COLOR_Lab2BGR)[0, 0], 0.0, 1.0)
    blue, green, red = (round(float(channel) * 255.0) for channel in bgr)
    return blue, green, red

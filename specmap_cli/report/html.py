"""HTML pages that need no other file: templates filled, figures as a person reads them, a drawing.

A map is drawn in whole centimetres, y down, its lines as SVG path data. Colours are those of the
palette by day, and made of them by night.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import resources
from typing import Any

import cv2
import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from specmap_cli import __version__
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.core.text import encodable
from specmap_cli.core.text import seconds as stamp_seconds
from specmap_cli.drawing import palette
from specmap_cli.drawing.palette import Colour, darker, paler
from specmap_cli.grids.gridmap import GridMap

PACKAGE = "specmap_cli.report"
_EPOCH_S = 1e8  # stamps below this count from the start of a robot or of a simulation
_MINUTE, _HOUR = 60, 3600

# The families of features by the beginning of their columns; the first that fits counts.
_FAMILIES = (
    ("difference_", "how much neighbouring beams differ"),
    ("gaps_over_", "leaps between neighbouring beams"),
    ("range_quantile_", "quantile of the ranges"),
    ("range_extent", "longest against shortest range"),
    ("range_", "spread of the ranges"),
    ("area_convexity", "how convex the outline is"),
    ("perimeter_convexity", "how convex the outline is"),
    ("area", "area seen"),
    ("perimeter", "length of the outline"),
    ("circularity", "how round the outline is"),
    ("compactness", "how round the outline is"),
    ("hu_", "shape of the area, Hu's moments"),
    ("no_return_share", "beams without a return"),
    ("aspect_ratio", "long or square"),
    ("centroid_distance", "distance of the walls from their middle"),
    ("second_derivative", "how bumpy the outline is"),
    ("fine_distance_", "pairs of points this far apart"),
    ("distance_", "pairs of points this far apart"),
    ("pieces", "smooth pieces of the outline"),
    ("piece_", "smooth pieces of the outline"),
    ("share_below_", "beams shorter than this"),
    ("clipped_", "ranges cut at this length"),
    ("pairs_", "pairs of wall points by distance and angle"),
    ("boundary_", "length of the walls seen"),
    ("ring_", "walls at this distance"),
    ("harmonic_", "rhythm of the ranges round the robot"),
)


def html_page(
    package: str,
    template: str,
    context: Mapping[str, Any],
    styles: Iterable[str],
    scripts: Iterable[str] = (),
    filters: Mapping[str, Callable[..., Any]] | None = None,
) -> str:
    """The text of a page of `package`; whatever it shows is escaped.

    Templates, styles and scripts are looked for in the folders of `package`, then in those of the
    report. The page runs no other script than these: it has their hash. Templates may use the
    filters of this module, and more `filters`.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, "templates") for name in (package, PACKAGE)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": True, "separators": (",", ":")}
    usual = (clock, lasting, moment, stamp, percent, figure, letter, feature_words)
    environment.filters.update({each.__name__: each for each in usual}, **(filters or {}))
    script = _joined(package, "scripts", scripts)
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    parts = {
        "script": script,
        "script_hash": f"sha256-{base64.b64encode(digest).decode('ascii')}",
        "style": _joined(package, "styles", styles),
        "version": __version__,
    }
    return encodable(environment.get_template(template).render({**context, **parts}))


def _joined(package: str, folder: str, names: Iterable[str]) -> str:
    """Files of a folder of `package`, else of the report, one after the other."""
    texts = []
    for name in names:
        own = resources.files(package) / folder / name
        file = own if own.is_file() else resources.files(PACKAGE) / folder / name
        texts.append(file.read_text(encoding="utf-8"))
    return "\n".join(texts)


def feature_words(feature: str) -> str:
    """What a feature is about; empty for one of another package."""
    return next((words for start, words in _FAMILIES if feature.startswith(start)), "")


def clock(seconds: float) -> str:
    """`7:05`, or `1:02:03`."""
    whole = round(seconds)
    hours, rest = divmod(whole, _HOUR)
    minutes, left = divmod(rest, _MINUTE)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"


def lasting(seconds: float) -> str:
    """`42 s`, `7 min`, `1 h 5 min`."""
    if seconds < 2 * _MINUTE:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / _MINUTE), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def moment(stamp_s: float | None) -> str:
    """A stamp as date and time in UTC; as seconds where it counts from no known day."""
    if stamp_s is None:
        return ""
    if stamp_s < _EPOCH_S:
        return f"{stamp_s:.1f} s"
    return datetime.fromtimestamp(stamp_s, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def stamp(stamp_ns: int) -> str:
    """A stamp in nanoseconds as `moment` says it."""
    return moment(stamp_seconds(stamp_ns))


def letter(number: int) -> str:
    """`A` for 1, `Z` for 26, `AA` for 27: the sign of a finding, where submaps have numbers."""
    rest, last = divmod(number - 1, 26)
    return (letter(rest) if rest else "") + chr(ord("A") + last)


def percent(share: float | None) -> str:
    """`93 %`."""
    return "" if share is None else f"{100.0 * share:.0f} %"


def figure(value: float | None, places: int = 2) -> str:
    """A number with some decimals; a dash where there is none. The minus is a real one."""
    return "–" if value is None else f"{value:,.{places}f}".replace("-", "−")


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

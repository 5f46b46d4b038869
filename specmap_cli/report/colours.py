"""The palette as colours of a page, by day and by night."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from specmap_cli.drawing import palette
from specmap_cli.drawing.palette import Colour, darker, paler

_DARKEST, _LIGHTEST = 12.0, 90.0  # CIELAB lightness of the paper and of the ink by night
_FILL_DROP, _FILL_CHROMA = 44.0, 0.8  # by night a region is so much darker, and less colourful
STEPS = 12  # of the colours of time
_LATE = darker(palette.LOOSE, 0.9)


@dataclass(frozen=True, slots=True)
class Tone:
    """A colour of the page by day and by night, as CSS writes it."""

    day: str
    night: str


def tones(fills: Iterable[Colour]) -> dict[str, Tone]:
    """Every colour of the map by the name of its variable; `fills` are those of its regions."""
    lines = {name: Tone(css(colour), css(_inverted(colour))) for name, colour in _lines().items()}
    grounds = {
        "paper": Tone(css(palette.PAPER), css(_inverted(palette.PAPER))),
        "shade": Tone(css(palette.SHADE), css(_lit(palette.SHADE, 24.0))),
    }
    regions = {
        name: Tone(css(fill), css(_dimmed(fill))) for fill, name in fill_names(fills).items()
    }
    return grounds | lines | regions


def fill_names(fills: Iterable[Colour]) -> dict[Colour, str]:
    """The name of the variable of each colour of a region."""
    return {fill: f"fill-{number}" for number, fill in enumerate(sorted(set(fills)))}


def css(colour: Colour) -> str:
    """A colour as CSS writes it."""
    blue, green, red = colour
    return f"#{red:02x}{green:02x}{blue:02x}"


def _lines() -> Mapping[str, Colour]:
    """What is drawn and written upon the ground."""
    return {
        "ink": palette.INK,
        "quiet": darker(palette.QUIET, 0.8),
        "hair": paler(palette.QUIET, 0.7),
        "way": palette.TRAVERSED,
        "closure": palette.CLOSURE,
        "wrong": palette.WRONG,
        "loose": darker(palette.LOOSE, 0.85),
        "door": palette.DOOR,
        **{f"time-{k}": colour for k, colour in enumerate(_time())},
        **{f"fit-{k}": colour for k, colour in enumerate(_fit())},
    }


def _time() -> list[Colour]:
    """From early to late: ever lighter, so that it reads without telling hues apart."""
    return _blend((palette.INK, palette.CLOSURE, _LATE), STEPS)


def _fit() -> list[Colour]:
    """From scans that do not fit the walls to those that do."""
    return _blend((palette.WRONG, _LATE, darker(palette.QUIET, 0.8)), 5)


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


def _dimmed(fill: Colour) -> Colour:
    """A fill for a dark page."""
    light, a, b = _to_lab(fill)
    return _from_lab(light - _FILL_DROP, a * _FILL_CHROMA, b * _FILL_CHROMA)


def _lit(colour: Colour, light: float) -> Colour:
    _, a, b = _to_lab(colour)
    return _from_lab(light, a, b)


def _to_lab(colour: Colour) -> tuple[float, float, float]:
    pixel = np.array([[colour]], dtype=np.float32) / 255.0
    light, a, b = cv2.cvtColor(pixel, cv2.COLOR_BGR2Lab)[0, 0].tolist()
    return light, a, b


def _from_lab(light: float, a: float, b: float) -> Colour:
    pixel = np.array([[[light, a, b]]], dtype=np.float32)
    bgr = np.clip(cv2.cvtColor(pixel, cv2.COLOR_Lab2BGR)[0, 0], 0.0, 1.0)
    blue, green, red = (round(float(channel) * 255.0) for channel in bgr)
    return blue, green, red

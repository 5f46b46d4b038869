"""Drawing on a picture, in pixels: smooth lines, discs and text."""

from __future__ import annotations

import itertools
import math
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing.palette import INK, PAPER, Colour

Image = NDArray[np.uint8]
Anchor = Literal["left", "centre", "right"]

_BITS = 4
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class Canvas:
    """A BGR picture (H, W, 3) and a pen; y runs down, positions may have fractions of a pixel."""

    def __init__(self, width: int, height: int, colour: Colour = PAPER) -> None:
        self.image: Image = np.full((height, width, 3), colour, dtype=np.uint8)

    def line(self, points: NDArray[Any], colour: Colour, width: int = 1) -> None:
        """A polyline through `points` (N, 2)."""
        if len(points) > 1:
            cv2.polylines(self.image, [_fixed(points)], False, colour, width, cv2.LINE_AA, _BITS)

    def dashes(
        self, points: NDArray[Any], colour: Colour, width: int, dash: float, gap: float
    ) -> None:
        """A polyline broken into dashes; a dash of no length is a dot."""
        for start, end in _pieces(np.asarray(points, dtype=np.float64), dash, gap):
            if dash > 0:
                self.line(np.array([start, end]), colour, width)
            else:
                self.disc(start, width * 0.75, colour)

    def disc(
        self, centre: NDArray[Any], radius: float, colour: Colour, rim: Colour | None = None
    ) -> None:
        """A filled disc, with a rim of two pixels when a colour is given for it."""
        (x, y), one = _fixed(np.asarray(centre)).tolist(), 1 << _BITS
        if rim is not None:
            cv2.circle(self.image, (x, y), round((radius + 2) * one), rim, -1, cv2.LINE_AA, _BITS)
        cv2.circle(self.image, (x, y), round(radius * one), colour, -1, cv2.LINE_AA, _BITS)

    def box(self, corner: NDArray[Any], other: NDArray[Any], colour: Colour) -> None:
        """A filled rectangle between two corners."""
        (x0, y0), (x1, y1) = np.round(corner).astype(int), np.round(other).astype(int)
        cv2.rectangle(self.image, (int(x0), int(y0)), (int(x1), int(y1)), colour, -1)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        height: float,
        colour: Colour = INK,
        anchor: Anchor = "left",
        bold: bool = False,
    ) -> None:
        """Words of capitals `height` pixels high, centred on `y`."""
        thickness = text_weight(height, bold)
        shift = {"left": 0.0, "centre": 0.5, "right": 1.0}[anchor] * text_width(words, height, bold)
        place = (round(x - shift), round(y + height / 2))
        cv2.putText(
            self.image, words, place, _FONT, _text_scale(height), colour, thickness, cv2.LINE_AA
        )

    def upright_text(self, x: float, y: float, words: str, height: float) -> None:
        """Words that read upwards, centred on `x`, their first letter at `y`."""
        strip = Canvas(text_width(words, height) + 4, round(2.4 * height))
        strip.text(2, strip.image.shape[0] / 2, words, height)
        turned = np.rot90(strip.image)
        top, left = round(y) - turned.shape[0], round(x - turned.shape[1] / 2)
        window = self.image[max(0, top) : round(y), max(0, left) : left + turned.shape[1]]
        np.minimum(window, turned[-window.shape[0] :, -window.shape[1] :], out=window)


def text_width(words: str, height: float, bold: bool = False) -> int:
    """Pixels that `words` take across."""
    size, _ = cv2.getTextSize(words, _FONT, _text_scale(height), text_weight(height, bold))
    return int(size[0])


def text_weight(height: float, bold: bool) -> int:
    """Stroke width for letters of that height."""
    return max(2, round(height / 7.0)) if bold else max(1, round(height / 12.0))


def _text_scale(height: float) -> float:
    return height / 21.0  # capitals of this font are 21 pixels high at scale one


def _fixed(points: NDArray[Any]) -> NDArray[np.int32]:
    """Pixel positions in the fixed-point numbers of OpenCV, inside what it can take."""
    scaled = np.round(np.asarray(points, dtype=np.float64) * (1 << _BITS))
    return np.clip(scaled, -(2**26), 2**26).astype(np.int32)


def _pieces(points: FloatArray, dash: float, gap: float) -> list[tuple[FloatArray, FloatArray]]:
    """Start and end of each dash along a polyline; dashes do not turn corners."""
    pieces = []
    for start, end in itertools.pairwise(points):
        length = float(np.linalg.norm(end - start))
        if length == 0.0:
            continue
        for i in range(math.ceil(length / (dash + gap))):
            first = i * (dash + gap) / length
            last = min(1.0, first + dash / length)
            pieces.append((start + first * (end - start), start + last * (end - start)))
    return pieces

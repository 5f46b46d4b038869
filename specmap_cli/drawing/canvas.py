"""Drawing on a picture, in pixels: smooth lines, discs and text."""

from __future__ import annotations

import itertools
import math
import re
import unicodedata
from functools import cache
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing.palette import INK, PAPER, Colour

Image = NDArray[np.uint8]
Alignment = Literal["left", "centre", "right"]

_BITS = 4  # after the binary point of OpenCV's positions: a sixteenth of a pixel
_FARTHEST = 2**26  # in such steps; OpenCV's own sums overflow beyond
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_CAPITALS = 21.0  # height of this font's capitals at scale one, pixels
_RIM = 2  # pixels
_STRUCK_ZERO = hasattr(cv2, "FontFace")  # the font of OpenCV 5, not that of OpenCV 4
# The outline of a zero: a curve between an ellipse and a rectangle. Drawn this much larger, then
# made smaller, it is smooth.
_ANGLES = np.linspace(0.0, 2.0 * math.pi, 64, endpoint=False)
_WAY_ROUND = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_ROUND = np.sign(_WAY_ROUND) * np.abs(_WAY_ROUND) ** 0.75
_FINE = 8
# Kinds of characters by the names of Unicode: of both directions, numbers, what stands in numbers.
_KINDS = {"L": "L", "R": "R", "AL": "R", "EN": "N", "AN": "N", "CS": ",", "ES": ","}
_MIRRORED = str.maketrans("()[]{}<>", ")(][}{><")


class Canvas:
    """A BGR picture (H, W, 3) and a pen; y runs down, positions may have fractions of a pixel."""

    def __init__(self, width: int, height: int, colour: Colour = PAPER) -> None:
        self.image: Image = np.full((height, width, 3), colour, dtype=np.uint8)

    @classmethod
    def over(cls, image: Image) -> Canvas:
        """A canvas that draws on a picture which is there."""
        canvas = cls(0, 0)
        canvas.image = image
        return canvas

    def line(self, points: NDArray[Any], colour: Colour, width: int = 1) -> None:
        """A polyline through `points` (N, 2)."""
        if len(points) > 1:
            cv2.polylines(self.image, [_fixed(points)], False, colour, width, cv2.LINE_AA, _BITS)

    def dashes(
        self, points: NDArray[Any], colour: Colour, width: int, dash: float, gap: float
    ) -> None:
        """A polyline broken into dashes, anew at each corner; a dash of no length is a dot."""
        for start, end in itertools.pairwise(np.asarray(points, dtype=np.float64)):
            length = float(np.linalg.norm(end - start))
            if length == 0.0:
                continue
            for i in range(math.ceil(length / (dash + gap))):
                first = i * (dash + gap) / length
                last = min(1.0, first + dash / length)
                begin = start + first * (end - start)
                if dash > 0:
                    self.line(np.array([begin, start + last * (end - start)]), colour, width)
                else:
                    self.disc(begin, width * 0.75, colour)

    def disc(
        self, centre: NDArray[Any], radius: float, colour: Colour, rim: Colour | None = None
    ) -> None:
        """A filled disc, with a rim of two pixels when a colour is given for that."""
        (x, y), one = _fixed(np.asarray(centre)).tolist(), 1 << _BITS
        if rim is not None:
            cv2.circle(
                self.image, (x, y), round((radius + _RIM) * one), rim, -1, cv2.LINE_AA, _BITS
            )
        cv2.circle(self.image, (x, y), round(radius * one), colour, -1, cv2.LINE_AA, _BITS)

    def box(self, corner: NDArray[Any], other: NDArray[Any], colour: Colour) -> None:
        """A filled rectangle between two corners."""
        start, end = ((_near(x), _near(y)) for x, y in (corner, other))
        cv2.rectangle(self.image, start, end, colour, -1)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        height: float,
        colour: Colour = INK,
        align: Alignment = "left",
        bold: bool = False,
    ) -> None:
        """Words of capitals `height` pixels high, centred on `y`."""
        words = in_visual_order(words)
        shift = {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * text_width(words, height, bold)
        left, base = _near(x - shift), _near(y + height / 2)
        scale, thickness = height / _CAPITALS, text_weight(height, bold)
        begun = ""
        for piece in filter(None, re.split("(0)", words) if _STRUCK_ZERO else [words]):
            begun += piece
            ahead = text_width(begun, height, bold) - text_width(piece, height, bold)
            place = left + ahead, base
            if piece != "0":
                cv2.putText(self.image, piece, place, _FONT, scale, colour, thickness, cv2.LINE_AA)
                continue
            cover = _zero(height, thickness)
            rows, own_rows = _overlap(base - cover.shape[0], cover.shape[0], self.image.shape[0])
            columns, own_columns = _overlap(place[0], cover.shape[1], self.image.shape[1])
            share = cover[own_rows, own_columns, None]
            window = self.image[rows, columns]
            window[:] = np.round(window * (1.0 - share) + np.array(colour) * share).astype(np.uint8)

    def upright_text(self, x: float, y: float, words: str, height: float) -> None:
        """Words that read upwards, centred on `x`, their first letter at `y`."""
        # room for what reaches above and below the capitals
        strip = Canvas(text_width(words, height) + 4, round(2.4 * height))
        strip.text(2, strip.image.shape[0] / 2, words, height)
        turned = np.rot90(strip.image)
        top, left = _near(y) - turned.shape[0], _near(x - turned.shape[1] / 2)
        rows, own_rows = _overlap(top, turned.shape[0], self.image.shape[0])
        columns, own_columns = _overlap(left, turned.shape[1], self.image.shape[1])
        window = self.image[rows, columns]
        np.minimum(window, turned[own_rows, own_columns], out=window)


def in_visual_order(words: str) -> str:
    """Words as they stand on a line from its left end to its right, which OpenCV does not see to.

    By the rules of Unicode for a line without marks of direction: what is written from right to
    left is turned round, numbers and Latin words in it are not. Marks stay behind their letters.

    >>> in_visual_order("lab \u05d0\u05d1 12") == "lab 12 \u05d1\u05d0"
    True
    """
    letters: list[str] = []
    for letter in words:
        if letters and unicodedata.bidirectional(letter) == "NSM":
            letters[-1] += letter
        else:
            letters.append(letter)
    kinds = "".join(_KINDS.get(unicodedata.bidirectional(letter[0]), " ") for letter in letters)
    if "R" not in kinds:
        return words
    line = kinds.replace("N", "").replace(",", "").strip()[0]  # the direction of the whole
    kinds = re.sub("(?<=N),(?=N)", "N", kinds).replace(",", " ")
    # numbers behind Latin words go with them, those in the other script keep their own order
    kinds = re.sub("(?<=L)[ N]*N", lambda it: it[0].replace("N", "L"), f"{line}{kinds}{line}")
    # what stands between two of one direction has it, too, and else that of the line
    for at in re.finditer(" +", kinds):
        before, after = (kinds[k].replace("N", "R") for k in (at.start() - 1, at.end()))
        own = before if before == after else line
        kinds = kinds[: at.start()] + own * len(at[0]) + kinds[at.end() :]
    levels = [1 if kind == "R" else 2 * (kind == "N" or line == "R") for kind in kinds[1:-1]]
    for place, level in enumerate(levels):
        if level == 1:
            letters[place] = letters[place].translate(_MIRRORED)
    for least in (2, 1):
        high = "".join("x" if level >= least else " " for level in levels)
        for run in re.finditer("x+", high):
            span = slice(run.start(), run.end())
            letters[span], levels[span] = letters[span][::-1], levels[span][::-1]
    return "".join(letters)


@cache
def _zero(height: float, thickness: int) -> FloatArray:
    """How far each pixel (H, W) is covered by a zero on the last row; OpenCV 5's has a stroke."""
    scale = height / _CAPITALS
    (width, _), _ = cv2.getTextSize("0", _FONT, scale, thickness)
    # the width of an upright stroke of the font
    (wide, tall), _ = cv2.getTextSize("I", _FONT, scale, thickness)
    strip = np.zeros((3 * tall, wide + 2 * tall), dtype=np.uint8)
    cv2.putText(strip, "I", (tall, 2 * tall), _FONT, scale, (255.0,), thickness, cv2.LINE_AA)
    stem = float(strip[round(1.5 * tall)].sum() / 255.0)
    rows, inset = math.ceil(height), stem * 0.5
    cover = np.zeros((_FINE * rows, _FINE * (width + 1)), dtype=np.float32)
    centre = np.array([width / 2.0, rows - height / 2.0])
    outer = np.array([width / 2.0 - inset, height / 2.0])
    rings = [
        np.round(_FINE * (centre + half * _ROUND)).astype(int) for half in (outer, outer - stem)
    ]
    cv2.fillPoly(cover, rings, 1.0)
    small = cv2.resize(cover, (width + 1, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float64)


def text_width(words: str, height: float, bold: bool = False) -> int:
    """Pixels that `words` take across."""
    size, _ = cv2.getTextSize(words, _FONT, height / _CAPITALS, text_weight(height, bold))
    return int(size[0])


def fitting_height(words: str, height: float, width: float, bold: bool = False) -> float:
    """The largest height, `height` at the most, at which words are no wider than `width`."""
    while height > 1.0 and text_width(words, height, bold) > width:
        height *= 0.97
    return height


def text_weight(height: float, bold: bool) -> int:
    """Stroke width for letters of that height: a twelfth of it, or a seventh."""
    return max(2, round(height / 7.0)) if bold else max(1, round(height / 12.0))


def _overlap(start: int, length: int, size: int) -> tuple[slice, slice]:
    """What of start..start + length lies in 0..size: as a part of the size, and of the length."""
    first, end = min(max(start, 0), size), min(max(start + length, 0), size)
    return slice(first, end), slice(first - start, end - start)


def _fixed(points: NDArray[Any]) -> NDArray[np.int32]:
    """Pixel positions (N, 2) in the fixed-point numbers of OpenCV, inside what it can take."""
    scaled = np.round(np.asarray(points, dtype=np.float64) * (1 << _BITS))
    return np.clip(scaled, -_FARTHEST, _FARTHEST).astype(np.int32)


def _near(place: float) -> int:
    """The pixel nearest to a place, inside what OpenCV can take."""
    farthest = _FARTHEST >> _BITS
    return round(min(max(float(place), -farthest), farthest))

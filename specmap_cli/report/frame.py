"""The drawing of a map in a page: whole centimetres, y down, and lines as SVG path data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray

_CM = 100.0
_MARGIN_M = 0.5  # of paper round what is known


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
        return cls(float(left), float(top), _cm(right - left), _cm(top - low))

    def places(self, points: FloatArray) -> IntArray:
        """(N, 2) points of the map in the drawing."""
        corner = np.array([self.left, self.top])
        moved = (np.asarray(points, dtype=np.float64).reshape(-1, 2) - corner) * (_CM, -_CM)
        return np.asarray(np.rint(moved), dtype=np.int64)

    def place(self, point: Iterable[float]) -> tuple[int, int]:
        """One point of the map in the drawing."""
        ((x, y),) = self.places(np.array([*point])).tolist()
        return x, y


def _cm(length_m: float) -> int:
    return round(float(length_m) * _CM)


def path_data(lines: Iterable[IntArray], *, closed: bool = False) -> str:
    """The data of an SVG path for polylines (n, 2) in the drawing: the first point, then steps."""
    parts = []
    for line in lines:
        if len(line) < 2:
            continue
        (x, y), *_ = line.tolist()
        steps = np.diff(line, axis=0)
        moved = steps[(steps != 0).any(axis=1)]
        parts.append(f"M{x} {y}l{_joined(moved)}" if len(moved) else f"M{x} {y}h0")
        if closed:
            parts.append("z")
    return "".join(parts)


def _joined(steps: IntArray) -> str:
    """Numbers in a row; a minus sign parts them as well as a space does."""
    return " ".join(map(str, steps.reshape(-1).tolist())).replace(" -", "-")

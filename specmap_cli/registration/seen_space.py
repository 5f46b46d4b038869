"""The space that the keyframes of the local map have looked at.

A wall of a new sweep that lies elsewhere is new. It says nothing against the place of the sweep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan

_MOST_BEAMS = 360  # of an outline: a degree each, 0.2 m apart at 12 m


@dataclass(frozen=True, slots=True)
class SeenSpace:
    """`cells` (H, W), not 0 where a keyframe looked; `origin` (x, y) is the lower left corner."""

    cells: NDArray[np.uint8]
    cell_m: float
    origin: tuple[float, float]

    @classmethod
    def of(cls, outlines: Sequence[FloatArray], cell_m: float, side_m: float) -> SeenSpace:
        """The space inside of outlines (N, 2), in one frame, and a cell around it.

        It ends `side_m` to each side of the first outline's first point, a laser.
        """
        low = outlines[0][0] - side_m
        side = math.ceil(2 * side_m / cell_m)
        cells = np.zeros((side, side), dtype=np.uint8)
        for outline in outlines:
            corners = np.floor((outline - low) / cell_m).astype(np.int32)
            cv2.fillPoly(cells, [corners], 1)
        grown = cv2.dilate(cells, np.ones((3, 3), dtype=np.uint8))
        return cls(np.asarray(grown, dtype=np.uint8), cell_m, (float(low[0]), float(low[1])))

    def holds(self, points: FloatArray) -> NDArray[Any]:
        """(N,) whether each of points (N, 2) lies where a keyframe looked."""
        columns, rows = np.floor((points - np.asarray(self.origin)) / self.cell_m).T
        height, width = self.cells.shape
        inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        seen = np.zeros(len(points), dtype=bool)
        seen[inside] = self.cells[rows[inside].astype(np.intp), columns[inside].astype(np.intp)] > 0
        return seen


def outline_of(scan: PlanarScan, base_from_laser: Pose2, reach_m: float) -> FloatArray:
    """Corners (N, 2), base frame, of the space that a scan looked through, the laser first.

    A beam without a return says nothing about the space along it: it ends at the laser.
    """
    stride = max(1, math.ceil(len(scan.ranges) / _MOST_BEAMS))
    ranges, bearings = scan.ranges[::stride], scan.bearings[::stride]
    r = np.where(np.isfinite(ranges), np.minimum(ranges, reach_m), 0.0)
    ends = np.column_stack([r * np.cos(bearings), r * np.sin(bearings)])
    laser = np.zeros((1, 2))
    return base_from_laser.apply(
        np.concatenate([laser, ends, ends[:1] if scan.full_circle else laser])
    )

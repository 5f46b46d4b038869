"""The side of a wall that a scan shows: two rooms see the wall between them from either side.

Matched with each other the two sides would lie on one another. The rooms would come nearer by the
thickness of the wall, and nearly all of it would fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import BoolArray

_NEIGHBOURS = 2  # points on either side, from which the direction of a surface is had
_SURFACE_M = 0.5  # such neighbours farther from each other lie on two surfaces
_DISTINCT_M = 1e-6  # nearer ones have no direction
_THICK_M = 0.3  # walls between rooms are no thicker
_CELL_M = 0.1  # of the grid in which sides are added up
_OTHER_SIDE = -0.5  # mean cosine of two facings: above it may be a wall around the corner
_UNIT = 64.0  # normals are whole numbers of its parts: their sums come out the same in any order


@dataclass(frozen=True, slots=True)
class Sides:
    """Wall points (N, 2) and the unit normals (N, 2) of their surfaces, to where they are seen.

    A normal is nought where no surface is known: a post, the end of a wall.
    """

    points: FloatArray
    normals: FloatArray

    @classmethod
    def of(cls, points: FloatArray, viewer: tuple[float, float]) -> Sides:
        """The sides of points (N, 2), in order of bearing, that are seen from one place."""
        normals, reach = np.zeros((len(points), 2)), _NEIGHBOURS
        along = points[2 * reach :] - points[: -2 * reach]
        length = np.hypot(along[:, 0], along[:, 1])
        known = (length > _DISTINCT_M) & (length < _SURFACE_M)
        rows = np.flatnonzero(known) + reach
        across = np.column_stack([-along[:, 1], along[:, 0]])[known] / length[known, None]
        to_viewer = viewer - points[rows]
        outwards = (across * to_viewer).sum(axis=1) < 0.0
        normals[rows] = np.where(outwards[:, None], -across, across)
        return cls(points, normals)

    def placed(self, pose: Pose2) -> Sides:
        """The same in the frame in which theirs lies at a pose."""
        turn = Pose2(0.0, 0.0, pose.theta)
        return Sides(pose.apply(self.points), turn.apply(self.normals))

    @classmethod
    def joined(cls, parts: Sequence[Sides]) -> Sides:
        """All of them, in one frame, in their order."""
        points, normals = ([getattr(part, name) for part in parts] for name in cls.__slots__)
        return cls(np.concatenate(points), np.concatenate(normals))


def from_behind(source: Sides, target: Sides, guess: Pose2, drift_m: float) -> BoolArray:
    """(N,) whether the target shows the wall under a point of the source from its other side only.

    `guess` is `target_from_source`; `drift_m` bounds how wrong it may be: sides are compared that
    far around, and the thickness of a wall. Where walls face each other within that, nothing is
    said.
    """
    cells = np.floor(target.points / _CELL_M).astype(np.int64)
    if not len(cells):
        return np.zeros(len(source.points), dtype=bool)
    reach = math.ceil((drift_m + _THICK_M) / _CELL_M)
    low = cells.min(axis=0) - reach
    around = _around(cells - low, np.round(_UNIT * target.normals), reach)
    placed = source.placed(guess)
    at = np.floor(placed.points / _CELL_M).astype(np.int64) - low
    height, width = around.shape[1:]
    inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    x, y, known = around[:, at[inside, 1], at[inside, 0]]
    behind = np.zeros(len(at), dtype=bool)
    along = placed.normals[inside]
    behind[inside] = along[:, 0] * x + along[:, 1] * y < _OTHER_SIDE * known
    return behind


def _around(cells: NDArray[np.int64], normals: FloatArray, reach: int) -> FloatArray:
    """(3, H, W) sums of normals in x and y, and of their lengths, over squares around each cell.

    Of points in cells (N, 2), columns and rows no less than `reach`, with normals (N, 2).
    """
    width, height = (cells.max(axis=0) + reach + 1).tolist()
    flat = cells[:, 1] * width + cells[:, 0]
    lengths = np.where(normals.any(axis=1), _UNIT, 0.0)
    return np.stack(
        [
            cv2.boxFilter(
                np.bincount(flat, weights, width * height).reshape(height, width),
                ddepth=-1,
                ksize=(2 * reach + 1, 2 * reach + 1),
                normalize=False,
                borderType=cv2.BORDER_CONSTANT,
            )
            for weights in (normals[:, 0], normals[:, 1], lengths)
        ]
    )

"""Where a robot can stand in a map: space that its laser has seen free."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.layout.walls import Walls

_MARGIN_M = 0.6  # beyond what was seen: a robot's width, and what the poses there are off
_FEWEST = 3  # corners of an area


def seen_free(
    walls: Walls, nodes: Sequence[int], poses: FloatArray, field: ScoreField
) -> BoolArray:
    """(H, W) which cells of a field lie in what was seen from rows `nodes`, at poses (M, 3).

    What a scan saw is the area between the robot and its returns, joined in their order.
    """
    seen = np.zeros(field.values.shape, dtype=np.uint8)
    for node in nodes:
        corners = np.concatenate([np.zeros((1, 2)), walls.points(node)])
        if len(corners) >= _FEWEST:
            cv2.fillPoly(seen, [_cells(Pose2(*poses[node].tolist()).apply(corners), field)], 1)
    reach = max(1, round(_MARGIN_M / field.resolution))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    return np.asarray(cv2.dilate(seen, kernel) > 0)


def _cells(points: FloatArray, field: ScoreField) -> NDArray[np.int32]:
    """(N, 2) columns and rows of points (N, 2), those far outside brought to the border."""
    cells = np.floor((points - np.asarray(field.origin)) / field.resolution)
    height, width = field.values.shape
    near = np.clip(cells, (-width, -height), (2 * width, 2 * height))
    return np.asarray(near, dtype=np.int32)

"""What can be seen in a picture: pixels of a colour, where the ink is, and small maps to draw."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import Pose2
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.palette import PAPER, Colour
from specmap_cli.grids.gridmap import FREE, OCCUPIED, BoolArray, GridMap
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import Submap, TopologicalMap


def of_colour(image: Image, colour: Colour, within: int = 3) -> BoolArray:
    """(H, W) the pixels of about that colour."""
    low = np.maximum(np.array(colour) - within, 0)
    high = np.minimum(np.array(colour) + within, 255)
    return np.asarray(cv2.inRange(image, low, high) > 0, dtype=np.bool_)


def near(image: Image, colour: Colour) -> int:
    return int(of_colour(image, colour).sum())


def colours_in(image: NDArray[Any]) -> int:
    blue, green, red = (image[..., channel].astype(np.int32) for channel in range(3))
    return len(np.unique(blue << 16 | green << 8 | red))


def inked(image: Image, paper: Colour = PAPER) -> BoolArray:
    """(H, W) the pixels that anything was drawn on."""
    return np.asarray((image != np.array(paper, dtype=np.uint8)).any(axis=-1))


def bounds(pixels: BoolArray) -> tuple[int, int, int, int]:
    """First and last column, first and last row of the pixels; there must be one."""
    rows, columns = np.nonzero(pixels)
    return int(columns.min()), int(columns.max()), int(rows.min()), int(rows.max())


def pixel(image: Image, place: NDArray[Any]) -> Colour:
    x, y = np.round(np.asarray(place)).astype(int).tolist()
    blue, green, red = image[y, x].tolist()
    return blue, green, red


def is_framed(image: Image) -> bool:
    """Whether nothing reaches the border of the picture, where it would be cut off."""
    ink = inked(image)
    return not (ink[0].any() or ink[-1].any() or ink[:, 0].any() or ink[:, -1].any())


def one_room(shape: tuple[int, int]) -> tuple[TopologicalMap, Regions]:
    """Submap 0: a room of free cells of 5 cm within walls one cell thick."""
    cells = np.full(shape, OCCUPIED, dtype=np.uint8)
    cells[1:-1, 1:-1] = FREE
    grid = GridMap(cells, 0.05)
    only = Submap(id=0, map_from_submap=Pose2(0.0, 0.0, 0.0), grid=grid)
    return TopologicalMap(submaps={0: only}), Regions.of(grid, np.where(cells == FREE, 0, NOBODY))

"""What can be seen in a picture, how eyes see its colours, and small maps to draw."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
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


# Linear RGB as seen without one kind of cones: Machado, Oliveira and Fernandes (2009), severity 1.
EYES: dict[str, FloatArray] = {
    kind: np.array(numbers.split(), dtype=np.float64).reshape(3, 3)
    for kind, numbers in {
        "usual": "1 0 0  0 1 0  0 0 1",
        "protanopia": "0.152286 1.052583 -0.204868  0.114503 0.786281 0.099216 "
        "-0.003882 -0.048116 1.051998",
        "deuteranopia": "0.367322 0.860646 -0.227968  0.280085 0.672501 0.047413 "
        "-0.011820 0.042940 0.968881",
        "tritanopia": "1.255528 -0.076749 -0.178779  -0.078411 0.930809 0.147602 "
        "0.004733 0.691367 0.303900",
    }.items()
}
_XYZ_FROM_RGB = np.array([
    (0.4124564, 0.3575761, 0.1804375),
    (0.2126729, 0.7151522, 0.0721750),
    (0.0193339, 0.1191920, 0.9503041),
])  # fmt: skip
_WHITE = np.array([0.95047, 1.0, 1.08883])


def linear_rgb(colours: Sequence[Colour]) -> FloatArray:
    """(n, 3) red, green and blue light of colours (blue, green, red)."""
    rgb = np.array(colours, dtype=np.float64)[:, ::-1] / 255.0
    return np.asarray(np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4))


def contrast(one: Colour, other: Colour) -> float:
    """Contrast ratio by WCAG 2: 4.5 is asked of text, 3 of lines and symbols."""
    low, high = sorted((linear_rgb([one, other]) @ _XYZ_FROM_RGB[1]).tolist())
    return float((high + 0.05) / (low + 0.05))


def seen_lab(colours: Sequence[Colour], eyes: str) -> FloatArray:
    """(n, 3) CIELAB of colours (blue, green, red) as those eyes see them."""
    seen = np.clip(linear_rgb(colours) @ EYES[eyes].T, 0.0, 1.0) @ _XYZ_FROM_RGB.T / _WHITE
    x, y, z = np.where(seen > 216 / 24389, np.cbrt(seen), (24389 / 27 * seen + 16) / 116).T
    return np.column_stack([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def ciede2000(one: FloatArray, other: FloatArray) -> float:
    """The difference of two colours (3,) in CIELAB; 1 can just be seen."""
    (l1, a1, b1), (l2, a2, b2) = one.tolist(), other.tolist()
    middle = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    stretch = 1 + 0.5 * (1 - np.sqrt(middle**7 / (middle**7 + 25.0**7)))
    c1, c2 = np.hypot(a1 * stretch, b1), np.hypot(a2 * stretch, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a * stretch)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = 0.0 if c1 * c2 == 0 else (h2 - h1 + 180) % 360 - 180
    hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)
    mean_hue = h1 + h2 if c1 * c2 == 0 else h1 + turn / 2
    light, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    t = 1 + sum(
        weight * np.cos(np.radians(times * mean_hue + shift))
        for weight, times, shift in ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.2, 4, -63))
    )
    s_light = 1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2)
    s_chroma, s_hue = 1 + 0.045 * chroma, 1 + 0.015 * chroma * t
    bend = 60 * np.exp(-((((mean_hue % 360) - 275) / 25) ** 2))
    twist = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(bend))
    dl, dc, dh = (l2 - l1) / s_light, (c2 - c1) / s_chroma, hue / s_hue
    return float(np.sqrt(dl**2 + dc**2 + dh**2 + twist * dc * dh))


def least_difference(one: Colour, other: Colour) -> float:
    """How far two colours are apart for the eyes that see them nearest (CIEDE2000)."""
    return min(ciede2000(*seen_lab([one, other], eyes)) for eyes in EYES)

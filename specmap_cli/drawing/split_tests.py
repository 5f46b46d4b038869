"""Images of what the segmentation looked at, like Figures 1 and 3 of the paper."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.text import counted
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.palette import Colour, paler
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.segmentation.division import Segmentation
from specmap_cli.segmentation.splitting import SplitTest

_SIDE = 480  # pixels of the longer side of the map of a test
_LARGE_SIDE = 900  # and of a divided map
_FRAME_M = 0.5  # shown round the free cells of a divided map
_BARS = (480, 150)  # width and height of a spectrum
_EDGE, _CAPTION, _FLOOR = 8, 32, 12  # of paper beside, above and below its bars
_WHITE, _GREY, _BLACK = (255, 255, 255), (215, 215, 215), (40, 40, 40)
_AHEAD, _LEFT = (60, 110, 235), (200, 120, 30)  # BGR: the robot's side, the side it left
_ALIKE, _APART = (225, 225, 225), (140, 140, 230)  # sight lines inside a region, between two
_PALEST = 0.25  # weight of the colour of a node where the eigenvector is zero: it must be seen
_SHOWN = 12  # eigenvalues drawn
_GOLDEN = 0.618034  # steps of the golden section never come near each other on a circle


def draw_test(test: SplitTest, threshold: float, split: bool) -> Image:
    """One test: the map with its nodes shaded by the chosen eigenvector, the way, the spectrum.

    (H, W, 3) BGR. Nodes on the robot's side are orange, the others blue, and the fainter the closer
    the eigenvector is to zero there.
    """
    picture, scale = _map_picture(test.grid, _SIDE)
    if len(test.nodes):
        strength = np.abs(test.eigenvector) / max(float(np.abs(test.eigenvector).max()), 1e-12)
        for spot, near, weight in zip(
            _pixels(test.grid, test.nodes, scale), test.near, strength, strict=True
        ):
            pale = (1.0 - _PALEST) * (1.0 - float(weight))
            colour = paler(_AHEAD if near else _LEFT, pale)
            cv2.circle(picture, spot, 4, colour, cv2.FILLED, cv2.LINE_AA)
    way = np.array(_pixels(test.grid, test.poses[:, :2], scale), dtype=np.int32)
    cv2.polylines(picture, [way], False, _BLACK, 1, cv2.LINE_AA)
    cv2.circle(picture, tuple(way[-1].tolist()), 5, _BLACK, cv2.FILLED, cv2.LINE_AA)
    word = "split" if split else "one region"
    caption = f"eigenvalue {test.chosen + 1}: {test.eigenvalue:.3f}  {word}"
    return _stacked(picture, _spectrum(test.eigenvalues, threshold, test.chosen, caption))


def draw_segmentation(grid: GridMap, found: Segmentation, threshold: float) -> Image:
    """A divided map: nodes and sight lines in the colours of the regions, and the spectrum."""
    grid = _cropped(grid)
    picture, scale = _map_picture(grid, _LARGE_SIDE)
    spots = _pixels(grid, found.nodes, scale)
    _draw_sight_lines(picture, spots, found)
    for spot, label in zip(spots, found.node_labels.tolist(), strict=True):
        cv2.circle(picture, spot, 3, _hue(label), cv2.FILLED, cv2.LINE_AA)
    used = found.spectrum.used
    words = f"{counted(used, 'eigenvalue')} above {threshold:g}"
    caption = f"{words}, {counted(found.count, 'region')}"
    values = found.spectrum.eigenvalues
    return _stacked(picture, _spectrum(values[: used + _SHOWN], threshold, 0, caption))


def _draw_sight_lines(picture: Image, spots: list[tuple[int, int]], found: Segmentation) -> None:
    """The shorter half of the pairs of nodes that see each other: all would hide the map."""
    if not len(found.pairs):
        return
    ends = np.array(spots, dtype=np.int32)[found.pairs]
    first, second = found.pairs.T
    lengths = np.hypot(*(found.nodes[first] - found.nodes[second]).T)
    alike = found.node_labels[first] == found.node_labels[second]
    for k in np.flatnonzero(lengths <= np.median(lengths)):
        start, end = ends[k].tolist()
        cv2.line(picture, start, end, _ALIKE if alike[k] else _APART, 1, cv2.LINE_AA)


def _cropped(grid: GridMap) -> GridMap:
    """The part of a map round its free cells; the whole when there are none."""
    cells = np.argwhere(grid.free)
    if not len(cells):
        return grid
    frame = round(_FRAME_M / grid.resolution)
    low = np.maximum(cells.min(axis=0) - frame, 0)
    high = cells.max(axis=0) + frame + 1
    x, y = grid.origin
    corner = (x + int(low[1]) * grid.resolution, y + int(low[0]) * grid.resolution)
    return GridMap(grid.cells[low[0] : high[0], low[1] : high[1]], grid.resolution, corner)


def _map_picture(grid: GridMap, side: int) -> tuple[Image, float]:
    """The map, free white and unknown grey, `side` pixels at its longer side; its pixels a cell."""
    shades = np.full((*grid.cells.shape, 3), _GREY, dtype=np.uint8)
    shades[grid.cells == FREE] = _WHITE
    shades[grid.cells == OCCUPIED] = _BLACK
    scale = side / max(grid.cells.shape)
    size = max(1, round(shades.shape[1] * scale)), max(1, round(shades.shape[0] * scale))
    return cv2.resize(shades[::-1], size, interpolation=cv2.INTER_NEAREST).astype(np.uint8), scale


def _pixels(grid: GridMap, points: NDArray[np.float64], scale: float) -> list[tuple[int, int]]:
    """Column and row in the picture of each point (N, 2) in metres."""
    cells = (points - grid.origin) / grid.resolution * scale
    height = grid.cells.shape[0] * scale
    return [(round(x), round(height - y)) for x, y in cells.tolist()]


def _spectrum(values: NDArray[np.float64], threshold: float, chosen: int, caption: str) -> Image:
    """Bars of the eigenvalues with the threshold across; bar `chosen` stands out."""
    width, height = _BARS
    picture = np.full((height, width, 3), 255, dtype=np.uint8)
    floor, top = height - _FLOOR, _CAPTION
    cv2.putText(
        picture, caption, (_EDGE, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _BLACK, 1, cv2.LINE_AA
    )
    pitch = (width - 2 * _EDGE) / max(len(values), _SHOWN)
    for number, value in enumerate(np.clip(values, 0.0, 1.0).tolist()):
        left, right = _EDGE + number * pitch, _EDGE + (number + 0.75) * pitch
        high = floor - value * (floor - top)
        colour = _AHEAD if chosen and number == chosen else (170, 170, 170)
        corners = (round(left), round(high)), (max(round(left), round(right)), floor)
        cv2.rectangle(picture, *corners, colour, cv2.FILLED)
    level = round(floor - threshold * (floor - top))
    cv2.line(picture, (_EDGE, level), (width - _EDGE, level), (60, 60, 200), 1)
    return picture


def _stacked(upper: Image, lower: Image) -> Image:
    """Two pictures, one above the other, on white."""
    width = max(upper.shape[1], lower.shape[1])
    padded = [
        cv2.copyMakeBorder(part, 0, 0, 0, width - part.shape[1], cv2.BORDER_CONSTANT, value=_WHITE)
        for part in (upper, lower)
    ]
    return np.vstack(padded).astype(np.uint8)


def _hue(label: int) -> Colour:
    """A colour for a label: neighbours in number are far apart on the circle of hues."""
    hue = round(label * _GOLDEN * 180) % 180  # OpenCV counts hues in two degrees
    pixel = np.array([[[hue, 190, 205]]], dtype=np.uint8)
    blue, green, red = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return blue, green, red

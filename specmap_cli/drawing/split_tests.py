"""Images of what the segmentation looked at, like Figures 1 and 3 of the paper."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import step_lengths
from specmap_cli.core.text import counted
from specmap_cli.drawing.canvas import Canvas, Image, fitting_height, text_width
from specmap_cli.drawing.palette import INK, PAPER, QUIET, paler
from specmap_cli.drawing.sheet import round_length, strokes
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.segmentation.division import Segmentation
from specmap_cli.segmentation.online import Occasion, SplitTest

_SIDE = 480  # pixels of the longer side of the map of a test
_LARGE_SIDE = 900  # and of a divided map
_FRAME_M = 0.5  # shown round the free cells of a map
_BARS = (480, 150)  # width and height of a spectrum
_EDGE, _CAPTION, _FLOOR = 8, 12, 24  # of paper beside, above and below its bars
_LEVEL = 34  # of paper at the right, for the figure of the threshold
_LETTERS, _LINE = 10.0, 22  # height of capitals, and from line to line
_SIDES = 120  # of paper at the right of the words, for what the colours mean
_SCALE_BAR = 110.0  # at the most
_BAR, _THRESHOLD = (170, 170, 170), (60, 60, 200)
_WHITE, _GREY, _BLACK = (255, 255, 255), (215, 215, 215), (40, 40, 40)
_AHEAD, _LEFT = (60, 110, 235), (200, 120, 30)  # BGR: the robot's side, the side it left
_ALIKE, _APART = (225, 225, 225), (140, 140, 230)  # sight lines inside a region, between two
_PALEST = 0.25  # weight of the colour of a node where the eigenvector is zero: it must be seen
_SHOWN = 12  # eigenvalues drawn
_GOLDEN = 0.618034  # steps of the golden section never come near each other on a circle


def draw_test(test: SplitTest, threshold: float, split: bool, occasion: Occasion) -> Image:
    """One test: the map with its nodes shaded by the chosen eigenvector, the way, the spectrum.

    Below the map stands when it was made, and what it says.

    (H, W, 3) BGR. Nodes on the robot's side are orange, the others blue, and the fainter the closer
    the eigenvector is to zero there.
    """
    grid = test.grid.cropped(test.grid.free, round(_FRAME_M / test.grid.resolution))
    picture, scale = _map_picture(grid, _SIDE)
    if len(test.nodes):
        strength = np.abs(test.eigenvector) / max(float(np.abs(test.eigenvector).max()), 1e-12)
        for spot, near, weight in zip(
            _pixels(grid, test.nodes, scale), test.near, strength, strict=True
        ):
            pale = (1.0 - _PALEST) * (1.0 - float(weight))
            colour = paler(_AHEAD if near else _LEFT, pale)
            cv2.circle(picture, spot, 4, colour, cv2.FILLED, cv2.LINE_AA)
    places = test.poses[:, :2]
    way = np.array(_pixels(grid, places, scale), dtype=np.int32)
    for stroke in strokes(places):
        cv2.polylines(picture, [way[stroke.first : stroke.end]], False, _BLACK, 1, cv2.LINE_AA)
    cv2.circle(picture, tuple(way[-1].tolist()), 5, _BLACK, cv2.FILLED, cv2.LINE_AA)
    _draw_scale(picture, scale / grid.resolution)
    if not test.chosen:
        said = "one region: no eigenvector divides the way"
    else:
        word, above = "split" if split else "one region", test.eigenvalue > threshold
        said = f"{word}: eigenvalue {test.chosen + 1} is {test.eigenvalue:.3f}, "
        said += f"{'' if above else 'not '}above {threshold:g}"
        said += ", but a side is short" if above and not split else ""
    minutes, seconds = divmod(occasion.seconds, 60.0)
    when = f"keyframe {occasion.latest}, {minutes:.0f} min {seconds:04.1f} s after the log began"
    ways = [step_lengths(places[stroke.first : stroke.end]).sum() for stroke in strokes(places)]
    of = f"submap of keyframes {occasion.first} to {occasion.latest}, {sum(ways):.1f} m driven"
    words = _words((said, when, of))
    canvas, right = Canvas.over(words), words.shape[1] - _EDGE
    for line, (what, colour) in enumerate((("with the robot", _AHEAD), ("left behind", _LEFT)), 1):
        y = _EDGE + _LINE * (line + 0.5)
        canvas.text(right, y, what, _LETTERS, QUIET, "right")
        canvas.disc(np.array([right - 10.0 - text_width(what, _LETTERS), y]), 4.0, colour)
    return _stacked(picture, words, _spectrum(test.eigenvalues, threshold, test.chosen))


def draw_segmentation(grid: GridMap, found: Segmentation, threshold: float) -> Image:
    """A divided map: nodes and sight lines in the colours of the regions, and the spectrum."""
    grid = grid.cropped(grid.free, round(_FRAME_M / grid.resolution))
    picture, scale = _map_picture(grid, _LARGE_SIDE)
    spots = _pixels(grid, found.nodes, scale)
    if len(found.pairs):  # the shorter half of the sight lines: all would hide the map
        first, second = found.pairs.T
        lengths = np.hypot(*(found.nodes[first] - found.nodes[second]).T)
        alike = found.node_labels[first] == found.node_labels[second]
        for k in np.flatnonzero(lengths <= np.median(lengths)):
            colour = _ALIKE if alike[k] else _APART
            cv2.line(picture, spots[first[k]], spots[second[k]], colour, 1, cv2.LINE_AA)
    for spot, label in zip(spots, found.node_labels.tolist(), strict=True):
        # neighbours in number are far apart on the circle of hues, counted in two degrees
        hue = round(label * _GOLDEN * 180) % 180
        pixel = np.array([[[hue, 190, 205]]], dtype=np.uint8)
        colour = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].tolist()
        cv2.circle(picture, spot, 3, colour, cv2.FILLED, cv2.LINE_AA)
    _draw_scale(picture, scale / grid.resolution)
    used = found.spectrum.used
    values = found.spectrum.eigenvalues[: used + _SHOWN]
    said = f"{counted(found.count, 'region')}: {counted(used, 'eigenvalue')} above {threshold:g}"
    sight = f"{counted(len(found.nodes), 'node')}; sight lines between regions are red"
    return _stacked(picture, _words((said, sight)), _spectrum(values, threshold, 0))


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


def _draw_scale(picture: Image, pixels_per_m: float) -> None:
    """A bar of a round length in the lower left corner."""
    length, _ = round_length(_SCALE_BAR / pixels_per_m)
    canvas, end = Canvas.over(picture), length * pixels_per_m
    words, y = f"{length:g} m", picture.shape[0] - 2.0 * _EDGE
    corner = np.array([_EDGE, y - 12.0])
    canvas.box(corner, np.array([_EDGE * 4 + end + text_width(words, _LETTERS), y + 12.0]), PAPER)
    canvas.box(np.array([2 * _EDGE, y - 2]), np.array([2 * _EDGE + end, y + 2]), INK)
    canvas.text(3 * _EDGE + end, y, words, _LETTERS)


def _words(lines: Sequence[str]) -> Image:
    """Lines of text on paper, the first one bold; they shrink to fit."""
    width = _BARS[0]
    canvas = Canvas(width, _LINE * len(lines) + 2 * _EDGE)
    for number, line in enumerate(lines):
        bold = number == 0
        room = width - 2 * _EDGE - (0 if bold else _SIDES)
        height = fitting_height(line, _LETTERS, room, bold)
        y, colour = _EDGE + _LINE * (number + 0.5), INK if bold else QUIET
        canvas.text(_EDGE, y, line, height, colour, bold=bold)
    return canvas.image


def _spectrum(values: NDArray[np.float64], threshold: float, chosen: int) -> Image:
    """Bars of the eigenvalues, numbered, with the threshold across; bar `chosen` stands out."""
    width, height = _BARS
    canvas = Canvas(width, height)
    floor, top = height - _FLOOR, _CAPTION
    pitch = (width - 2 * _EDGE - _LEVEL) / max(len(values), _SHOWN)
    every = math.ceil(2.5 * _LETTERS / pitch)
    for number, value in enumerate(np.clip(values, 0.0, 1.0).tolist()):
        left, right = _EDGE + number * pitch, _EDGE + (number + 0.75) * pitch
        high = floor - value * (floor - top)
        is_chosen = bool(chosen) and number == chosen
        colour = _AHEAD if is_chosen else _BAR
        canvas.box(np.array([left, high]), np.array([max(left, right), floor]), colour)
        if is_chosen or number % every == 0:
            middle, ink = (left + right) / 2, INK if is_chosen else QUIET
            canvas.text(middle, floor + 12, str(number + 1), 8.0, ink, "centre", bold=is_chosen)
    level = round(floor - threshold * (floor - top))
    canvas.box(np.array([_EDGE, level]), np.array([width - _EDGE - _LEVEL, level]), _THRESHOLD)
    canvas.text(width - _EDGE, level, f"{threshold:g}", 9.0, _THRESHOLD, "right")
    return canvas.image


def _stacked(*parts: Image) -> Image:
    """Pictures, one above the other, on white."""
    width = max(part.shape[1] for part in parts)
    padded = [
        cv2.copyMakeBorder(part, 0, 0, 0, width - part.shape[1], cv2.BORDER_CONSTANT, value=_WHITE)
        for part in parts
    ]
    return np.vstack(padded).astype(np.uint8)

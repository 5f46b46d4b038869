"""Pictures of what the segmentation looked at: nodes, ways, sight lines and eigenvalues."""

import cv2
import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.palette import INK
from specmap_cli.drawing.split_tests import draw_segmentation, draw_test
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.segmentation.division import Segmentation
from specmap_cli.segmentation.online import Occasion, SplitTest
from specmap_cli.segmentation.spectral import Spectrum
from tests.drawing.looking import bounds, of_colour, pixel

ORANGE, BLUE = (60, 110, 235), (200, 120, 30)  # the robot's side, the side it left
DARK = (40, 40, 40)
HEIGHT = 240  # of the map in the picture of a test: 8 m x 4 m, 480 pixels wide
SPECTRUM = 150  # pixels at the bottom
WORDS = 82  # between them: three lines
WHEN = Occasion(120, 312, 125.34)


def drawn(test: SplitTest, threshold: float = 0.6, split: bool = True) -> Image:
    return draw_test(test, threshold, split, WHEN)


def corridor() -> GridMap:
    """A corridor of 8 m x 4 m with cells of 10 cm, its lower left corner at (10, -2)."""
    cells = np.full((40, 80), FREE, dtype=np.uint8)
    cells[[0, -1]], cells[:, [0, -1]] = OCCUPIED, OCCUPIED
    cells[-5:-1, 1:5] = UNKNOWN
    return GridMap(cells, 0.1, (10.0, -2.0))


def split_test(
    eigenvector: list[float] | None = None, eigenvalues: list[float] | None = None, chosen: int = 1
) -> SplitTest:
    """A robot that drove from left to right, with nodes along the middle of the corridor."""
    vector = np.array([-1.0, 1.0] if eigenvector is None else eigenvector)
    return SplitTest(
        grid=corridor(),
        poses=np.column_stack([np.linspace(11.0, 17.0, 30), np.full(30, -1.0), np.zeros(30)]),
        nodes=np.column_stack([np.linspace(11.0, 17.0, len(vector)), np.zeros(len(vector))]),
        eigenvalues=np.array([1.0, 0.9] if eigenvalues is None else eigenvalues),
        chosen=chosen,
        eigenvector=vector,
        near=vector > 0,
        stays=np.ones(30, dtype=bool),
        reached=np.ones(30, dtype=bool),
    )


def spot(x: float, y: float) -> FloatArray:
    """Where a place of the corridor is in the picture of a test."""
    return np.array([(x - 10.0) * 60.0, HEIGHT - (y + 2.0) * 60.0])


def test_nodes_have_the_colour_of_their_side_and_fade_towards_the_border() -> None:
    image = drawn(split_test([-1.0, -0.5, 0.0, 0.5, 1.0], [1.0, 0.8]))
    assert image.shape == (HEIGHT + WORDS + SPECTRUM, 480, 3)
    seen = [pixel(image, spot(x, 0.0)) for x in (11.0, 12.5, 14.0, 15.5, 17.0)]
    assert seen[0] == pytest.approx(BLUE, abs=2)
    assert seen[4] == pytest.approx(ORANGE, abs=2)
    paleness = [sum(colour) for colour in seen]
    assert paleness[0] < paleness[1] < paleness[2] > paleness[3] > paleness[4]
    assert paleness[2] < 3 * 255


def test_the_map_is_white_grey_and_black_and_the_way_ends_in_a_dot_where_the_robot_is() -> None:
    image = drawn(split_test())
    free, unknown, wall = spot(14.0, 1.5), spot(10.3, 1.7), spot(10.05, 0.0)
    assert pixel(image, free) == (255, 255, 255)
    assert pixel(image, unknown) == (215, 215, 215)
    assert pixel(image, wall) == DARK
    for x in np.arange(11.1, 16.9, 0.2).tolist():
        column, row = spot(x, -1.0).astype(int).tolist()
        assert of_colour(image[row - 1 : row + 2, column : column + 1], DARK, 60).any()
    column, row = spot(17.0, -1.0).astype(int).tolist()
    assert of_colour(image[row - 10 : row + 11, column + 1 : column + 10], DARK, 60).sum() > 30
    left, right, _, _ = bounds(of_colour(image[HEIGHT - 18 : HEIGHT - 14, :80], INK, 0))
    assert right - left == pytest.approx(60.0, abs=2)  # the scale: a metre


def segmentation(labels: list[int], pairs: list[tuple[int, int]]) -> Segmentation:
    """Nodes two metres apart along the corridor."""
    n, names = len(labels), np.array(labels, dtype=np.int32)
    return Segmentation(
        labels=np.zeros((40, 80), dtype=np.int32),
        nodes=np.column_stack([11.0 + 2.0 * np.arange(n), np.zeros(n)]),
        node_labels=names,
        pairs=np.array(pairs, dtype=np.intp).reshape(-1, 2),
        spectrum=Spectrum(labels=names, eigenvalues=np.array([1.0, 0.9, 0.1]), used=2),
    )


def test_nodes_of_a_division_have_a_colour_a_region() -> None:
    image = draw_segmentation(corridor(), segmentation([0, 0, 1, 2], []), 0.75)
    assert image.shape[1] == 900
    scale = 900 / 80 / 0.1
    seen = [
        pixel(image, np.array([(x - 10.0) * scale, image.shape[0] - SPECTRUM - 60 - 2.0 * scale]))
        for x in (11.0, 13.0, 15.0, 17.0)
    ]
    assert seen[0] == seen[1]
    assert len({seen[1], seen[2], seen[3]}) == 3
    assert cv2.cvtColor(np.array([seen], dtype=np.uint8), cv2.COLOR_BGR2HSV)[0, :, 1].min() > 150


def test_the_picture_shows_the_free_part_of_a_large_map_and_the_whole_of_one_without() -> None:
    cells = np.pad(corridor().cells, 300, constant_values=UNKNOWN)
    wide = GridMap(cells, 0.1, (10.0 - 30.0, -2.0 - 30.0))
    image = draw_segmentation(wide, segmentation([0, 1], [(0, 1)]), 0.75)
    white = bounds(of_colour(image[:-SPECTRUM], (255, 255, 255), 0))
    assert white[1] - white[0] > 700
    assert image.shape[1] == 900
    grid = GridMap(np.full((30, 60), UNKNOWN, dtype=np.uint8), 0.1)
    image = draw_segmentation(grid, segmentation([], []), 0.75)
    assert image.shape == (450 + 60 + SPECTRUM, 900, 3)
    assert (image[:420] == 215).all()

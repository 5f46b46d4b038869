"""Confusion matrices: every cell in its place and colour, for any number of classes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.palette import PAPER, RIGHT, SHADE, paler
from specmap_cli.drawing.predictions import render_confusion
from tests.drawing.looking import bounds, inked, is_framed, near, of_colour

LARGEST = 72  # pixels of a cell while there are few


def centres(image: Image, rows: int, columns: int) -> NDArray[np.int64]:
    """(rows, columns, 2) x and y inside every cell, above its figures: cells are shaded squares."""
    white = (of_colour(image, PAPER, 0) | ~inked(image)).astype(np.uint8)
    count, _, stats, _ = cv2.connectedComponentsWithStats(1 - white, connectivity=4)
    large = [
        stats[k, :4].tolist()
        for k in range(1, count)
        if min(stats[k, cv2.CC_STAT_WIDTH], stats[k, cv2.CC_STAT_HEIGHT]) >= LARGEST - 2
    ]
    assert len(large) == rows * columns
    assert {(w, h) for _, _, w, h in large} == {(LARGEST - 1, LARGEST - 1)}
    corners = sorted((top, left) for left, top, _, _ in large)
    return np.array([(left + 36, top + 12) for top, left in corners]).reshape(rows, columns, 2)


def colour_at(image: Image, place: NDArray[np.int64]) -> list[int]:
    x, y = place.tolist()
    found: list[int] = image[y, x].tolist()
    return found


def test_right_is_blue_wrong_is_red_and_nothing_is_grey() -> None:
    image = render_confusion(np.array([[9, 1, 0], [0, 10, 0]]), ["0", "1"], ["0", "1", "?"])
    at = centres(image, 2, 3)
    assert np.diff(at[0, :, 0]).tolist() == [LARGEST, LARGEST]
    assert np.diff(at[:, 0, 1]).tolist() == [LARGEST]
    assert colour_at(image, at[1, 1]) == list(RIGHT)
    assert colour_at(image, at[0, 0]) == list(paler(RIGHT, 0.088))
    for row, column in ((0, 2), (1, 0), (1, 2)):
        assert colour_at(image, at[row, column]) == list(SHADE)
    blue, green, red = colour_at(image, at[0, 1])
    assert red > max(blue, green) + 20


@pytest.mark.parametrize("wrong", [1, 30, 60, 99])
def test_the_more_of_a_row_the_deeper_the_colour(wrong: int) -> None:
    image = render_confusion(np.array([[100 - wrong, wrong], [0, 1]]), ["a", "b"])
    at = centres(image, 2, 2)
    more = render_confusion(np.array([[99 - wrong, wrong + 1], [0, 1]]), ["a", "b"])
    assert sum(colour_at(more, at[0, 1])) < sum(colour_at(image, at[0, 1]))
    assert sum(colour_at(more, at[0, 0])) >= sum(colour_at(image, at[0, 0]))


def test_cells_show_shares_of_their_row_not_counts() -> None:
    """A row counted ten times as often has the same cells; only its number of scans differs."""
    counts = np.array([[3, 1], [2, 2]])
    once = render_confusion(counts, ["a", "b"])
    often = render_confusion(counts * [[10], [1]], ["a", "b"])
    right = int(centres(once, 2, 2)[0, 1, 0]) + LARGEST // 2
    np.testing.assert_array_equal(once[:, :right], often[:, :right])
    assert (once[:, right:] != often[:, right:]).any()


@pytest.mark.parametrize("few", [1, 4, 5])
def test_a_cell_of_less_than_a_percent_does_not_say_nought(few: int) -> None:
    """0.1, 0.4 and 0.5 percent read `<1`: the letters lie on the same pixels."""
    pictures = []
    for count in (few, 2):
        image = render_confusion(np.array([[1000 - count, count], [0, 1]]), ["a", "b"])
        x, y = centres(image, 2, 2)[0, 1].tolist()
        pictures.append(image[y - 8 : y + 56, x - 30 : x + 30].max(axis=-1) < 150)
    assert pictures[0].any()
    np.testing.assert_array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize("size", [0, 1, 12, 150])
@pytest.mark.parametrize("name", ["{}", "the room with a long name, number {}"])
def test_any_number_of_classes_and_any_names_fit(size: int, name: str) -> None:
    names = [name.format(i) for i in range(size)]
    image = render_confusion(np.eye(size) * 3, names)
    assert max(image.shape) < 3000
    assert min(image.shape[:2]) > 90
    assert is_framed(image)
    if size:
        assert near(image, RIGHT) > 150 * size


@pytest.mark.parametrize(
    ("size", "cell", "figures"), [(20, 70, True), (50, 28, True), (80, 17, False)]
)
def test_small_cells_have_no_figures(size: int, cell: int, figures: bool) -> None:
    image = render_confusion(np.eye(size), [""] * size)
    left, right, top, bottom = bounds(of_colour(image, RIGHT, 0))
    assert right - left == bottom - top == size * cell - 2
    first = image[top : top + cell - 1, left : left + cell - 1]
    assert bool(inked(first, RIGHT).any()) is figures


@pytest.mark.parametrize(
    ("shape", "columns", "complaint"),
    [
        ((2, 2), ["a", "b", "c"], r"matrix \(2, 2\) for 2 rows, 3 columns"),
        ((3, 2), None, r"matrix \(3, 2\) for 2 rows, 2 columns"),
    ],
)
def test_names_must_fit(shape: tuple[int, int], columns: list[str] | None, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        render_confusion(np.zeros(shape), ["a", "b"], columns)

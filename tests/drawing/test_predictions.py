"""Predicted submaps along a trajectory, and their confusion matrices."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.core.records import NO_SUBMAP, IntArray
from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.overview import render_confusion, render_labels
from specmap_cli.drawing.palette import PAPER, RIGHT, SHADE, paler
from specmap_cli.drawing.sheet import TITLE
from specmap_cli.maps.writing import MapResult
from tests.drawing.looking import inked, is_framed, near, of_colour, pixel

LARGEST = 72  # pixels of a cell while there are few


STRAIGHT = np.column_stack([np.linspace(0.0, 10.0, 120), np.zeros(120)])  # (n, 2) ten metres


def thirds(*ids: int) -> IntArray:
    """(n,) labels that change along the way, each for as long."""
    return np.repeat(np.array(ids, dtype=np.int64), 120 // len(ids))


def along(*ids: int) -> Image:
    """The picture of the straight way, without title and legend."""
    return render_labels(STRAIGHT, thirds(*ids), "t")[TITLE:-160]


def test_each_scan_has_the_colour_of_its_submap(result: MapResult) -> None:
    labels, ground = result.labels, (result.topology, result.regions)
    image = render_labels(labels.poses, labels.submaps, "t", map_with_regions=ground)
    for fill in palette.colours_of(*ground).values():
        assert near(image, palette.vivid(fill)) > 50
        assert near(image, fill) > 5000  # the region itself
    assert near(image, palette.WRONG) == 0
    assert is_framed(image)


def test_without_a_map_neighbours_along_the_way_differ_or_the_colours_are_those_given() -> None:
    lengths = [near(along(7, 3, 7, 3), palette.vivid(fill)) for fill in palette.FILLS]
    assert sorted(lengths)[-3] == 0
    assert sorted(lengths)[-2] > 3500  # two stretches of 375 pixels each, but for badges
    fills = palette.colour_graph([1, 2, 3, 8], [(1, 8), (2, 3)])  # not neighbours along the way
    image = render_labels(STRAIGHT, thirds(8, 2), "t", fills=fills)
    for id_ in (8, 2):
        assert near(image, palette.vivid(fills[id_])) > 200
    assert fills[8] != palette.colour_graph([8, 2], [(8, 2)])[8]


def test_wrong_ones_are_marked_as_long_as_they_are_and_unknown_ones_are_not_wrong() -> None:
    truth = thirds(0, 1)
    marks = []
    for wrong in (0, 10, 40):
        said = truth.copy()
        said[5 : 5 + wrong], said[90:100] = 1, NO_SUBMAP
        picture = render_labels(STRAIGHT, said, "t", truth=truth)
        marks.append(of_colour(picture, palette.WRONG, 25)[TITLE:-160].any(axis=0).sum())
        assert near(picture[-160:], palette.WRONG) > 50  # the legend says what it means
    assert marks[0] == 0
    assert marks[2] - marks[1] == pytest.approx(30 / 119 * 1500, rel=0.05)


def test_unknown_scans_are_rings() -> None:
    known, some, none = along(4, 4), along(4, NO_SUBMAP), along(NO_SUBMAP)
    assert near(known, palette.INK) < near(some, palette.INK) < near(none, palette.INK)
    line = palette.vivid(palette.FILLS[4])
    assert near(known, line) > 1.5 * near(some, line) > near(none, line) == 0


@pytest.mark.parametrize("count", [0, 1])
def test_few_places(count: int) -> None:
    labels = np.zeros(count, dtype=np.int64)
    image = render_labels(np.zeros((count, 2)), labels, "t", truth=labels)
    assert is_framed(image)
    assert inked(image[TITLE : TITLE + 1700]).any() == bool(count)


def test_a_robot_lost_and_found_is_not_led_across() -> None:
    places = STRAIGHT.copy()
    places[60:, 0] += 40.0
    image = render_labels(places, thirds(0, 1), "t")
    columns = np.flatnonzero(inked(image[TITLE:-160]).any(axis=0))
    assert np.diff(columns).max() > 0.6 * np.ptp(columns)


def test_each_long_stretch_has_a_badge_with_its_id_and_those_of_one_submap_keep_apart() -> None:
    """Badges have a rim in the dark shade of the submap's colour."""
    for ids, badges in (((5,), 1), ((5, 6), 2), ((5, NO_SUBMAP), 1), ((NO_SUBMAP,), 0)):
        image = along(*ids)
        rims = [near(image, palette.darker(fill)) > 60 for fill in palette.FILLS]
        assert sum(rims) == badges, ids
    flickering = (0, 0, 1, 1) * 30  # does not paper the way over with badges
    one, rim = (near(along(*ids), palette.darker(palette.FILLS[0])) for ids in ((0, 1), flickering))
    assert one < rim < (1500 / (5.0 * symbols.BADGE_GAP) + 2) * one


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


def test_right_is_blue_wrong_is_red_and_nothing_is_grey() -> None:
    image = render_confusion(np.array([[9, 1, 0], [0, 10, 0]]), ["0", "1"], ["0", "1", "?"])
    at = centres(image, 2, 3)
    assert np.diff(at[0, :, 0]).tolist() == [LARGEST, LARGEST]
    assert np.diff(at[:, 0, 1]).tolist() == [LARGEST]
    assert pixel(image, at[1, 1]) == RIGHT
    assert pixel(image, at[0, 0]) == paler(RIGHT, 0.088)
    for row, column in ((0, 2), (1, 0), (1, 2)):
        assert pixel(image, at[row, column]) == SHADE
    wrong = blue, green, red = pixel(image, at[0, 1])
    assert wrong == paler((40, 24, 200), 0.792)
    assert red > max(blue, green) + 20


@pytest.mark.parametrize("few", [1, 4, 5])
def test_a_cell_of_less_than_a_percent_does_not_say_nought(few: int) -> None:
    """0.1, 0.4 and 0.5 percent read `<1`: the letters lie on the same pixels."""
    pictures = []
    for count in (few, 2):
        image = render_confusion(np.array([[1000 - count, count], [0, 1]]), "ab", "ab")
        x, y = centres(image, 2, 2)[0, 1].tolist()
        pictures.append(image[y - 8 : y + 56, x - 30 : x + 30].max(axis=-1) < 150)
    assert pictures[0].any()
    np.testing.assert_array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize("size", [0, 1, 12, 150])
@pytest.mark.parametrize("name", ["{}", "the room with a long name, number {}"])
def test_any_number_of_classes_and_any_names_fit(size: int, name: str) -> None:
    names = [name.format(i) for i in range(size)]
    image = render_confusion(np.eye(size) * 3, names, names)
    assert max(image.shape) < 3000
    assert min(image.shape[:2]) > 90
    assert is_framed(image)
    if size:
        assert near(image, RIGHT) > 150 * size


def test_names_must_fit() -> None:
    with pytest.raises(ValueError, match=r"matrix \(2, 2\) for 2 rows, 3 columns"):
        render_confusion(np.zeros((2, 2)), ["a", "b"], ["a", "b", "c"])
    with pytest.raises(ValueError, match=r"matrix \(3, 2\) for 2 rows, 2 columns"):
        render_confusion(np.zeros((3, 2)), "ab", "ab")

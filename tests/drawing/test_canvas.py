"""Pens on paper: where lines, discs, boxes and words are, and what is cut off."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.drawing.canvas import Canvas, in_visual_order
from specmap_cli.drawing.palette import CLOSURE, INK, TRAVERSED
from tests.drawing.looking import bounds, inked, near, of_colour

positions = st.floats(15.0, 45.0)


@pytest.mark.parametrize("width", [1, 3, 6])
def test_a_line_is_as_wide_as_asked_and_turns_corners(width: int) -> None:
    way = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 50.0]])
    canvas = Canvas(60, 60)
    for too_few in (way[:0], way[:1]):
        canvas.line(too_few, INK, width)
        assert not inked(canvas.image).any()
    canvas.line(way, INK, width)
    dark = canvas.image[:, :, 0] < 150
    for across in (dark[:, 30], dark[30, :]):
        assert width - 1 <= np.count_nonzero(across) <= width + 2  # OpenCV's smooth lines are bold
    assert dark[10, 50]
    assert not dark[30:, 10:30].any()


def test_dashes_begin_anew_at_a_corner_and_skip_points_that_repeat() -> None:
    way = np.array([[10.0, 10.0], [10.0, 10.0], [40.0, 10.0], [40.0, 60.0], [40.0, 60.0]])
    canvas = Canvas(60, 80)
    canvas.dashes(way, INK, 1, 10.0, 40.0)
    along, down = canvas.image[10, :36, 0] < 200, canvas.image[:, 40, 0] < 200
    for dashes in (along, down):
        assert bounds(dashes[None])[:2] == pytest.approx((10, 20), abs=1)


@given(positions, positions, st.floats(3.0, 12.0))
def test_a_disc_lies_at_its_centre_to_a_fraction_of_a_pixel(x: float, y: float, r: float) -> None:
    canvas = Canvas(60, 60)
    canvas.disc(np.array([x, y]), r, (0, 0, 0))
    weight = 255.0 - canvas.image[:, :, 0]
    rows, columns = np.mgrid[:60, :60]
    assert (weight * columns).sum() / weight.sum() == pytest.approx(x, abs=0.15)
    assert (weight * rows).sum() / weight.sum() == pytest.approx(y, abs=0.15)
    area = weight.sum() / 255.0
    assert np.pi * (r - 0.5) ** 2 < area < np.pi * (r + 1.0) ** 2


@pytest.mark.parametrize(
    ("words", "shown"),  # A and B stand for letters that are written from right to left
    [
        ("lab 12", "lab 12"),
        ("AB", "BA"),
        ("AB 12", "12 BA"),
        ("lab AB 12", "lab 12 BA"),
        ("AB lab 3", "lab 3 BA"),
        ("lab 3 AB", "lab 3 BA"),
        ("5 A", "A 5"),
        ("A (2.5)", "(2.5) A"),
        ("A, B!", "!B ,A"),
        ("x (AB) y", "x (BA) y"),
        ("A*B", "BA*"),  # a mark stays behind its letter
    ],
)
@pytest.mark.parametrize("script", [("\u05d0", "\u05d1", "\u05b0"), ("\u0645", "\u0644", "\u064e")])
def test_words_of_scripts_from_right_to_left_stand_in_their_order(
    words: str, shown: str, script: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    table = str.maketrans(dict(zip("AB*", script, strict=True)))
    words, shown = words.translate(table), shown.translate(table)
    assert in_visual_order(words) == shown
    canvas, as_shown = Canvas(200, 40), Canvas(200, 40)
    canvas.text(10, 20, words, 12)
    monkeypatch.setattr("specmap_cli.drawing.canvas.in_visual_order", lambda given: given)
    as_shown.text(10, 20, shown, 12)
    np.testing.assert_array_equal(canvas.image, as_shown.image)


def test_upright_words_are_lying_ones_turned_about_their_first_letter() -> None:
    """Two pixels are left free before it."""
    upright, lying = Canvas(60, 120), Canvas(120, 60)
    upright.upright_text(30, 110, "TL", 14)
    lying.text(12, 30, "TL", 14)
    np.testing.assert_array_equal(upright.image, np.rot90(lying.image))


def test_what_lies_outside_is_cut_off() -> None:
    canvas = Canvas(30, 30)
    canvas.line(np.array([[-1e9, 5.0], [1e9, 5.0]]), INK, 2)
    canvas.disc(np.array([1e9, -1e9]), 5.0, CLOSURE)
    canvas.box(np.array([-50, 20]), np.array([80, 22]), TRAVERSED)
    canvas.box(np.array([1e300, 1e20]), np.array([2e300, 1e21]), CLOSURE)
    canvas.text(1e12, -1e300, "far off", 12, CLOSURE)
    canvas.upright_text(-1e12, 1e300, "far off", 12)
    assert canvas.image.shape == (30, 30, 3)
    assert of_colour(canvas.image, INK)[5].all()
    assert of_colour(canvas.image, TRAVERSED)[20:23].all()
    assert near(canvas.image, CLOSURE) == 0

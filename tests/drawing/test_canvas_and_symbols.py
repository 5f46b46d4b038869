"""Pens on paper, and symbols on the ground of a map: where they are, and what is cut off."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.canvas import Canvas, in_visual_order
from specmap_cli.drawing.palette import CLOSURE, INK, TRAVERSED
from tests.drawing.looking import bounds, inked, near, of_colour, pixel

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


@pytest.mark.parametrize("driven", [True, False])
def test_a_door_is_a_passage_between_jambs_with_dots_where_it_was_only_seen(driven: bool) -> None:
    """No leaf stands in it or out of the wall: who drew the map saw none."""
    canvas = Canvas(120, 120, palette.SHADE)
    symbols.door(canvas, np.array([[30.0, 80.0], [90.0, 80.0]]), driven)
    left, right, top, bottom = bounds(of_colour(canvas.image, palette.DOOR, 60))
    assert (left, right, top, bottom) == pytest.approx((27, 93, 68, 92), abs=1.5)
    for jamb in (30, 90):
        for y in (73, 87):
            assert pixel(canvas.image, np.array([jamb, y])) == pytest.approx(palette.DOOR, abs=8)
    between = of_colour(canvas.image, palette.DOOR, 60)[80, 36:85]
    assert 0.1 < between.mean() < 0.6 if not driven else not between.any()
    assert near(canvas.image[78:83, 36:85], palette.PAPER) > 60
    assert pixel(canvas.image, np.array([15, 80])) == palette.SHADE


def test_a_door_of_a_large_building_can_still_be_seen() -> None:
    canvas = Canvas(120, 80, palette.SHADE)
    symbols.door(canvas, np.array([[60.0, 39.0], [60.0, 41.0]]), True)
    _, _, top, bottom = bounds(of_colour(canvas.image, palette.DOOR, 60))
    assert bottom - top >= 16


@pytest.mark.parametrize("name", ["0", "12", "347"])
def test_a_badge_holds_its_id(name: str) -> None:
    canvas = Canvas(80, 80, palette.SHADE)
    symbols.badge(canvas, np.array([40.0, 40.0]), name, palette.FILLS[2])
    radius = symbols.BADGE_RADIUS
    left, right, top, bottom = bounds(inked(canvas.image, palette.SHADE))
    assert (left + right, top + bottom) == (80, 80)
    assert (right - left) / 2 == pytest.approx(radius + 2, abs=1.5)
    rim = pixel(canvas.image, np.array([40 + radius + 1, 40]))
    assert rim == pytest.approx(palette.darker(palette.FILLS[2]), abs=40)
    letters = bounds(of_colour(canvas.image, palette.INK, 40))
    assert np.hypot(max(40 - letters[0], letters[1] - 40), letters[3] - 40) < radius


def test_a_legend_explains_what_is_shown_and_nothing_else_in_one_order() -> None:
    assert symbols.legend_of([]) == ()
    shown = ["forbidden", "loop closure", "wall", "submap", "door, only seen", "door"]
    found = [words for words, _ in symbols.legend_of(shown)]
    assert found == ["submap", "wall", "loop closure", "door", "door, only seen", "forbidden"]
    assert len({*symbols.LINK_WORDS.values()}) == len(symbols.LINK_WORDS)


@pytest.mark.parametrize("words", sorted(symbols.SYMBOLS))
def test_every_symbol_fits_its_place_in_the_legend(words: str) -> None:
    canvas = Canvas(120, 80, (200, 180, 160))
    symbols.SYMBOLS[words](canvas, np.array([60.0, 40.0]))
    left, right, top, bottom = bounds(inked(canvas.image, (200, 180, 160)))
    assert min(left - 32, top - 19) >= 0  # words begin 30 pixels to the right of the middle
    assert max(right - 88, bottom - 61) <= 0
    assert right - left >= 8
    assert abs(left + right - 120) <= 6
    assert abs(top + bottom - 80) <= 3


@pytest.mark.parametrize(
    ("kind", "colour", "strokes"),
    [
        ("traversed", palette.TRAVERSED, 1),
        ("doorway", palette.TRAVERSED, 1),
        ("closure", palette.CLOSURE, 8),
        ("loose", palette.LOOSE, 17),
        ("seen", palette.TRAVERSED, 16),
        ("narrow", palette.TRAVERSED, 17),
    ],
)
def test_the_lines_of_links(kind: symbols.LinkKind, colour: palette.Colour, strokes: int) -> None:
    canvas = Canvas(240, 40, palette.SHADE)
    symbols.edge(canvas, np.array([[20.0, 20.0], [220.0, 20.0]]), kind)
    along = of_colour(canvas.image, colour, 60)[20]
    assert np.count_nonzero(np.diff(along.astype(int)) == 1) == strokes
    assert near(canvas.image, colour) > 100
    others = {palette.TRAVERSED, palette.CLOSURE, palette.LOOSE} - {colour}
    assert not any(near(canvas.image, other) for other in others)
    if strokes < 10:  # paper sets it off from the ground
        rows = np.flatnonzero(of_colour(canvas.image, palette.PAPER, 8)[:, 24])
        assert rows.min() < 19
        assert rows.max() > 21

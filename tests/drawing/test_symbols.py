"""Symbols on the ground of a map, and the legends that explain them."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.canvas import Canvas
from tests.drawing.looking import bounds, inked, near, of_colour, pixel


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

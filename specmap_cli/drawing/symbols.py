"""What lies on the ground of a map picture, and how the legend explains it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing import palette
from specmap_cli.drawing.canvas import Canvas, text_width
from specmap_cli.topology.topological_map import EdgeKind

LinkKind = EdgeKind | Literal["narrow"]  # narrow: the robot fits through no way, or must not go
Symbol = Callable[[Canvas, FloatArray], None]
Legend = tuple[tuple[str, Symbol], ...]

PATH: palette.Colour = (88, 82, 76)
# Pixels, chosen by eye for a sheet of some 1800 pixels.
BADGE_RADIUS = 17.0
_SIGN_RADIUS = 14.0
_NAME_LETTERS, _LONGEST_NAME = 11.0, 24
_ID_LETTERS = 20.0
BADGE_GAP = 2.0 * BADGE_RADIUS + 6.0
# Width of the line of predictions; the mark of wrong ones shows on both sides of its rim of paper.
PREDICTED, RIM, MISTAKEN = 6, 10, 18
_LINK, _LINK_HALO = 3, 7  # width of a link, and of the paper under it
_DASH, _DASH_GAP = 16.0, 10.0  # of a closure
_DOT, _DOT_GAP = 5, 12.0  # of a guess
_SEEN_DASH, _SEEN_GAP = 6.0, 7.0  # of a way that was only seen
_DOOR, _TICK = 6, 9.0  # width of a tick at the jamb of a door, and half its length
_SHORTEST_DOOR = 16.0  # on a sheet of a large building
_REACH, _DOOR_REACH = 20, 16  # half the width of a line in the legend, and of a door


def edge(canvas: Canvas, points: NDArray[Any], kind: LinkKind) -> None:
    """A link of the graph: solid when driven or open, dashed for a closure, dotted for a guess.

    What was only seen has short dashes, what is too narrow or forbidden has dots.
    """
    if kind == "closure":
        canvas.dashes(points, palette.PAPER, _LINK_HALO, _DASH, _DASH_GAP)
        canvas.dashes(points, palette.CLOSURE, _LINK, _DASH, _DASH_GAP)
    elif kind == "loose":
        canvas.dashes(points, palette.LOOSE, _DOT, 0.0, _DOT_GAP)
    elif kind == "narrow":
        canvas.dashes(points, palette.TRAVERSED, _DOT - 1, 0.0, _DOT_GAP)
    elif kind == "seen":
        canvas.dashes(points, palette.TRAVERSED, _LINK, _SEEN_DASH, _SEEN_GAP)
    else:
        canvas.line(points, palette.PAPER, _LINK_HALO)
        canvas.line(points, palette.TRAVERSED, _LINK)


def door(canvas: Canvas, sides: NDArray[Any], driven: bool) -> None:
    """A passage as wide as it is: a tick at each of its jambs (2, 2), and nothing between them.

    Dots cross one that was only seen: the robot never drove through.
    """
    middle, half = sides.mean(axis=0), (sides[1] - sides[0]) / 2.0
    length = max(1.0, float(np.linalg.norm(half)))
    tick = np.array([half[1], -half[0]]) * _TICK / length
    half *= max(1.0, _SHORTEST_DOOR / 2.0 / length)
    opening = np.array([middle - half, middle + half])
    jambs = [np.array([end - tick, end + tick]) for end in opening]
    for line in (*jambs, opening):
        canvas.line(line, palette.PAPER, _DOOR + 4)
    if not driven:
        canvas.dashes(opening, palette.DOOR, _DOOR - 2, 0.0, 2.0 * _DOOR)
    for jamb in jambs:
        canvas.line(jamb, palette.DOOR, _DOOR)


def badge(canvas: Canvas, centre: NDArray[Any], name: str, fill: palette.Colour) -> None:
    """A node of the graph with the id of its submap."""
    canvas.disc(centre, BADGE_RADIUS, palette.PAPER, palette.darker(fill))
    height = 12.0 if len(name) < 3 else 9.0
    canvas.text(float(centre[0]), float(centre[1]), name, height, palette.INK, "centre", bold=True)


def ground_id(canvas: Canvas, centre: NDArray[Any], id_: int) -> None:
    """The id of a region, larger than those on the badges, with a rim of paper round it."""
    x, y = float(centre[0]), float(centre[1])
    for dx, dy in itertools.product((-2, 0, 2), repeat=2):
        canvas.text(x + dx, y + dy, str(id_), _ID_LETTERS, palette.PAPER, "centre", bold=True)
    canvas.text(x, y, str(id_), _ID_LETTERS, palette.QUIET, "centre", bold=True)


def name_under(canvas: Canvas, centre: NDArray[Any], name: str) -> None:
    """A person's name for a submap under its badge, on paper, so that it can be read anywhere."""
    if not name:
        return
    shown = name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 3] + "..."
    x, y = float(centre[0]), float(centre[1]) + BADGE_RADIUS + _NAME_LETTERS + 1.0
    reach = np.array([text_width(shown, _NAME_LETTERS, bold=True) / 2.0 + 5.0, _NAME_LETTERS])
    canvas.box(np.array([x, y]) - reach, np.array([x, y]) + reach, palette.PAPER)
    canvas.text(x, y, shown, _NAME_LETTERS, palette.INK, "centre", bold=True)


def no_entry(canvas: Canvas, centre: NDArray[Any]) -> None:
    """A link that a person forbade: the sign of a road that must not be entered."""
    canvas.disc(centre, _SIGN_RADIUS, palette.WRONG, palette.PAPER)
    middle = np.asarray(centre)
    bar = np.array([8.0, 2.5])
    canvas.box(middle - bar, middle + bar, palette.PAPER)


def start(canvas: Canvas, centre: NDArray[Any]) -> None:
    """Where the trajectory starts: a square."""
    middle = np.asarray(centre)
    canvas.box(middle - 9, middle + 9, palette.PAPER)
    canvas.box(middle - 7, middle + 7, palette.INK)


def end(canvas: Canvas, centre: NDArray[Any]) -> None:
    """Where the trajectory ends: a disc."""
    canvas.disc(centre, 8.0, palette.INK, palette.PAPER)


def warning(canvas: Canvas, centre: NDArray[Any]) -> None:
    """A place where the map may be wrong: a mark in a red ring."""
    canvas.disc(centre, _SIGN_RADIUS, palette.PAPER, palette.WRONG)
    canvas.text(float(centre[0]), float(centre[1]), "!", 13.0, palette.WRONG, "centre", bold=True)


def unknown(canvas: Canvas, centre: NDArray[Any]) -> None:
    """A scan that belongs to no submap: a ring."""
    canvas.disc(centre, 4.0, palette.PAPER, palette.INK)


def _link(kind: LinkKind) -> Symbol:
    # two dashes of a closure with the gap between them
    return lambda canvas, at: edge(canvas, _level(at, 21.0), kind)


def _door(driven: bool) -> Symbol:
    return lambda canvas, at: door(canvas, _level(at, _DOOR_REACH), driven)


def _level(centre: FloatArray, reach: float = _REACH) -> FloatArray:
    """The ends (2, 2) of a line of the legend."""
    return np.array([centre - (reach, 0.0), centre + (reach, 0.0)])


def _bar(half_height: float, colour: palette.Colour) -> Symbol:
    half = np.array([_REACH, half_height])
    return lambda canvas, at: canvas.box(at - half, at + half, colour)


def _predicted(canvas: Canvas, centre: FloatArray) -> None:
    first, last = _level(centre)
    canvas.line(np.array([first, centre]), palette.vivid(palette.FILLS[0]), PREDICTED)
    canvas.line(np.array([centre, last]), palette.vivid(palette.FILLS[1]), PREDICTED)


def _wrong(canvas: Canvas, centre: FloatArray) -> None:
    way = _level(centre, _REACH - 4)
    canvas.line(way, palette.WRONG, MISTAKEN)
    canvas.line(way, palette.PAPER, RIM)
    canvas.line(way, palette.vivid(palette.FILLS[0]), PREDICTED)


LINK_WORDS: dict[LinkKind, str] = {
    "traversed": "way, driven",
    "closure": "loop closure",
    "loose": "joined by a guess",
    "seen": "way, only seen",
    "narrow": "no way for the robot",
    "doorway": "way",
}
DOOR_WORDS = {True: "door", False: "door, only seen"}  # by whether the robot drove through
# What can lie on the ground of a map, in the order in which a legend explains it.
SYMBOLS: dict[str, Symbol] = {
    "submap": lambda canvas, at: badge(canvas, at, "7", palette.FILLS[0]),
    "predicted submap, with its id": _predicted,
    "unknown": unknown,
    "wrong": _wrong,
    "wall": _bar(3.0, palette.INK),
    "only seen": _bar(10.0, palette.SEEN),
    "trajectory": lambda canvas, at: canvas.line(_level(at), PATH, 2),
    "start": start,
    "end": end,
    **{words: _link(kind) for kind, words in LINK_WORDS.items()},
    **{words: _door(driven) for driven, words in DOOR_WORDS.items()},
    "forbidden": no_entry,
    "the map may be wrong here": warning,
}


def legend_of(shown: Collection[str]) -> Legend:
    """The entries of a legend, by their words: none but those is shown."""
    return tuple((words, symbol) for words, symbol in SYMBOLS.items() if words in shown)

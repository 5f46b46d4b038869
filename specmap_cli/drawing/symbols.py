"""What lies on the ground of a map picture, and how the legend explains it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.drawing.canvas import Canvas
from specmap_cli.drawing.palette import (
    CLOSURE,
    FILLS,
    INK,
    LOOSE,
    PAPER,
    SHADE,
    TRAVERSED,
    WRONG,
    Colour,
    darker,
    vivid,
)
from specmap_cli.topology.topological_map import EdgeKind

Symbol = Callable[[Canvas, float, float], None]
Legend = list[tuple[str, Symbol]]

PATH: Colour = (88, 82, 76)
BADGE_RADIUS = 17.0
BADGE_GAP = 2.0 * BADGE_RADIUS + 6.0
_EDGE_WORDS: dict[EdgeKind, str] = {
    "traversed": "crossed by the robot",
    "closure": "loop closure",
    "loose": "joined by a guess",
    "doorway": "doorway",
}


def edge(canvas: Canvas, points: NDArray[Any], kind: EdgeKind) -> None:
    """A link of the graph: solid when driven or open, dashed for a closure, dotted for a guess."""
    if kind == "closure":
        canvas.dashes(points, PAPER, 7, 16.0, 10.0)
        canvas.dashes(points, CLOSURE, 4, 16.0, 10.0)
    elif kind == "loose":
        canvas.dashes(points, LOOSE, 5, 0.0, 12.0)
    else:
        canvas.line(points, PAPER, 7)
        canvas.line(points, TRAVERSED, 4)


def badge(canvas: Canvas, centre: NDArray[Any], name: str, fill: Colour) -> None:
    """A node of the graph with the id of its submap."""
    canvas.disc(centre, BADGE_RADIUS, PAPER, darker(fill))
    height = 12.0 if len(name) < 3 else 9.0
    canvas.text(float(centre[0]), float(centre[1]), name, height, INK, "centre", bold=True)


def start(canvas: Canvas, centre: NDArray[Any]) -> None:
    """Where the trajectory starts: a square."""
    middle = np.asarray(centre)
    canvas.box(middle - 9, middle + 9, PAPER)
    canvas.box(middle - 7, middle + 7, INK)


def end(canvas: Canvas, centre: NDArray[Any]) -> None:
    """Where the trajectory ends: a disc."""
    canvas.disc(centre, 8.0, INK, PAPER)


def overview_legend(kinds: Collection[EdgeKind], with_unreached: bool) -> Legend:
    """What the overview of a build shows; of the links only the kinds that occur."""
    return [
        ("submap", lambda c, x, y: badge(c, np.array([x, y]), "7", FILLS[0])),
        ("wall", _wall),
        *([("seen, not reached", _unreached)] if with_unreached else []),
        ("trajectory", lambda c, x, y: c.line(np.array([[x - 20, y], [x + 20, y]]), PATH, 2)),
        ("start", lambda c, x, y: start(c, np.array([x, y]))),
        ("end", lambda c, x, y: end(c, np.array([x, y]))),
        *links_legend(kinds),
    ]


def unknown(canvas: Canvas, centre: NDArray[Any]) -> None:
    """A scan that belongs to no submap: a ring."""
    canvas.disc(centre, 4.0, PAPER, INK)


def labels_legend(with_map: bool, with_unknown: bool, with_truth: bool) -> Legend:
    """What the picture of predicted submaps shows."""
    legend: Legend = [("predicted submap, with its id", _predicted)]
    if with_unknown:
        legend.append(("unknown", lambda c, x, y: unknown(c, np.array([x, y]))))
    if with_truth:
        legend.append(("wrong", _wrong))
    if with_map:
        legend.append(("wall", _wall))
    return [*legend, ("start", lambda c, x, y: start(c, np.array([x, y])))]


def regions_legend(kinds: Collection[EdgeKind]) -> Legend:
    """What the picture of a finished map shows."""
    return [
        ("submap", lambda c, x, y: badge(c, np.array([x, y]), "7", FILLS[0])),
        ("wall", _wall),
        *links_legend(kinds),
    ]


def links_legend(kinds: Collection[EdgeKind]) -> Legend:
    """The kinds of links that occur."""
    return [(words, _link(kind)) for kind, words in _EDGE_WORDS.items() if kind in kinds]


def _link(kind: EdgeKind) -> Symbol:
    def draw(canvas: Canvas, x: float, y: float) -> None:
        edge(canvas, np.array([[x - 21, y], [x + 21, y]]), kind)

    return draw


def _predicted(canvas: Canvas, x: float, y: float) -> None:
    canvas.line(np.array([[x - 20, y], [x, y]]), vivid(FILLS[0]), 6)
    canvas.line(np.array([[x, y], [x + 20, y]]), vivid(FILLS[1]), 6)


def _wrong(canvas: Canvas, x: float, y: float) -> None:
    canvas.line(np.array([[x - 20, y], [x + 20, y]]), WRONG, 12)
    canvas.line(np.array([[x - 20, y], [x + 20, y]]), vivid(FILLS[0]), 6)


def _unreached(canvas: Canvas, x: float, y: float) -> None:
    canvas.box(np.array([x - 20, y - 10]), np.array([x + 20, y + 10]), SHADE)


def _wall(canvas: Canvas, x: float, y: float) -> None:
    canvas.box(np.array([x - 20, y - 3]), np.array([x + 20, y + 3]), INK)

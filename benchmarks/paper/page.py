"""The parts put on one page, which needs nothing beside itself."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2

from benchmarks.paper.blocks import Block, Found, Picture, Table
from benchmarks.paper.cases import FREIBURG, LACKING, STATA, Cases
from benchmarks.paper.charts import drawn
from benchmarks.paper.parts import Part
from specmap_cli.report.html import html_page, tones

_PACKAGE = "benchmarks.paper"
_MOST_DOTS = 120  # of a line: more of them hide it
_FIGURES = set("0123456789+−–.,")


@dataclass(frozen=True, slots=True)
class Done:
    """A part that was made: its blocks, and the processor seconds it took."""

    part: Part
    blocks: Sequence[Block]
    seconds: float

    @property
    def found(self) -> Found | None:
        """What comes out, in words."""
        return next((block for block in self.blocks if isinstance(block, Found)), None)


def render(parts: Sequence[Done], cases: Cases, command: str) -> str:
    """The text of the page."""
    context = {
        "title": "The paper by one command",
        "parts": parts,
        "missing": cases.missing,
        "recordings": {
            manner: [case.name for case in cases.found if case.manner == manner]
            for manner in (FREIBURG, STATA)
        },
        "command": command,
        "tones": tones(()),
        "most_dots": _MOST_DOTS,
    }
    filters: dict[str, Callable[..., Any]] = {
        "image": image,
        "numeric": numeric,
        "drawn": drawn,
        "lacking": lacking,
    }
    styles = ("page.css", "parts.css", "paper.css")
    return html_page(_PACKAGE, "paper.html", context, styles, filters=filters)


def image(picture: Picture) -> str:
    """A picture as a link that holds it."""
    _, data = cv2.imencode(".png", picture.image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def lacking(names: Iterable[str]) -> str:
    """What is missing, in words."""
    return "; ".join(LACKING[name] for name in names)


def numeric(table: Table, column: int) -> bool:
    """Whether a column holds figures: it is set to the right."""
    cells = [row.cells[column] for row in table.rows if column < len(row.cells)]
    return all(not cell or cell[0] in _FIGURES for cell in cells) and column > 0

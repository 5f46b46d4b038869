"""The parts put on one page, which needs nothing beside itself."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import cv2
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from benchmarks.paper.blocks import Block, Picture, Table
from benchmarks.paper.cases import LACKING, Cases
from benchmarks.paper.charts import drawn
from benchmarks.paper.parts import Part
from specmap_cli import __version__
from specmap_cli.report.colours import tones

_TEMPLATES = Path(__file__).parent / "templates"
_FIGURES = set("0123456789+−–.,")


@dataclass(frozen=True, slots=True)
class Done:
    """A part that was made: its blocks, and the processor seconds it took."""

    part: Part
    blocks: Sequence[Block]
    seconds: float


def render(parts: Sequence[Done], cases: Cases, command: str) -> str:
    """The text of the page."""
    styles = resources.files("specmap_cli.report") / "styles"
    sheets = styles / "page.css", styles / "parts.css", _TEMPLATES / "paper.css"
    return (
        _environment()
        .get_template("page.html")
        .render(
            parts=parts,
            missing=cases.missing,
            recordings=[case.name for case in cases.found],
            command=command,
            tones=tones(()),
            style="\n".join(sheet.read_text(encoding="utf-8") for sheet in sheets),
            version=__version__,
        )
    )


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


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        {"image": image, "numeric": numeric, "drawn": drawn, "lacking": lacking}
    )
    return environment

"""What a part of the page is made of: words, findings, tables, pictures, charts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from specmap_cli.drawing.canvas import Image

_WIDE = 2.0  # times as wide as high: a picture that needs the whole page


@dataclass(frozen=True, slots=True)
class Words:
    """A paragraph; a warning stands out."""

    kind: ClassVar[str] = "words"
    text: str
    warning: bool = False


@dataclass(frozen=True, slots=True)
class Found:
    """What comes out here, line by line, to stand beside what the paper says; why it differs."""

    kind: ClassVar[str] = "found"
    text: str
    why: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table; one with the figures of the paper itself is marked."""

    cells: tuple[str, ...]
    published: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table: the heads of its columns, the rows, a caption."""

    kind: ClassVar[str] = "table"
    head: tuple[str, ...]
    rows: Sequence[Row]
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture, BGR, with its caption."""

    image: Image
    caption: str


@dataclass(frozen=True, slots=True)
class Gallery:
    """Pictures side by side, `across` of them at the most."""

    kind: ClassVar[str] = "gallery"
    pictures: Sequence[Picture]
    across: int = 2


def gallery(pictures: Sequence[Picture]) -> Gallery:
    """Pictures in pairs; wide ones below each other."""
    wide = any(each.image.shape[1] > _WIDE * each.image.shape[0] for each in pictures)
    return Gallery(pictures, across=1 if wide else 2)


@dataclass(frozen=True, slots=True)
class Series:
    """Points (x, y) of a chart, joined by a line; `marked` are the numbers of those that stand out.

    `level` is a height that the points are held against, drawn across the chart.
    """

    name: str
    points: Sequence[tuple[float, float]]
    marked: frozenset[int] = field(default_factory=frozenset)
    level: float | None = None


@dataclass(frozen=True, slots=True)
class Chart:
    """Series over two axes that begin at nought; `top` is the highest y, if it is given."""

    kind: ClassVar[str] = "chart"
    series: Sequence[Series]
    x_name: str
    y_name: str
    caption: str = ""
    top: float | None = None
    diagonal: bool = False


Block = Words | Found | Table | Gallery | Chart


def figure(value: float, places: int = 3) -> str:
    """A number as a table shows it; a dash for none."""
    return "–" if value != value else f"{value:.{places}f}"

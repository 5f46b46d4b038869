"""What a row of the scoreboard is: a figure with its bars, and what others reach."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Better = Literal["more", "less", "none"]


@dataclass(frozen=True, slots=True)
class Row:
    """A figure of a section.

    `must` is the bar and `aim` the ambition, None where nobody has set one; `better` says whether
    more is better; `form` is the format of the figure, `unit` stands behind it; `others` is what
    other programs or papers reach, in words.
    """

    key: str
    title: str
    must: float | None = None
    aim: float | None = None
    better: Better = "more"
    form: str = ".3f"
    unit: str = ""
    others: str = ""

    def text(self, value: float | None) -> str:
        """A figure of this row for reading."""
        if value is None or math.isnan(value):
            return "-"
        return f"{value:{self.form}}{' ' + self.unit if self.unit else ''}"

    def reaches(self, value: float, bar: float) -> bool:
        """Whether a figure, as it is printed, is as good as a bar."""
        shown = float(f"{value:{self.form}}".replace(",", "").rstrip("%"))
        return shown >= bar if self.better == "more" else shown <= bar


@dataclass(frozen=True, slots=True)
class Figure:
    """What was measured for a row.

    `low` and `high` are the least and the largest of several repeats; `note` says what a reader
    must know, such as why there is no value.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    note: str = ""

    @classmethod
    def of(cls, repeats: list[float], note: str = "") -> Figure:
        """The median of several repeats."""
        ordered = sorted(repeats)
        middle = ordered[len(ordered) // 2]
        if not len(ordered) % 2:
            middle = (middle + ordered[len(ordered) // 2 - 1]) / 2
        return cls(middle, ordered[0], ordered[-1], note)


Figures = Mapping[str, "Figure | float"]


@dataclass(frozen=True, slots=True)
class Section:
    """Rows that one piece of work measures.

    `module` has a function `measure(bench)`, which returns a figure for each of its `ROWS`, by
    their keys. `needs` are the folders of the data that it uses. A `quick` section is part of
    `--quick`; one that is `timed` runs while nothing else does.
    """

    name: str
    title: str
    module: str
    needs: tuple[str, ...] = ()
    quick: bool = False
    timed: bool = False


def figure(value: Figure | float) -> Figure:
    """A bare number is a figure without repeats."""
    return value if isinstance(value, Figure) else Figure(float(value))

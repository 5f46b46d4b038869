"""Borders that a person moved: two submaps made one, or one cut in two along a line.

One that is wished and one that was made are the same thing: only the latter has `runs` and `known`,
or `new` and a `fence`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from specmap_cli.core.json_values import Count, Point, Span, Value, Written, numbers_of

Line = tuple[Point, Point]  # its two ends, metres


@dataclass(frozen=True, slots=True)
class Merge(Value):
    """One submap became part of another."""

    merge: Annotated[tuple[Count, Count], Field(description="[kept, gone]: ids of the two")]
    runs: Annotated[
        tuple[Span, ...],
        Field(
            alias="keyframes",
            description="runs [first, last] of the keyframes that came with it, rows of labels.csv",
        ),
    ] = ()
    known: Annotated[Count, Field(description="number of keyframes that the map had then")] = 0

    @property
    def kept(self) -> int:
        """The submap that the other one became part of."""
        return self.merge[0]

    @property
    def gone(self) -> int:
        """The submap that became part of the other one."""
        return self.merge[1]

    @property
    def keyframes(self) -> tuple[int, ...]:
        """The keyframes that came with it, of the `known` first ones of the map."""
        return numbers_of(self.runs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Split(Value):
    """A submap was cut along a line."""

    submap: Annotated[
        Count,
        Field(alias="split", description="id of the submap, and of what is left of the line"),
    ]
    new: Annotated[
        int | None,
        Written(Count),
        Field(description="id of what is right of the line, seen along it"),
    ] = None
    line: Annotated[Line, Field(description="two places in the map, as a person gave them")]
    fence: Annotated[
        Line | None,
        Written(Line),
        Field(
            description="the line from border to border of the submap; no region reaches across it"
        ),
    ] = None


Border = Merge | Split


def bare(border: Border) -> Border:
    """A border as it was wished."""
    if isinstance(border, Merge):
        return Merge(border.merge)
    return Split(submap=border.submap, line=border.line, new=border.new)


def fences_of(borders: Iterable[Border]) -> tuple[Line, ...]:
    """The lines that no region grows across."""
    return tuple(
        border.fence for border in borders if isinstance(border, Split) and border.fence is not None
    )


def heirs(submap: int, borders: Iterable[Border]) -> frozenset[int]:
    """What a submap became by the borders that were made after it was called so."""
    found = {submap}
    for border in borders:
        if isinstance(border, Merge) and border.gone in found:
            found = found - {border.gone} | {border.kept}
        elif isinstance(border, Split) and border.submap in found and border.new is not None:
            found.add(border.new)
    return frozenset(found)

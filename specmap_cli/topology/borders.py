"""Borders that a person moved: two submaps made one, or one cut in two along a line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

Line = tuple[tuple[float, float], tuple[float, float]]  # its two ends, metres


@dataclass(frozen=True, slots=True)
class Merge:
    """The submap `gone` became part of `kept`.

    Once made: `keyframes` are those that came with it, of the `known` first ones of the map.
    """

    kept: int
    gone: int
    keyframes: tuple[int, ...] = ()
    known: int = 0


@dataclass(frozen=True, slots=True)
class Split:
    """A submap cut along a line: what is right of it, seen along it, is the submap `new`.

    `new` is None until an id is given. Once made: `fence` is the line from wall to wall.
    """

    submap: int
    line: Line
    new: int | None = None
    fence: Line | None = None


Border = Merge | Split


def bare(border: Border) -> Border:
    """A border as it was wished."""
    if isinstance(border, Merge):
        return Merge(border.kept, border.gone)
    return Split(border.submap, border.line, border.new)


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

"""Arguments of public functions, checked before the work: a wrong type is told at once."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from specmap_cli.core.text import quoted

Wanted = TypeVar("Wanted")

Paths = Sequence[Path | str] | Path | str


def path_of(value: Any, name: str) -> Path:
    """`value` as a path. Raises TypeError naming the argument `name` when it is none."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"{name}: expected a path (str or Path), found {quoted(value)}")
    return Path(value)


def paths_of(value: Any, name: str) -> list[Path]:
    """`value`, one path or several, as a list. Raises TypeError as `path_of` does."""
    if isinstance(value, str | os.PathLike):
        return [Path(value)]
    if not isinstance(value, Sequence):
        raise TypeError(f"{name}: expected a path or a sequence of paths, found {quoted(value)}")
    return [path_of(each, name) for each in value]


def instance_of(value: Any, kind: type[Wanted], name: str) -> Wanted:
    """`value` if it is of the kind. Raises TypeError naming the argument `name` otherwise."""
    if not isinstance(value, kind):
        raise TypeError(f"{name}: expected {kind.__name__}, found {quoted(value)}")
    return value

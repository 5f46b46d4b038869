"""Outputs that cannot or must not be written are refused before the work, not after it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from specmap_cli.core.errors import OUTPUT, UsageError

if TYPE_CHECKING:
    from specmap_cli.cli.options import Common


def check_files(
    outputs: Iterable[Path | None],
    inputs: Iterable[Path],
    common: Common,
    *,
    overwrite: bool = False,
) -> None:
    """Refuse files that exist (unless `overwrite`), whose place cannot be written, or that are
    needed: an input, or another output.

    What runs that were killed had begun to write in their places is removed, and told of. Raises
    UsageError naming the first file at fault; None stands for an output not asked for.
    """
    from specmap_cli.core.files import refuse_existing, remove_leftovers

    wanted = [path for path in outputs if path is not None]
    for path in wanted:
        if path.is_dir():
            raise UsageError("is a directory", "name the file to write", where=path)
        if os.path.lexists(path) and not path.is_file():
            raise UsageError("is no regular file", "choose another place", where=path, code=OUTPUT)
        if not overwrite:
            refuse_existing(path)
        if not path.parent.is_dir():
            raise UsageError(
                f"there is no directory {path.parent}", "make it first", where=path, code=OUTPUT
            )
        if not os.access(path.parent, os.W_OK):
            raise UsageError(
                f"cannot write in {path.parent}", "choose another place", where=path, code=OUTPUT
            )
    if len({path.resolve() for path in wanted}) < len(wanted):
        raise UsageError("given for two outputs: each needs a file of its own", where=wanted[0])
    keep_inputs(wanted, inputs)
    for output in wanted:
        with suppress(OSError):  # whoever writes the file is told of it
            for left in remove_leftovers(output):
                common.progress().note(
                    f"{output}: an earlier run was killed: removed {left.name}, which it had begun "
                    "to write"
                )


def files_of_maps(*directories: Path | None) -> list[Path]:
    """The files in map directories, which no output may replace; None stands for no map."""
    there = [one for one in directories if one is not None and one.is_dir()]
    return [path for one in there for path in one.rglob("*") if path.is_file()]


def keep_inputs(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Refuse outputs that are an input, or a directory with one inside: it would be lost."""
    needed = [path.resolve() for path in inputs]
    for output in outputs:
        place = output.resolve()
        for path in needed:
            if path == place or place in path.parents:
                raise UsageError(
                    f"would replace the input {path}", "choose another output", where=output
                )

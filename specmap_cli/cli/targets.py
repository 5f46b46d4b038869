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
    inputs: Iterable[Path | None],
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


def keep_inputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Refuse outputs that are an input, a directory with one inside, or a file of one that is a
    directory: it would be lost. None stands for an input that was not given. Raises UsageError.
    """
    needed = [path.resolve() for path in inputs if path is not None]
    for output in outputs:
        place = output.resolve()
        for path in needed:
            if path == place or place in path.parents or _is_file_of(place, path):
                raise UsageError(
                    f"would replace the input {path}", "choose another output", where=output
                )


def _is_file_of(file: Path, directory: Path) -> bool:
    """Whether a file belongs to a map, or lies anywhere in a directory that is none."""
    if directory not in file.parents or not file.is_file():
        return False
    from specmap_cli.maps.filenames import TOPOLOGY, is_of_a_map

    is_map = (directory / TOPOLOGY).is_file()
    return not is_map or is_of_a_map(file.relative_to(directory).as_posix())

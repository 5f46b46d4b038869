"""Where a run begins and ends: signals, the one place where errors become a line and an exit code.

It imports nothing that takes time, so that a signal is heeded from the first moment on.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from specmap_cli.cli.interruption import Interruption, interruptible
from specmap_cli.cli.streams import JSON_VARIABLE, discard_stdout, one_line, print_text
from specmap_cli.core.errors import (
    INTERRUPTED,
    MACHINE,
    MEMORY,
    InputError,
    SpecmapError,
    UsageError,
    is_of_the_machine,
    is_of_the_place,
    reason,
)

_YES = {"1", "true", "t", "yes", "y", "on"}  # as Typer reads a flag
_NO_TEMPORARY = "No usable temporary directory"  # how Python's own error begins
_OPENCV_NO_MEMORY = -4  # its code StsNoMem


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; without `arguments`, those of the process.

    An error is a line on stderr, and with `--json` an object on stdout, too. A bug is raised.
    """
    as_json = _asks_for_json(sys.argv[1:] if arguments is None else arguments)
    try:
        with interruptible(last=arguments is None):
            return _run(arguments, as_json)
    except Interruption as interruption:
        message = f"interrupted by {interruption.name}; nothing half-written is left"
        error = SpecmapError(message, code=INTERRUPTED)
        error.exit_code = interruption.exit_code
        return _fail(error, as_json)


def _asks_for_json(arguments: Sequence[str]) -> bool:
    """Whether `--json` is among the options, or asked for by the environment.

    What follows `--` are names of files.
    """
    options = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return "--json" in options or os.environ.get(JSON_VARIABLE, "").lower() in _YES


def _run(arguments: Sequence[str] | None, as_json: bool) -> int:
    from specmap_cli.cli.app import run

    try:
        code = run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:
        discard_stdout()
        return 0
    except Exception as error:
        told = _told(error)
        if told is None:
            _print_error(SpecmapError(f"a bug: {type(error).__name__}: {error}"), as_json)
            raise
        if isinstance(error, OSError):  # stdout itself may be full
            discard_stdout()
        return _fail(told, as_json)


def _told(error: Exception) -> SpecmapError | None:
    """What to say of an error that is no bug."""
    if isinstance(error, SpecmapError):
        return error
    if isinstance(error, OSError):
        told = _told_of_system(error)
        return None if told is None else UsageError(told, code=MACHINE)
    if isinstance(error, MemoryError) or _is_want_of_memory(error):
        what = f": {error}" if str(error) else ""
        message = (
            f"not enough memory{what}; a shorter log or a coarser grid "
            "(--set grid.resolution_m) needs less"
        )
        return InputError(message, code=MEMORY)
    return None


def _told_of_system(error: OSError) -> str | None:
    """What to say of what a machine runs out of: no bug, and no trace of it would help."""
    if (error.strerror or "").startswith(_NO_TEMPORARY):
        return f"{error.strerror}: free some space there, or set TMPDIR to another directory"
    if is_of_the_machine(error):
        return f"{error.filename}: {reason(error)}" if error.filename else reason(error)
    if is_of_the_place(error):
        advice = "write elsewhere"
        if _is_temporary(error.filename):
            advice = "set TMPDIR to another directory"
        return f"{error.filename or 'the output'}: cannot be written: {reason(error, advice)}"
    return None


def _is_temporary(name: object) -> bool:
    """Whether a file is in the directory for temporary files."""
    from tempfile import gettempdir

    return isinstance(name, str) and name.startswith(os.path.join(gettempdir(), ""))


def _is_want_of_memory(error: Exception) -> bool:
    """Whether OpenCV ran out of memory; it has an error of its own for it."""
    of_opencv = type(error).__module__ == "cv2"
    return of_opencv and getattr(error, "code", None) == _OPENCV_NO_MEMORY


def _fail(error: SpecmapError, as_json: bool) -> int:
    """One line on stderr, which may be closed or full: the exit code tells then."""
    _print_error(error, as_json)
    if sys.stderr is not None:
        with suppress(OSError):
            print(f"specmap: error: {one_line(str(error))}", file=sys.stderr)
    return error.exit_code


def _print_error(error: SpecmapError, as_json: bool) -> None:
    """The error as one object on stdout, when it is to be JSON: schemas/error.schema.json.

    It is one line, as `batch` prints lines.
    """
    if not as_json:
        return
    parts = {
        "code": error.code,
        "message": one_line(str(error)),
        "where": None if error.where is None else one_line(error.where),
        "hint": None if error.hint is None else one_line(error.hint),
        "exit_code": error.exit_code,
    }
    with suppress(OSError):
        text = json.dumps({"schema_version": 1, "error": parts}, ensure_ascii=False)
        print_text(text + "\n")

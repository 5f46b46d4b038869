"""Where a run begins and ends: signals, the one place where errors become a line and an exit code.

It imports nothing that takes time, so that a signal is heeded from the first moment on.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence

from specmap_cli.cli.interruption import Interruption, interruptible
from specmap_cli.errors import SpecmapError, UsageError

# What a machine runs out of; no fault of the program, and no trace of it would help.
_EXHAUSTED = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EMFILE}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the process's exit code."""
    try:
        with interruptible():
            return _run(arguments)
    except Interruption as interruption:
        return _fail(
            f"interrupted by {interruption.name}; nothing half-written is left",
            interruption.exit_code,
        )


def _run(arguments: Sequence[str] | None) -> int:
    from specmap_cli.cli.app import run

    try:
        code = run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except SpecmapError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        _discard_stdout()
        return 0
    except OSError as error:
        if error.errno not in _EXHAUSTED:
            raise
        _discard_stdout()
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}cannot write: {error.strerror}", UsageError.exit_code)


def _discard_stdout() -> None:
    """What is still buffered has nowhere to go: the interpreter must not try again at its exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _fail(message: str, code: int) -> int:
    line = " ".join(message.split())
    print(f"specmap: error: {line}", file=sys.stderr)
    return code

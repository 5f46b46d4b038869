"""Where a run begins and ends: signals, the one place where errors become a line and an exit code.

It imports nothing that takes time, so that a signal is heeded from the first moment on.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from specmap_cli.cli.interruption import Interruption, interruptible
from specmap_cli.cli.stdout import discard_stdout
from specmap_cli.core.errors import InputError, SpecmapError, UsageError

# The matrices here are small: threads of BLAS would wait for each other, and burn time doing so.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# What a machine runs out of; no fault of the program, and no trace of it would help.
_EXHAUSTED = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EMFILE}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; without `arguments`, those of the process."""
    try:
        with interruptible(last=arguments is None):
            return _run(arguments)
    except Interruption as interruption:
        return _fail(
            f"interrupted by {interruption.name}; nothing half-written is left",
            interruption.exit_code,
        )


def _run(arguments: Sequence[str] | None) -> int:
    for variable in _THREADS:  # read when numpy is loaded
        os.environ.setdefault(variable, "1")
    from specmap_cli.cli.app import run

    try:
        code = run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except SpecmapError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        discard_stdout()
        return 0
    except OSError as error:
        if error.errno not in _EXHAUSTED:
            raise
        discard_stdout()
        what = error.filename or "the output"
        return _fail(
            f"{what}: cannot be written: {error.strerror}; make room or write elsewhere",
            UsageError.exit_code,
        )
    except MemoryError as error:
        return _fail(
            f"not enough memory: {error}; a coarser grid (--set grid.resolution_m) needs less",
            InputError.exit_code,
        )


def _fail(message: str, code: int) -> int:
    """One line on stderr, which may be closed or full: the exit code tells then."""
    line = " ".join(message.split())
    if sys.stderr is not None:
        with suppress(OSError):
            print(f"specmap: error: {line}", file=sys.stderr)
    return code

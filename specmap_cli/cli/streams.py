"""Writing to stdout, where the results go, and lines for stderr."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from specmap_cli.core.text import legible

JSON_VARIABLE = "SPECMAP_JSON"  # in the environment: as `--json` on the command line


def print_text(text: str) -> None:
    """`text` on stdout; a reader that has seen enough, such as `head`, is no error.

    What the terminal cannot show, such as a file name of any bytes, is escaped.
    """
    try:
        try:
            print(text, end="", flush=True)
        except UnicodeEncodeError:
            encoding = sys.stdout.encoding
            shown = text.encode(encoding, "backslashreplace").decode(encoding)
            print(shown, end="", flush=True)
    except BrokenPipeError:
        discard_stdout()


def discard_stdout() -> None:
    """What is still buffered has nowhere to go: the interpreter must not try again at its exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError, AttributeError):  # closed, or no file at all
        os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def one_line(text: str) -> str:
    """`text` as one line: spaces for white space, escapes for what no terminal can show.

    That is control characters, which it would obey, and bytes of a file name that are no text.
    """
    return legible(" ".join(text.split()))

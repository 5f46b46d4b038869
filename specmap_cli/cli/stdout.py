"""Writing to stdout, where the results go, when the reader may leave early."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


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

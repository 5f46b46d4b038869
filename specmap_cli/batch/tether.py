"""Run a command that dies with the process that began it, however that one ends.

A script of its own, `python tether.py PARENT COMMAND...`: it asks the system for the signal, and
becomes the command. Linux only; elsewhere it just becomes the command. It imports nothing of
specmap, so that it costs some milliseconds.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG


def become(parent: int, command: list[str]) -> None:
    """Become `command`, unless the process `parent` is no more. Does not return."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it died before it could be told
            raise SystemExit(1)
    os.execv(command[0], command)


if __name__ == "__main__":
    become(int(sys.argv[1]), sys.argv[2:])

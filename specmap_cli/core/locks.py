"""Locks by which a run shows that it lives: the system lets go of them however the run ends."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def lock(descriptor: int) -> bool:
    """Take the lock of an open file or directory; False when somebody has it or there are none."""
    try:
        import fcntl  # not on every system
    except ImportError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def is_nobody_s(path: Path) -> bool:
    """Whether no living run holds a file or directory; where there are no locks, nobody can say."""
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        try:
            return lock(descriptor)
        finally:
            os.close(descriptor)
    return False

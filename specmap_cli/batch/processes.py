"""A process that is watched: its memory, its time, and that nothing of it is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import IO, Literal

from specmap_cli.batch import tether
from specmap_cli.core.errors import PACKAGE, UsageError

_LOOK_S = 0.05  # how often memory and time are looked at: some 20 microseconds each
_KIN_S = 1.0  # how often its children are looked for, which takes longer
_BYTES_PER_MB = 1e6


@dataclass(frozen=True, slots=True)
class Ended:
    """How a process ended: exit code (negative: the signal), seconds, megabytes seen at the most.

    `stopped` is the limit for which it was killed.
    """

    exit_code: int
    wall_s: float
    cpu_s: float
    memory_mb: float | None
    stopped: Literal["memory", "time"] | None = None


class GivenUpError(Exception):
    """Nobody wants the result of the process any more."""


def always() -> bool:
    """Whether the result is still wanted: it is."""
    return True


@dataclass(frozen=True, slots=True)
class Bounds:
    """Most megabytes of the process with its children, and when it must end (`time.monotonic`).

    `wanted` says whether anybody still waits for it; it is asked often.
    """

    memory_mb: float | None = None
    deadline: float | None = None
    wanted: Callable[[], bool] = always


def run_process(
    command: Sequence[str],
    folder: Path,
    stdout: IO[bytes],
    stderr: IO[bytes],
    environment: Mapping[str, str],
    bounds: Bounds,
) -> Ended:
    """Run a command in a folder, in a session of its own, and wait for its end.

    It is killed with all its children when it breaks a bound, when this function is left by an
    exception, and when this process ends. Raises GivenUpError when it is not wanted any more.
    """
    _need_psutil()
    began = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", tether.__file__, str(os.getpid()), *command],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        env=dict(environment),
        start_new_session=True,
    )
    tree = _Tree(process.pid)
    try:
        stopped = _watched(tree, bounds)
    finally:
        with suppress(OSError):  # nobody waited for it yet: the number is still its own
            os.killpg(process.pid, signal.SIGKILL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return Ended(
        exit_code=process.returncode,
        wall_s=time.monotonic() - began,
        cpu_s=usage.ru_utime + usage.ru_stime,
        memory_mb=tree.most_mb or None,
        stopped=stopped,
    )


def _watched(tree: _Tree, bounds: Bounds) -> Literal["memory", "time"] | None:
    """Wait until the process ends or breaks a bound: which one."""
    while not _has_ended(tree.pid):
        held = tree.look()
        if bounds.memory_mb is not None and held > bounds.memory_mb:
            return "memory"
        if bounds.deadline is not None and time.monotonic() > bounds.deadline:
            return "time"
        if not bounds.wanted():
            raise GivenUpError
        time.sleep(_LOOK_S)
    return None


def _need_psutil() -> None:
    try:
        import_module("psutil")
    except ImportError:
        raise UsageError(
            "jobs need an extra: pip install 'specmap-cli[batch]'", code=PACKAGE
        ) from None


def _has_ended(pid: int) -> bool:
    """Whether a child has ended; it is left as it is, so that its number stays its own."""
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


class _Tree:
    """A process and its children: the megabytes that they hold together."""

    def __init__(self, pid: int) -> None:
        import psutil

        self.pid = pid
        self.most_mb = 0.0
        self._gone = psutil.Error
        self._members = [psutil.Process(pid)]
        self._looked = time.monotonic()

    def look(self) -> float:
        """Megabytes now; those that have ended hold none."""
        if time.monotonic() - self._looked > _KIN_S:
            self._looked = time.monotonic()
            with suppress(self._gone):
                self._members[1:] = self._members[0].children(recursive=True)
        held = 0.0
        for member in self._members:
            with suppress(self._gone):
                held += member.memory_info().rss / _BYTES_PER_MB
        self.most_mb = max(self.most_mb, held)
        return held

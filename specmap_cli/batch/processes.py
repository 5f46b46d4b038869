"""One step of a job as a process: watched while it runs, and judged by how it ended."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

from specmap_cli.batch.records import EXTRA, Kind, Limits, Step, StepOutcome
from specmap_cli.core.errors import BROKEN_RULE, MACHINE, MEMORY
from specmap_cli.core.json_values import part_of
from specmap_cli.core.plugins import extra
from specmap_cli.core.text import legible

_WATCH_S = 0.05  # how often memory and time are looked at: some 20 microseconds each
_CHILDREN_S = 1.0  # how often its children are looked for, which takes longer
_BYTES_PER_MB = 1e6
# Run by Python as PARENT COMMAND...: it becomes the command, which on Linux dies with the process
# PARENT, however that one ends. It imports nothing of ours, so that it costs some milliseconds.
_TIED_TO_PARENT = """
import ctypes, os, signal, sys
parent, *command = sys.argv[1:]
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    if os.getppid() != int(parent):  # it died before it could be told
        raise SystemExit(1)
os.execv(command[0], command)
"""
_BY_CODE: Mapping[int, Kind] = {
    1: "bug",
    2: "settings",
    3: "log",
    4: "no-result",
    BROKEN_RULE: "rule",
    128 + signal.SIGINT: "worker",
    128 + signal.SIGTERM: "worker",
    -signal.SIGINT: "worker",
    -signal.SIGTERM: "worker",
    -signal.SIGKILL: "memory",
}
# Codes of errors that mean more than the exit code, and what the system says of a disk.
_BY_WORD: Mapping[str, Kind] = {MEMORY: "memory", MACHINE: "place"}
_NO_PLACE = tuple(os.strerror(one) for one in (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS))
_MOST_CHARACTERS = 1000  # of a reason
_MOST_WARNINGS = 20  # of a step; log.txt has them all


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


@dataclass(frozen=True, slots=True)
class Bounds:
    """The limits of a job, the end of its time (`time.monotonic`), and whether it is still wanted.

    `wanted` is asked often.
    """

    limits: Limits
    deadline: float
    wanted: Callable[[], bool]


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
    psutil = extra("psutil", EXTRA, "jobs need an extra")  # before there is a process
    began = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _TIED_TO_PARENT, str(os.getpid()), *command],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        env=dict(environment),
        start_new_session=True,
    )
    tree = _Tree(process.pid, psutil)
    stopped: Literal["memory", "time"] | None = None
    try:
        # WNOWAIT leaves a child that has ended as it is, so that its number stays its own
        while not os.waitid(os.P_PID, tree.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            held = tree.measure()
            if bounds.limits.memory_mb is not None and held > bounds.limits.memory_mb:
                stopped = "memory"
                break
            if time.monotonic() > bounds.deadline:
                stopped = "time"
                break
            if not bounds.wanted():
                raise GivenUpError
            time.sleep(_WATCH_S)
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


class _Tree:
    """A process and its children: the megabytes that they hold together."""

    def __init__(self, pid: int, psutil: Any) -> None:
        self.pid = pid
        self.most_mb = 0.0
        self._gone = psutil.Error
        self._members = [psutil.Process(pid)]
        self._searched = time.monotonic()

    def measure(self) -> float:
        """Megabytes now; those that have ended hold none."""
        if time.monotonic() - self._searched > _CHILDREN_S:
            self._searched = time.monotonic()
            with suppress(self._gone):
                self._members[1:] = self._members[0].children(recursive=True)
        held = 0.0
        for member in self._members:
            with suppress(self._gone):
                held += member.memory_info().rss / _BYTES_PER_MB
        self.most_mb = max(self.most_mb, held)
        return held


def judged(
    step: Step, ended: Ended, answer: Path, log: bytes, limits: Limits, places: Mapping[str, str]
) -> tuple[StepOutcome, Kind | None]:
    """What came of a step, and what kind of failure.

    `answer` is the file of what it printed, `log` what it told besides. `places` has where each log
    was fetched to: a person knows the log by its own name.
    """
    try:
        told = json.loads(answer.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        told = None
    told = told if isinstance(told, dict) else {}

    def with_logs_named(text: str) -> str:
        for log_, path in places.items():
            text = text.replace(path, log_)
        return text

    kind: Kind | None = None
    reason = None
    if ended.exit_code != 0:
        reason = _reason(step, ended, told, log, limits)
        code = part_of(told, "error").get("code")
        if ended.stopped is not None:
            kind = ended.stopped
        elif isinstance(code, str) and code in _BY_WORD:
            kind = _BY_WORD[code]
        elif any(words in reason for words in _NO_PLACE):
            kind = "place"
        else:
            kind = _BY_CODE.get(ended.exit_code, "bug")
    said = told.get("warnings")
    warnings = [each for each in said if isinstance(each, str)] if isinstance(said, list) else []
    outcome = StepOutcome(
        command=step.command,
        exit_code=ended.exit_code,
        wall_s=ended.wall_s,
        cpu_s=ended.cpu_s,
        memory_mb=ended.memory_mb,
        reason=None if reason is None else with_logs_named(reason),
        warnings=tuple(
            with_logs_named(legible(each)[:_MOST_CHARACTERS]) for each in warnings[:_MOST_WARNINGS]
        ),
    )
    return outcome, kind


def _reason(step: Step, ended: Ended, told: Mapping[str, Any], log: bytes, limits: Limits) -> str:
    """Why a step failed, in a line."""
    if ended.stopped == "memory":
        return f"{step.command} needed more than {limits.memory_mb:,} MB of memory, the limit"
    if ended.stopped == "time":
        return f"the job took more than {limits.time_s:g} s, the limit; it was in {step.command}"
    if ended.exit_code == BROKEN_RULE:
        rules = told.get("rules")
        if isinstance(rules, list):
            broken = [str(rule.get("rule")) for rule in rules if not rule.get("passed")]
            return legible(f"breaks {len(broken)} of {len(rules)} rules: {', '.join(broken)}")
        verdict = part_of(told, "quality").get("verdict", "doubtful or poor")
        return f"{step.command}: the map is {verdict}"
    message = part_of(told, "error").get("message")
    if isinstance(message, str) and message:
        return legible(message)[:_MOST_CHARACTERS]
    if ended.exit_code == -signal.SIGKILL:
        return f"{step.command} was killed, as a system does for want of memory"
    if ended.exit_code < 0:
        names = {one.value: one.name for one in signal.Signals}
        number = -ended.exit_code
        return f"{step.command} was ended by {names.get(number, f'signal {number}')}"
    lines = log.decode("utf-8", "backslashreplace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    said = legible(last.removeprefix("specmap: error: "))[:_MOST_CHARACTERS]
    return said or f"{step.command} ended with exit code {ended.exit_code}"

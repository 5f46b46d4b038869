"""What came of a step: done or failed, what kind of failure, and why in a line."""

from __future__ import annotations

import errno
import json
import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from specmap_cli.batch.processes import Ended
from specmap_cli.batch.records import JobRecord, Kind, Limits, Step, StepOutcome
from specmap_cli.core.errors import BROKEN_RULE, MACHINE, MEMORY
from specmap_cli.core.text import legible

MOST_ATTEMPTS = 2
_RETRIED: frozenset[Kind] = frozenset({"memory", "worker", "place"})
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


def may_retry(result: JobRecord, attempts: int = MOST_ATTEMPTS) -> bool:
    """Whether another one of `attempts` may succeed: after want of memory, a lost worker or place.

    A log stays bad, a rule stays broken and a setting stays wrong.
    """
    return result.kind in _RETRIED and result.attempts < attempts


def stands(stored: JobRecord, digest: str, limits: Limits, attempt: int) -> bool:
    """Whether a result that is there need not be made again.

    It is of the same inputs, settings and version; and if it failed, the same would happen again:
    nothing has changed that it failed for, and it was not to be tried once more.
    """
    if not digest or stored.digest != digest:
        return False
    if stored.kind in ("worker", "place"):
        return False
    if stored.kind == "memory":
        more = _more(limits.memory_mb, stored.limits.memory_mb)
        return not more and stored.attempts >= attempt
    if stored.kind == "time":
        return not _more(limits.time_s, stored.limits.time_s)
    return True


def _more(limit: float | None, than: float | None) -> bool:
    """Whether a limit is wider than another one; None is none."""
    return than is not None and (limit is None or limit > than)


def judged(
    step: Step, ended: Ended, answer: Path, log: bytes, limits: Limits
) -> tuple[StepOutcome, Kind | None]:
    """What came of a step; `answer` is the file of what it printed, `log` what it told besides."""
    told = _answer(answer)
    reason = None if ended.exit_code == 0 else _reason(step, ended, told, log, limits)
    outcome = StepOutcome(
        command=step.command,
        exit_code=ended.exit_code,
        wall_s=ended.wall_s,
        cpu_s=ended.cpu_s,
        memory_mb=ended.memory_mb,
        reason=reason,
        warnings=_warnings(told),
    )
    return outcome, None if reason is None else _kind(ended, told, reason)


def _kind(ended: Ended, told: Mapping[str, Any], reason: str) -> Kind:
    if ended.stopped is not None:
        return ended.stopped
    error = told.get("error")
    code = error.get("code") if isinstance(error, dict) else None
    if isinstance(code, str) and code in _BY_WORD:
        return _BY_WORD[code]
    if any(words in reason for words in _NO_PLACE):
        return "place"
    return _BY_CODE.get(ended.exit_code, "bug")


def _reason(step: Step, ended: Ended, told: Mapping[str, Any], log: bytes, limits: Limits) -> str:
    """Why a step failed, in a line."""
    if ended.stopped == "memory":
        return f"{step.command} needed more than {limits.memory_mb:,} MB of memory, the limit"
    if ended.stopped == "time":
        return f"the job took more than {limits.time_s:g} s, the limit; it was in {step.command}"
    if ended.exit_code == BROKEN_RULE:
        return _broken(step, told)
    error = told.get("error")
    message = error.get("message") if isinstance(error, dict) else None
    if isinstance(message, str) and message:
        return legible(message)[:_MOST_CHARACTERS]
    if ended.exit_code == -signal.SIGKILL:
        return f"{step.command} was killed, as a system does for want of memory"
    if ended.exit_code < 0:
        return f"{step.command} was ended by {_signal(-ended.exit_code)}"
    lines = log.decode("utf-8", "backslashreplace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    said = legible(last.removeprefix("specmap: error: "))[:_MOST_CHARACTERS]
    return said or f"{step.command} ended with exit code {ended.exit_code}"


def _broken(step: Step, told: Mapping[str, Any]) -> str:
    """Which rules the map breaks."""
    rules = told.get("rules")
    if isinstance(rules, list):
        broken = [str(rule.get("rule")) for rule in rules if not rule.get("passed")]
        return legible(f"breaks {len(broken)} of {len(rules)} rules: {', '.join(broken)}")
    quality = told.get("quality")
    verdict = quality.get("verdict") if isinstance(quality, dict) else "doubtful or poor"
    return f"{step.command}: the map is {verdict}"


def _warnings(told: Mapping[str, Any]) -> tuple[str, ...]:
    """What the step warned of, as it printed it."""
    said = told.get("warnings")
    texts = [each for each in said if isinstance(each, str)] if isinstance(said, list) else []
    return tuple(legible(each)[:_MOST_CHARACTERS] for each in texts[:_MOST_WARNINGS])


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _answer(path: Path) -> dict[str, Any]:
    """The object that a step printed; empty when it printed none."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}

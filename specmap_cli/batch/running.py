"""What a worker does with one job: run its steps, and leave a complete result or none.

It needs no Dask and no client: all that is to be known of a job is in its arguments and in the
output. Killed at any instant, it leaves a complete result or none; what it had begun is removed by
the next run.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import specmap_cli
from specmap_cli import __version__
from specmap_cli.batch.jobs import arguments_of
from specmap_cli.batch.places import (
    PlaceError,
    files_in,
    folder_at,
    scratch_directory,
    write_record,
)
from specmap_cli.batch.processes import Bounds, judged, run_process
from specmap_cli.batch.records import (
    LOG_TEXT,
    MAP,
    InputRecord,
    JobRecord,
    JobResult,
    Kind,
    Limits,
    Step,
    StepOutcome,
    Terms,
    Turn,
)
from specmap_cli.batch.sources import digest_of, fetched, inputs_of
from specmap_cli.checking.rules import figures_of
from specmap_cli.core.errors import LogError, MapError, SpecmapError, UsageError
from specmap_cli.core.text import one_line
from specmap_cli.maps.store import read_map

PROGRAM = (sys.executable, "-P", "-m", "specmap_cli")
_RETRIED: frozenset[Kind] = frozenset({"memory", "worker", "place"})
# A worker is one process on one processor: the other processors have workers of their own.
_ONE_PROCESSOR = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    "SPECMAP_PROCESSES": "1",
}
_INSTALLED = ("site-packages", "dist-packages")
_TAIL_BYTES = 65536  # of what a step told: its reason is looked for there


def run_job(turn: Turn, terms: Terms, wanted: Callable[[], bool] = lambda: True) -> JobResult:
    """Run a job, its result going to OUTPUT/NAME; a complete one that stands is not made again.

    What a job may meet is no exception but a result with the state `failed`. Its record is in no
    file where the output cannot be used, and where the inputs cannot be read and an earlier result
    is complete: that one stays. Raises GivenUpError when the job is not `wanted` any more; nothing
    of it is left then.
    """
    job, this = turn.job, _Attempt(turn, terms.limits)
    try:
        folder = folder_at(terms.output, job.name)
        inputs, digest, refused = tuple[InputRecord, ...](), "", None
        try:
            found = inputs_of(job)
            inputs, digest = found, digest_of(job, __version__, found)
        except SpecmapError as error:
            refused = this.refused(error)
        stored = folder.stored()
        if stored is not None:
            if not terms.redo and stands(stored, digest, terms.limits, turn.attempt):
                return JobResult(stored, resumed=True)
            if refused is not None and stored.state == "done":
                return JobResult(refused)
        if (edits := folder.edited()) is not None:
            raise UsageError(
                "holds a person's decisions, which a new map would lose",
                "move the map away, and name it as `like` of build to keep them",
                where=edits,
            )
        with scratch_directory(terms.scratch) as scratch, folder.fresh(scratch) as directory:
            record = refused or work_on(this, directory, scratch, wanted)
            known = {"inputs": inputs, "digest": digest, "files": files_in(directory)}
            record = record.model_copy(update=known)
            write_record(directory, record)
        return JobResult(record)
    except (SpecmapError, OSError) as error:
        return JobResult(this.refused(error))


def worker_lost(turn: Turn, reason: str, limits: Limits) -> JobResult:
    """The result of a job whose worker was lost: nothing is left of it. It is in no file."""
    return JobResult(_Attempt(turn, limits).record("worker", reason))


def may_retry(record: JobRecord, attempts: int) -> bool:
    """Whether another one of `attempts` may succeed: after want of memory, a lost worker or place.

    A log stays bad, a rule stays broken and a setting stays wrong.
    """
    return record.kind in _RETRIED and record.attempts < attempts


def stands(stored: JobRecord, digest: str, limits: Limits, attempt: int) -> bool:
    """Whether a result that is there need not be made again.

    It is of the same inputs, settings and version; and if it failed, the same would happen again:
    nothing has changed that it failed for, and it was not to be tried once more.
    """
    if not digest or stored.digest != digest or stored.kind in ("worker", "place"):
        return False
    if stored.kind == "memory":
        more = _wider(limits.memory_mb, stored.limits.memory_mb)
        return not more and stored.attempts >= attempt
    return stored.kind != "time" or not _wider(limits.time_s, stored.limits.time_s)


def _wider(limit: float | None, than: float | None) -> bool:
    """Whether a limit is wider than another one; None is none."""
    return than is not None and (limit is None or limit > than)


class _Attempt:
    """One attempt at a job, which begins now."""

    def __init__(self, turn: Turn, limits: Limits) -> None:
        self.turn = turn
        self.limits = limits
        self._started_utc = datetime.now(UTC).isoformat()
        self._began = time.monotonic()

    def refused(self, error: SpecmapError | OSError) -> JobRecord:
        """The record of a job that could not be begun."""
        kind: Kind = "settings"
        if isinstance(error, LogError):
            kind = "log"
        elif isinstance(error, PlaceError | OSError) or isinstance(error.__context__, OSError):
            kind = "place"  # the system refused to write, or a store did
        return self.record(kind, str(error))

    def record(
        self,
        kind: Kind | None,
        reason: str | None,
        steps: Sequence[StepOutcome] = (),
        figures: Mapping[str, float | str | None] = {},
    ) -> JobRecord:
        """What came of it: `kind` and `reason` of the first failure, None of none."""
        held = [step.memory_mb for step in steps if step.memory_mb is not None]
        return JobRecord(
            schema_version=1,
            name=self.turn.job.name,
            digest="",
            version=__version__,
            state="done" if kind is None else "failed",
            kind=kind,
            reason=None if reason is None else one_line(reason),
            attempts=self.turn.attempt,
            limits=self.limits,
            started_utc=self._started_utc,
            wall_s=time.monotonic() - self._began,
            cpu_s=sum(step.cpu_s for step in steps),
            memory_mb=max(held, default=None),
            steps=tuple(steps),
            figures=dict(figures),
            inputs=(),
            files={},
        )


def work_on(
    this: _Attempt, directory: Path, scratch: Path, wanted: Callable[[], bool]
) -> JobRecord:
    """Run the steps of a job, their results going to `directory`.

    A broken rule lets the steps after it run; any other failure ends the job. Fetched logs and
    temporary files go to `scratch`.
    """
    job, limits = this.turn.job, this.limits
    end_of_time = time.monotonic() + (math.inf if limits.time_s is None else limits.time_s)
    bounds = Bounds(limits, end_of_time, wanted)
    temporary, logs = scratch / "tmp", scratch / "logs"
    temporary.mkdir()
    logs.mkdir()
    (directory / LOG_TEXT).touch()
    try:
        places = fetched(job.logs, logs)
    except (LogError, PlaceError) as error:
        return this.refused(error)
    outcomes: list[StepOutcome] = []
    kind: Kind | None = None
    for step in job.steps:
        outcome, failed = _run_step(step, directory, places, _environment(temporary), bounds)
        outcomes.append(outcome)
        kind = kind or failed
        if failed not in (None, "rule"):
            kind = failed
            break
    reasons = [each.reason for each in outcomes if each.reason is not None]
    # what ended the job counts more than a rule that was broken before
    reason = None if kind is None else reasons[0] if kind == "rule" else reasons[-1]
    try:
        stored = read_map(directory / MAP)
        figures: dict[str, float | str | None] = {**figures_of(stored), "verdict": stored.verdict}
    except MapError:
        figures = {}
    return this.record(kind, reason, outcomes, figures)


def _run_step(
    step: Step,
    directory: Path,
    places: Mapping[str, str],
    environment: Mapping[str, str],
    bounds: Bounds,
) -> tuple[StepOutcome, Kind | None]:
    """Run one step: its answer goes to `STEP.json`, all else that it says to log.txt."""
    arguments = arguments_of(step, list(places.values()))
    log_text, answer = directory / LOG_TEXT, directory / f"{step.command}.json"
    with log_text.open("ab") as log, answer.open("wb") as stdout:
        log.write(f"$ specmap {' '.join(arguments)}\n".encode("utf-8", "backslashreplace"))
        log.flush()
        begin = log.tell()
        command = [*PROGRAM, *arguments]
        ended = run_process(command, directory, stdout, log, environment, bounds)
    for begun in directory.glob(".*"):  # left by a step that was killed
        if begun.is_dir() and not begun.is_symlink():
            shutil.rmtree(begun)
        else:
            begun.unlink()
    with log_text.open("rb") as log:
        log.seek(max(begin, log_text.stat().st_size - _TAIL_BYTES))
        said = log.read()
    outcome, kind = judged(step, ended, answer, said, bounds.limits, places)
    if kind not in (None, "rule"):
        answer.unlink()
    return outcome, kind


def _environment(temporary: Path) -> dict[str, str]:
    """The environment of a step: one processor, own temporary files, no SPECMAP_ variables."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SPECMAP_")}
    found = {**kept, **_ONE_PROCESSOR, "TMPDIR": str(temporary)}
    root = Path(specmap_cli.__file__).parent.parent
    if root.name not in _INSTALLED:  # run from its sources: a step must find them, too
        found["PYTHONPATH"] = os.pathsep.join(
            [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
    return found

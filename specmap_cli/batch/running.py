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
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import specmap_cli
from specmap_cli import __version__
from specmap_cli.batch.outputs import files_in, folder_at, write_record
from specmap_cli.batch.places import PlaceError, scratch_directory
from specmap_cli.batch.processes import Bounds, judged, run_process
from specmap_cli.batch.records import (
    InputRecord,
    Job,
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
from specmap_cli.batch.steps import LOG_TEXT, MAP, arguments_of
from specmap_cli.checking.figures import figures_of
from specmap_cli.core.errors import LogError, MapError, SpecmapError, UsageError
from specmap_cli.core.text import legible
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
        known = _known(job)
        stored = folder.stored()
        if stored is not None:
            if not terms.redo and stands(stored, known.digest, terms.limits, turn.attempt):
                return JobResult(stored, resumed=True)
            if known.refused is not None and stored.state == "done":
                return JobResult(this.record(known.refused, known))
        if (edits := folder.edited()) is not None:
            raise UsageError(
                "holds a person's decisions, which a new map would lose",
                "move the map away, and name it as `like` of build to keep them",
                where=edits,
            )
        with scratch_directory(terms.scratch) as scratch, folder.fresh(scratch) as directory:
            work = known.refused or work_on(job, directory, scratch, terms.limits, wanted)
            record = this.record(work, known, files_in(directory))
            write_record(directory, record)
        return JobResult(record)
    except (SpecmapError, OSError) as error:
        return JobResult(this.record(_refusal(error)))


def failure(turn: Turn, kind: Kind, reason: str, limits: Limits) -> JobResult:
    """The result of a job of which nothing is left: its worker was lost. It is in no file."""
    return JobResult(_Attempt(turn, limits).record(_Work(kind=kind, reason=reason)))


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


@dataclass(frozen=True, slots=True)
class _Work:
    """What came of the steps of a job: `kind` and `reason` of the first failure, None of none."""

    steps: tuple[StepOutcome, ...] = ()
    kind: Kind | None = None
    reason: str | None = None
    figures: Mapping[str, float | str | None] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Known:
    """What is known of a job before its steps are run; `refused` is why they cannot be."""

    inputs: tuple[InputRecord, ...] = ()
    digest: str = ""
    refused: _Work | None = None


def _known(job: Job) -> _Known:
    try:
        inputs = inputs_of(job)
        return _Known(inputs, digest_of(job, __version__, inputs))
    except SpecmapError as error:
        return _Known(refused=_refusal(error))


def _refusal(error: SpecmapError | OSError) -> _Work:
    """The work on a job that could not be begun."""
    kind: Kind = "settings"
    if isinstance(error, LogError):
        kind = "log"
    elif isinstance(error, PlaceError | OSError) or isinstance(error.__context__, OSError):
        kind = "place"  # the system refused to write, or a store did
    return _Work(kind=kind, reason=str(error))


class _Attempt:
    """One attempt at a job, which begins now."""

    def __init__(self, turn: Turn, limits: Limits) -> None:
        self._turn = turn
        self._limits = limits
        self._started_utc = datetime.now(UTC).isoformat()
        self._began = time.monotonic()

    def record(
        self, work: _Work, known: _Known = _Known(), files: Mapping[str, int] | None = None
    ) -> JobRecord:
        """What came of it."""
        held = [step.memory_mb for step in work.steps if step.memory_mb is not None]
        return JobRecord(
            schema_version=1,
            name=self._turn.job.name,
            digest=known.digest,
            version=__version__,
            state="done" if work.kind is None else "failed",
            kind=work.kind,
            reason=None if work.reason is None else legible(" ".join(work.reason.split())),
            attempts=self._turn.attempt,
            limits=self._limits,
            started_utc=self._started_utc,
            wall_s=time.monotonic() - self._began,
            cpu_s=sum(step.cpu_s for step in work.steps),
            memory_mb=max(held, default=None),
            steps=work.steps,
            figures=dict(work.figures),
            inputs=known.inputs,
            files=dict(files or {}),
        )


def work_on(
    job: Job, directory: Path, scratch: Path, limits: Limits, wanted: Callable[[], bool]
) -> _Work:
    """Run the steps of a job, their results going to `directory`.

    A broken rule lets the steps after it run; any other failure ends the job. Fetched logs and
    temporary files go to `scratch`.
    """
    end_of_time = time.monotonic() + (math.inf if limits.time_s is None else limits.time_s)
    bounds = Bounds(limits, end_of_time, wanted)
    environment = _environment(_made(scratch / "tmp"))
    (directory / LOG_TEXT).touch()
    try:
        places = fetched(job.logs, _made(scratch / "logs"))
    except (LogError, PlaceError) as error:
        return _refusal(error)
    outcomes: list[StepOutcome] = []
    kind: Kind | None = None
    for step in job.steps:
        outcome, failed = _run_step(step, directory, places, environment, bounds)
        outcomes.append(outcome)
        kind = kind or failed
        if failed not in (None, "rule"):
            kind = failed
            break
    reasons = [each.reason for each in outcomes if each.reason is not None]
    # what ended the job counts more than a rule that was broken before
    reason = None if kind is None else reasons[0] if kind == "rule" else reasons[-1]
    return _Work(tuple(outcomes), kind, reason, _figures(directory / MAP))


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
    _remove_unfinished(directory.glob(".*"))
    with log_text.open("rb") as log:
        log.seek(max(begin, log_text.stat().st_size - _TAIL_BYTES))
        said = log.read()
    outcome, kind = judged(step, ended, answer, said, bounds.limits, places)
    if kind not in (None, "rule"):
        answer.unlink()
    return outcome, kind


def _figures(path: Path) -> dict[str, float | str | None]:
    """The figures of the map that was built, with its verdict."""
    try:
        stored = read_map(path)
        quality = stored.record.graph.quality
        return {**figures_of(stored), "verdict": None if quality is None else quality.verdict}
    except MapError:
        return {}


def _environment(temporary: Path) -> dict[str, str]:
    """The environment of a step: this one, with a processor and temporary files of its own.

    What SPECMAP_ variables a worker happens to have must not change a result.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SPECMAP_")}
    found = {**kept, **_ONE_PROCESSOR, "TMPDIR": str(temporary)}
    root = Path(specmap_cli.__file__).parent.parent
    if root.name not in _INSTALLED:  # run from its sources: a step must find them, too
        found["PYTHONPATH"] = os.pathsep.join(
            [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
    return found


def _remove_unfinished(paths: Iterable[Path]) -> None:
    """Remove what a step that was killed had begun to write: its names begin with a dot."""
    for path in paths:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _made(directory: Path) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    return directory

"""The work on a job: logs fetched, steps run one after the other, the figures of the map read."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import specmap_cli
from specmap_cli.batch.fetching import fetched
from specmap_cli.batch.outcomes import judged
from specmap_cli.batch.places import PlaceError
from specmap_cli.batch.processes import Bounds, always, run_process
from specmap_cli.batch.records import Job, Kind, Limits, Step, StepOutcome
from specmap_cli.batch.steps import LOG_TEXT, MAP, arguments_of
from specmap_cli.checking.figures import figures_of
from specmap_cli.core.errors import LogError, MapError
from specmap_cli.maps.store import read_map

PROGRAM = (sys.executable, "-P", "-m", "specmap_cli")
# A worker is one process on one processor: the other processors have workers of their own.
_ALONE = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    "SPECMAP_PROCESSES": "1",
}
_INSTALLED = ("site-packages", "dist-packages")


@dataclass(frozen=True, slots=True)
class Work:
    """What came of the steps of a job: `kind` and `reason` of the first failure, None of none."""

    steps: tuple[StepOutcome, ...] = ()
    kind: Kind | None = None
    reason: str | None = None
    figures: Mapping[str, float | str | None] = field(default_factory=dict)


def work_on(
    job: Job,
    directory: Path,
    scratch: Path,
    limits: Limits,
    wanted: Callable[[], bool] = always,
) -> Work:
    """Run the steps of a job, their results going to `directory`.

    A broken rule lets the steps after it run; any other failure ends the job. Fetched logs and
    temporary files go to `scratch`.
    """
    bench = _Bench(job, directory, scratch, limits, wanted)
    try:
        with bench.log_text.open("wb"):
            places = fetched(job.logs, _made(scratch / "logs"))
    except LogError as error:
        return Work(kind="log", reason=str(error))
    except PlaceError as error:
        return Work(kind="place", reason=str(error))
    return bench.run(places)


class _Bench:
    """Where the steps of one job are run, and until when."""

    def __init__(
        self,
        job: Job,
        directory: Path,
        scratch: Path,
        limits: Limits,
        wanted: Callable[[], bool],
    ) -> None:
        self.log_text = directory / LOG_TEXT
        self._job = job
        self._directory = directory
        self._limits = limits
        deadline = None if limits.time_s is None else time.monotonic() + limits.time_s
        self._bounds = Bounds(limits.memory_mb, deadline, wanted)
        self._environment = _environment(_made(scratch / "tmp"))

    def run(self, places: Mapping[str, str]) -> Work:
        """Run the steps; `places` has the path of each log."""
        outcomes: list[StepOutcome] = []
        kind: Kind | None = None
        for step in self._job.steps:
            outcome, failed = self._step(step, list(places.values()))
            outcomes.append(_with_logs_named(outcome, places))
            kind = kind or failed
            if failed not in (None, "rule"):
                kind = failed
                break
        reasons = [each.reason for each in outcomes if each.reason is not None]
        # what ended the job counts more than a rule that was broken before
        reason = None if kind is None else reasons[0] if kind == "rule" else reasons[-1]
        return Work(tuple(outcomes), kind, reason, self._figures())

    def _step(self, step: Step, logs: list[str]) -> tuple[StepOutcome, Kind | None]:
        """Run one step: its answer goes to `STEP.json`, all else that it says to log.txt."""
        arguments = arguments_of(step, logs)
        answer = self._directory / f"{step.command}.json"
        with self.log_text.open("ab") as log, answer.open("wb") as stdout:
            log.write(f"$ specmap {' '.join(arguments)}\n".encode("utf-8", "backslashreplace"))
            log.flush()
            begin = log.tell()
            ended = run_process(
                [*PROGRAM, *arguments],
                self._directory,
                stdout,
                log,
                self._environment,
                self._bounds,
            )
        _clear(self._directory)
        outcome, kind = judged(step, ended, answer, self._said(begin), self._limits)
        if kind not in (None, "rule"):
            answer.unlink()
        return outcome, kind

    def _said(self, begin: int) -> bytes:
        """What stands in log.txt from a byte on, its end at the most."""
        with self.log_text.open("rb") as log:
            log.seek(max(begin, self.log_text.stat().st_size - 65536))
            return log.read()

    def _figures(self) -> dict[str, float | str | None]:
        """The figures of the map that was built, with its verdict."""
        try:
            stored = read_map(self._directory / MAP)
            quality = stored.record.graph.quality
            verdict = None if quality is None else quality.verdict
            return {**figures_of(stored), "verdict": verdict}
        except MapError:
            return {}


def _with_logs_named(outcome: StepOutcome, places: Mapping[str, str]) -> StepOutcome:
    """The same with logs called as the user calls them, not by where they were fetched to."""

    def named(text: str) -> str:
        for log, path in places.items():
            text = text.replace(path, log)
        return text

    reason = None if outcome.reason is None else named(outcome.reason)
    warnings = tuple(named(each) for each in outcome.warnings)
    return outcome.model_copy(update={"reason": reason, "warnings": warnings})


def _environment(temporary: Path) -> dict[str, str]:
    """The environment of a step: this one, with a processor and temporary files of its own.

    What SPECMAP_ variables a worker happens to have must not change a result.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SPECMAP_")}
    found = {**kept, **_ALONE, "TMPDIR": str(temporary)}
    root = Path(specmap_cli.__file__).parent.parent
    if root.name not in _INSTALLED:  # run from its sources: a step must find them, too
        found["PYTHONPATH"] = os.pathsep.join(
            [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
    return found


def _clear(directory: Path) -> None:
    """Remove what a step that was killed had begun to write: its names begin with a dot."""
    for path in directory.glob(".*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _made(directory: Path) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    return directory

"""Results of jobs that never ran, for tests of what is done with them."""

import os
import signal
import sys
from typing import Any
from unittest.mock import Mock

import pytest

from specmap_cli.batch import running
from specmap_cli.batch.records import Job, JobRecord, JobResult, Limits, Step, Terms, Turn
from specmap_cli.core.errors import MapError
from tests.batch import fake_specmap

ALL = (Step("build"), Step("report"), Step("check"))

FIGURES: dict[str, float | str | None] = {
    **{"verdict": "good", "lost_share": 0.0125, "submaps": 7},
    **{"area_m2": 123.456, "path_m": 45.678, "scans": 900},
}


def job(name: str) -> Job:
    return Job(name, (f"/logs/{name}.mcap",), (Step("build"),))


def result(name: str, **changes: Any) -> JobRecord:
    """A job that went well, but for the changes."""
    files = ("map/overview.png", "map/topology.json", "report.html", "log.txt")
    return JobRecord.model_validate(
        {
            **{"schema_version": 1, "name": name, "digest": "d" * 64, "version": "0.1.0"},
            **{"state": "done", "kind": None, "reason": None, "attempts": 1, "steps": ()},
            **{"limits": Limits(memory_mb=1000), "started_utc": "2026-01-01T00:00:00+00:00"},
            **{"wall_s": 18.0, "cpu_s": 17.0, "memory_mb": 300.5, "figures": FIGURES},
            "inputs": ({"log": f"/logs/{name}.mcap", "bytes": 1, "identity": "1"},),
            "files": dict.fromkeys(files, 1),
            **changes,
        }
    )


def warned(name: str, *warnings: str) -> JobRecord:
    """A job that went well, whose steps build and report both warned of something."""
    cost = {"exit_code": 0, "wall_s": 1.0, "cpu_s": 1.0, "memory_mb": 100.0}
    steps = [
        {"command": command, **cost, "reason": None, "warnings": warnings}
        for command in ("build", "report")
    ]
    return result(name, steps=tuple(steps))


def failed(name: str, kind: str = "log", reason: str = "holds no scans", **more: Any) -> JobRecord:
    nothing = {"figures": {}, "files": {"log.txt": 1}, "memory_mb": None}
    return result(name, state="failed", kind=kind, reason=reason, **(nothing | more))


def faked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fake program in the place of specmap; its maps are none."""
    monkeypatch.setattr(running, "PROGRAM", (sys.executable, "-I", "-S", fake_specmap.__file__))
    no_map = Mock(side_effect=MapError("no map: of the fake program"))
    monkeypatch.setattr(running, "read_map", no_map)


def at_once(turn: Turn, terms: Terms, _: object) -> JobResult:
    """In the place of `on_worker` or `run_job`: does what the name of the job asks for."""
    name = turn.job.name
    if name.startswith("deadly") and turn.attempt == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("buggy"):
        raise ValueError("a bug of the worker")
    limit = Limits(memory_mb=terms.limits.memory_mb)
    if name.startswith("hungry") and not turn.alone:
        record = failed(name, "memory", "too much", limits=limit, attempts=turn.attempt)
    elif name.startswith("bad"):
        record = failed(name, attempts=turn.attempt)
    else:
        record = result(name, attempts=turn.attempt, limits=limit)
    return JobResult(record)

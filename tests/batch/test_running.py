"""What a worker does with a job: done, done already, failed in every way, and killed."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import shutil
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import jsonschema
import pytest

from specmap_cli.batch import processes, work
from specmap_cli.batch.digest import digest_of, inputs_of
from specmap_cli.batch.folders import folder_at
from specmap_cli.batch.jobs import jobs_of
from specmap_cli.batch.records import (
    Job,
    JobResult,
    Limits,
    Plan,
    Step,
)
from specmap_cli.batch.running import failure, may_retry, run_job
from specmap_cli.cli.batch import known_options
from specmap_cli.core.schemas import read_schema
from specmap_cli.core.text import to_json
from tests.batch import fake_specmap
from tests.cli.conftest import QUICK

pytest.importorskip("psutil")

ALL = tuple(Step(command) for command in ("build", "report", "check"))
Run = Callable[..., JobResult]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The fake program in the place of specmap; the file has a line for each of its builds."""
    program = (sys.executable, "-I", "-S", fake_specmap.__file__)
    monkeypatch.setattr(work, "PROGRAM", program)
    monkeypatch.setattr(work, "read_map", _no_map)
    monkeypatch.setattr(processes, "_LOOK_S", 0.01)  # its steps are short
    monkeypatch.setenv("FAKE_NOTE", str(tmp_path / "builds"))
    monkeypatch.setenv("SPECMAP_PRESET", "paper")  # of a worker: no step may see it
    return tmp_path / "builds"


def _no_map(path: Path) -> None:
    from specmap_cli.core.errors import MapError

    raise MapError(f"{path}: of the fake program")


@pytest.fixture
def run(fake: Path, tmp_path: Path) -> Run:
    """Run a job of a log of these words with the fake program."""
    assert not fake.exists()

    def run(
        words: str = "fine", limits: Limits = Limits(), attempt: int = 1, **changes: object
    ) -> JobResult:
        log = tmp_path / "monday.mcap"
        if not log.exists() or log.read_text() != words:
            log.write_text(words)
        job = Job("monday", (str(log),), changes.get("steps", ALL))  # type: ignore[arg-type]
        return run_job(job, str(tmp_path / "out"), limits, str(tmp_path / "scratch"), attempt)

    return run


def builds(note: Path) -> int:
    """How many builds were begun."""
    return len(note.read_text().splitlines()) if note.exists() else 0


def files(directory: Path) -> dict[str, bytes]:
    """All files of a result but those that hold times and paths."""
    return {
        str(path.relative_to(directory)): path.read_bytes()
        for path in directory.rglob("*")
        if path.is_file() and path.name not in ("job.json", "log.txt")
    }


def test_a_finished_job_leaves_all_that_it_made_and_nothing_else(run: Run, tmp_path: Path) -> None:
    result = run()
    folder = tmp_path / "out" / "monday"
    assert (result.state, result.kind, result.reason, result.resumed) == ("done", None, None, False)
    assert {path.name for path in folder.iterdir()} == {
        *("map", "report.html", "log.txt", "job.json"),
        *("build.json", "report.json", "check.json"),
    }
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["monday"]
    assert list((tmp_path / "scratch").iterdir()) == []
    assert result.files["map/part-3"] == (folder / "map" / "part-3").stat().st_size
    assert [step.command for step in result.steps] == ["build", "report", "check"]
    assert "$ specmap check --json -- map" in (folder / "log.txt").read_text()


def test_what_job_json_says_is_as_its_schema_says(run: Run, tmp_path: Path) -> None:
    result = run("damaged")
    written = json.loads((tmp_path / "out" / "monday" / "job.json").read_text())
    jsonschema.validate(written, read_schema("job"))
    assert to_json(result.record.model_dump()) == to_json(written)
    stored = folder_at(str(tmp_path / "out"), "monday").stored()
    assert stored is not None
    assert stored.reason == result.reason


def test_a_complete_result_is_not_made_again(fake: Path, run: Run, tmp_path: Path) -> None:
    first = run()
    before = (tmp_path / "out" / "monday" / "job.json").stat().st_mtime_ns
    again = run()
    assert again.resumed
    assert to_json(again.record.model_dump()) == to_json(first.record.model_dump())
    assert (tmp_path / "out" / "monday" / "job.json").stat().st_mtime_ns == before
    assert builds(fake) == 1


@pytest.mark.parametrize("spoil", ["log", "option", "missing", "damaged", "cut", "no record"])
def test_what_is_not_complete_or_of_other_inputs_is_made_again(
    fake: Path, run: Run, tmp_path: Path, spoil: str
) -> None:
    run()
    folder = tmp_path / "out" / "monday"
    words, steps = "fine", ALL
    if spoil == "log":
        words = "fine too"
    elif spoil == "option":
        steps = (Step("build", ("--seed=3",)), *ALL[1:])
    elif spoil == "missing":
        (folder / "map" / "part-3").unlink()
    elif spoil == "damaged":
        (folder / "job.json").write_text("{")
    elif spoil == "cut":
        (folder / "report.html").write_text("")
    else:
        shutil.rmtree(folder)
    result = run(words, steps=steps)
    assert (result.state, result.resumed) == ("done", False)
    assert builds(fake) == 2
    assert words in (folder / "map" / "part-0").read_text()
    assert run(words, steps=steps).resumed


def test_a_log_that_only_moved_is_the_same(run: Run, tmp_path: Path) -> None:
    run()
    moved = tmp_path / "elsewhere" / "monday.mcap"
    moved.parent.mkdir()
    (tmp_path / "monday.mcap").rename(moved)
    assert run_job(Job("monday", (str(moved),), ALL), str(tmp_path / "out")).resumed


@pytest.mark.parametrize(
    ("words", "kind", "reason"),
    [
        ("damaged", "log", "monday.mcap: cut off after 12 bytes; no message can be read"),
        ("large", "memory", "not enough memory; a shorter log needs less"),
        ("full", "place", "No space left on device"),
        ("bug", "bug", "ValueError: no good"),
        ("killed", "memory", "build was killed, as a system does for want of memory"),
    ],
)
def test_a_failed_job_says_why_and_leaves_its_log(
    run: Run, tmp_path: Path, words: str, kind: str, reason: str
) -> None:
    result = run(words)
    assert (result.state, result.kind) == ("failed", kind)
    assert result.reason is not None
    assert result.reason.endswith(reason)
    assert "\n" not in result.reason
    assert {path.name for path in (tmp_path / "out" / "monday").iterdir()} == {
        "job.json",
        "log.txt",
    }
    assert may_retry(result) == (kind in ("place", "memory"))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("broken", "breaks 1 of 2 rules: lost_share"),
        ("doubtful", "build: the map is doubtful"),
    ],
)
def test_a_broken_rule_fails_the_job_and_loses_nothing(
    fake: Path, run: Run, tmp_path: Path, words: str, reason: str
) -> None:
    result = run(words)
    assert (result.state, result.kind, result.reason) == ("failed", "rule", reason)
    assert len(result.steps) == 3
    assert {"map", "report.html", "check.json"} <= {
        path.name for path in (tmp_path / "out" / "monday").iterdir()
    }
    assert not may_retry(result)
    assert run(words).resumed
    assert builds(fake) == 1


def test_a_job_beyond_its_memory_is_stopped_and_tried_again_with_more(
    run: Run, tmp_path: Path
) -> None:
    small = Limits(memory_mb=80)
    first = run("hungry", small)
    assert (first.kind, first.reason) == (
        "memory",
        "build needed more than 80 MB of memory, the limit",
    )
    assert first.memory_mb is not None
    assert first.memory_mb > 80
    assert may_retry(first)
    assert run("hungry", small).resumed  # the same would happen again
    second = run("hungry", small, attempt=2)
    assert (second.resumed, second.attempts, may_retry(second)) == (False, 2, False)
    assert run("hungry", small).resumed
    assert run("hungry", Limits(memory_mb=2000)).state == "done"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"monday"}


def test_a_job_beyond_its_time_is_stopped(run: Run) -> None:
    result = run("slow", Limits(time_s=0.3))
    assert (result.kind, result.reason) == (
        "time",
        "the job took more than 0.3 s, the limit; it was in build",
    )
    assert not may_retry(result)
    assert run("slow", Limits(time_s=0.2)).resumed


def test_without_the_extra_one_line_says_what_to_install(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "psutil", None)
    result = run()
    assert (result.kind, result.reason) == (
        "settings",
        "jobs need an extra: pip install 'specmap-cli[batch]'",
    )


def test_a_missing_log_fails_the_job_alone(tmp_path: Path) -> None:
    job = Job("gone", (str(tmp_path / "gone.mcap"),), ALL)
    result = run_job(job, str(tmp_path / "out"))
    assert (result.kind, result.digest) == ("log", "")
    assert result.reason == f"{tmp_path / 'gone.mcap'}: no such file or directory"
    assert not run_job(job, str(tmp_path / "out")).resumed


def test_a_log_that_is_out_of_reach_does_not_cost_its_map(run: Run, tmp_path: Path) -> None:
    """As on a worker that lacks the shared folder."""
    run()
    before = files(tmp_path / "out" / "monday")
    (tmp_path / "monday.mcap").rename(tmp_path / "away")
    job = Job("monday", (str(tmp_path / "monday.mcap"),), ALL)
    for redo in (False, True):
        result = run_job(job, str(tmp_path / "out"), redo=redo)
        assert (result.state, result.kind) == ("failed", "log")
        assert files(tmp_path / "out" / "monday") == before
    (tmp_path / "away").rename(tmp_path / "monday.mcap")
    assert run().resumed


def test_a_reason_is_one_line_of_text_whatever_a_log_is_called(tmp_path: Path) -> None:
    log = str(tmp_path / "gone\n\udcff\x1b.mcap")
    result = run_job(Job("gone", (log,), ALL), str(tmp_path / "out"))
    assert result.reason == f"{tmp_path}/gone \\udcff\\x1b.mcap: no such file or directory"
    lost = failure(Job("gone", (log,), ALL), "worker", "first\nsecond\udcff")
    assert lost.reason == "first second\\udcff"


def test_what_a_person_decided_about_a_map_is_never_lost(
    fake: Path, run: Run, tmp_path: Path
) -> None:
    run()
    folder = tmp_path / "out" / "monday"
    (folder / "map" / "edits.toml").write_text("[names]\n", encoding="utf-8")
    for name in (folder / "map").iterdir():  # an edit writes the map anew
        name.write_bytes(name.read_bytes() + b" ")
    built = fake.read_text()
    assert run().resumed
    for refused in (run("other words"), run("other words", redo=True)):
        assert (refused.state, refused.kind) == ("failed", "settings")
        assert refused.reason is not None
        assert "edits.toml: holds a person's decisions" in refused.reason
    assert fake.read_text() == built
    assert (folder / "map" / "edits.toml").read_text() == "[names]\n "
    (folder / "map" / "edits.toml").unlink()
    assert run("other words").state == "done"


def test_what_somebody_else_keeps_there_is_not_touched(run: Run, tmp_path: Path) -> None:
    mine = tmp_path / "out" / "monday" / "thesis.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("years of work")
    result = run()
    assert (result.kind, may_retry(result)) == ("settings", False)
    assert "choose another output directory" in str(result.reason)
    assert mine.read_text() == "years of work"


def test_an_output_that_cannot_be_written_may_be_tried_again(run: Run, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    result = run()
    assert (result.kind, may_retry(result)) == ("place", True)


def test_a_lost_worker_is_told_of_without_a_file() -> None:
    lost = failure(Job("monday", ("monday.mcap",), ALL), "worker", "the worker was lost", 1)
    assert (lost.state, lost.files, may_retry(lost)) == ("failed", {}, True)
    assert not may_retry(lost.model_copy(update={"attempts": 2}))


def test_killed_at_any_instant_it_leaves_a_complete_result_or_none(
    fake: Path, run: Run, tmp_path: Path
) -> None:
    """SIGKILL, as a system does: no `finally` runs. The steps die with their worker."""
    run()
    folder = tmp_path / "out" / "monday"
    expected = files(folder)
    shutil.rmtree(tmp_path / "out")
    chance = random.Random(5)
    context = multiprocessing.get_context("fork")
    whole = 0
    for _ in range(10):
        child = context.Process(target=run)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks with threads
            child.start()
        time.sleep(chance.uniform(0.0, 0.25))
        child.kill()
        child.join()
        stored = folder_at(str(tmp_path / "out"), "monday").stored()
        assert (stored is not None) == folder.exists()
        whole += stored is not None
        if stored is not None:
            assert files(folder) == expected
            shutil.rmtree(tmp_path / "out")
    assert run().state == "done"
    assert files(folder) == expected
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["monday"]
    assert list((tmp_path / "scratch").iterdir()) == []
    for line in fake.read_text().splitlines():
        assert not _lives(int(line.split()[0]))


def _lives(pid: int) -> bool:
    """Whether a process of the fake program is still there, after a moment for the system."""
    for _ in range(100):
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
        except OSError:
            return False
        if fake_specmap.__file__.encode() not in command:  # ended, or the number is another's now
            return False
        time.sleep(0.02)
    return True


def test_a_real_log_without_its_end_becomes_a_map_with_figures_and_a_warning(
    tiny_log: Path, tmp_path: Path
) -> None:
    log = tmp_path / "short.mcap"
    log.write_bytes(tiny_log.read_bytes()[:-40])
    options = {"build": {"set": list(QUICK[1::2])}}
    (job,) = jobs_of([str(log)], Plan(("build",), options, known_options()))
    result = run_job(job, str(tmp_path / "out"), Limits(memory_mb=4000), str(tmp_path / "scratch"))
    assert result.state == "done", result.reason
    assert result.figures["scans"] == 61
    assert result.figures["verdict"] in ("good", "doubtful", "poor")
    assert (tmp_path / "out" / "short" / "map" / "topology.json").is_file()
    assert result.inputs[0].bytes == log.stat().st_size
    assert result.memory_mb is not None
    assert result.memory_mb > 50
    assert os.listdir(tmp_path / "scratch") == []
    (build,) = result.steps
    assert any(f"{log}: cut off" in each for each in build.warnings), build.warnings
    stored = json.loads((tmp_path / "out" / "short" / "job.json").read_text())
    assert stored["steps"][0]["warnings"] == list(build.warnings)


def test_a_real_log_that_is_cut_off_says_so(tiny_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "cut.mcap"
    log.write_bytes(tiny_log.read_bytes()[:100])
    result = run_job(jobs_of([str(log)])[0], str(tmp_path / "out"))
    assert result.kind == "log"
    assert result.reason is not None
    assert str(log) in result.reason
    assert result.figures == {}


def test_the_digest_knows_the_contents_of_option_files(tmp_path: Path) -> None:
    log, rules = tmp_path / "a.mcap", tmp_path / "rules.toml"
    log.write_bytes(b"log")
    rules.write_text("verdict = 'good'")
    option = f"--rules={rules}"
    job = Job("a", (str(log),), (Step("build"), Step("check", (option,), (option,))))
    before = digest_of(job, "1", inputs_of(job))
    moved = tmp_path / "others.toml"
    moved.write_text("verdict = 'good'")
    option = f"--rules={moved}"
    elsewhere = Job("a", job.logs, (job.steps[0], Step("check", (option,), (option,))))
    assert digest_of(elsewhere, "1", inputs_of(elsewhere)) == before
    assert digest_of(job, "2", inputs_of(job)) != before
    rules.write_text("verdict = 'poor'")
    assert digest_of(job, "1", inputs_of(job)) != before

"""What a worker does with a job: done, done already, failed in every way, and killed."""

from __future__ import annotations

import json
import math
import multiprocessing
import random
import shutil
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import jsonschema
import pytest
from pydantic import ValidationError

from specmap_cli.batch import processes
from specmap_cli.batch.jobs import jobs_of
from specmap_cli.batch.outputs import folder_at
from specmap_cli.batch.records import Job, JobRecord, JobResult, Limits, Plan, Step, Terms, Turn
from specmap_cli.batch.running import failure, may_retry, run_job
from specmap_cli.batch.sources import digest_of, inputs_of
from specmap_cli.cli.batch import known_options
from specmap_cli.core.schemas import read_schema
from specmap_cli.core.text import to_json
from tests.batch import fake_specmap
from tests.batch.results import ALL, faked, result
from tests.cli.conftest import QUICK

pytest.importorskip("psutil")

Run = Callable[..., JobRecord]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The fake program in the place of specmap; the file has a line for each of its builds."""
    faked(monkeypatch)
    monkeypatch.setattr(processes, "_WATCH_S", 0.01)  # its steps are short
    monkeypatch.setenv("FAKE_NOTE", str(tmp_path / "builds"))
    monkeypatch.setenv("SPECMAP_PRESET", "paper")  # of a worker: no step may see it
    return tmp_path / "builds"


@pytest.fixture
def run(fake: Path, tmp_path: Path) -> Run:
    """Run a job of a log of these words with the fake program; it was `resumed` or not."""
    assert not fake.exists()

    def run(
        words: str = "fine",
        limits: Limits = Limits(),
        attempt: int = 1,
        *,
        steps: tuple[Step, ...] = ALL,
        redo: bool = False,
        resumed: bool = False,
    ) -> JobRecord:
        log = tmp_path / "monday.mcap"
        if not log.exists() or log.read_text() != words:
            log.write_text(words)
        turn = Turn(Job("monday", (str(log),), steps), attempt)
        scratch = str(tmp_path / "scratch")
        made = run_job(turn, Terms(str(tmp_path / "out"), limits, scratch, redo))
        assert made.resumed == resumed
        return made.record

    return run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of the job that `run` does."""
    return tmp_path / "out" / "monday"


def run_of(log: Path | str, tmp_path: Path, *, redo: bool = False) -> JobResult:
    """What comes of the job of a log that is not that of `run`."""
    return run_job(Turn(Job("monday", (str(log),), ALL)), Terms(str(tmp_path / "out"), redo=redo))


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


def test_a_finished_job_leaves_all_that_it_made_and_nothing_else(
    run: Run, folder: Path, tmp_path: Path
) -> None:
    record = run()
    assert (record.state, record.kind, record.reason) == ("done", None, None)
    assert {path.name for path in folder.iterdir()} == {
        *("map", "report.html", "log.txt", "job.json"),
        *("build.json", "report.json", "check.json"),
    }
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["monday"]
    assert list((tmp_path / "scratch").iterdir()) == []
    assert record.files["map/part-3"] == (folder / "map" / "part-3").stat().st_size
    assert [step.command for step in record.steps] == ["build", "report", "check"]
    assert "$ specmap check --json -- map" in (folder / "log.txt").read_text()
    damaged = run("damaged", Limits(time_s=60.0))
    written = json.loads((folder / "job.json").read_text())
    jsonschema.validate(written, read_schema("job"))
    stored = folder_at(str(tmp_path / "out"), "monday").stored()
    assert stored is not None
    assert to_json(stored.model_dump()) == to_json(damaged.model_dump()) == to_json(written)


def test_a_complete_result_is_not_made_again(fake: Path, run: Run, folder: Path) -> None:
    first = run()
    before = (folder / "job.json").stat().st_mtime_ns
    assert to_json(run(resumed=True).model_dump()) == to_json(first.model_dump())
    assert (folder / "job.json").stat().st_mtime_ns == before
    assert builds(fake) == 1
    run(redo=True)
    assert builds(fake) == 2


def damage(kind: str, folder: Path) -> None:
    """What happens to a result, or nothing."""
    if kind == "missing":
        (folder / "map" / "part-3").unlink()
    elif kind in ("job.json", "report.html"):  # damaged, or cut off
        (folder / kind).write_text("{" if kind == "job.json" else "")
    elif kind == "no record":
        shutil.rmtree(folder)


SEEDED = (Step("build", ("--seed=3",)), *ALL[1:])


@pytest.mark.parametrize(
    ("spoil", "words", "steps"),
    [
        ("log", "fine too", ALL),
        ("option", "fine", SEEDED),
        *((kind, "fine", ALL) for kind in ("missing", "job.json", "report.html", "no record")),
    ],
)
def test_what_is_not_complete_or_of_other_inputs_is_made_again(
    fake: Path, run: Run, folder: Path, spoil: str, words: str, steps: tuple[Step, ...]
) -> None:
    run()
    damage(spoil, folder)
    assert run(words, steps=steps).state == "done"
    assert builds(fake) == 2
    assert words in (folder / "map" / "part-0").read_text()
    run(words, steps=steps, resumed=True)


def test_a_log_that_is_out_of_reach_does_not_cost_its_map_and_one_that_moved_is_the_same(
    run: Run, folder: Path, tmp_path: Path
) -> None:
    """As on a worker that lacks the shared folder."""
    run()
    before = files(folder)
    log, moved = tmp_path / "monday.mcap", tmp_path / "elsewhere" / "monday.mcap"
    moved.parent.mkdir()
    log.rename(moved)
    for redo in (False, True):
        record = run_of(log, tmp_path, redo=redo).record
        assert (record.state, record.kind) == ("failed", "log")
        assert files(folder) == before
    assert run_of(moved, tmp_path).resumed
    moved.rename(log)
    run(resumed=True)


FAILURES = {
    "damaged": ("log", "monday.mcap: cut off after 12 bytes; no message can be read"),
    "large": ("memory", "not enough memory; a shorter log needs less"),
    "full": ("place", "No space left on device"),
    "bug": ("bug", "ValueError: no good"),
    "killed": ("memory", "build was killed, as a system does for want of memory"),
}


@pytest.mark.parametrize("words", FAILURES)
def test_a_failed_job_says_why_and_leaves_its_log(run: Run, folder: Path, words: str) -> None:
    record, (kind, reason) = run(words), FAILURES[words]
    assert (record.state, record.kind) == ("failed", kind)
    assert str(record.reason).endswith(reason)
    assert "\n" not in str(record.reason)
    assert {path.name for path in folder.iterdir()} == {"job.json", "log.txt"}
    assert may_retry(record, 2) == (kind in ("place", "memory"))


@pytest.mark.parametrize(
    ("words", "reason"),
    [("broken", "breaks 1 of 2 rules: lost_share"), ("doubtful", "build: the map is doubtful")],
)
def test_a_broken_rule_fails_the_job_and_loses_nothing(
    fake: Path, run: Run, folder: Path, words: str, reason: str
) -> None:
    record = run(words)
    assert (record.state, record.kind, record.reason) == ("failed", "rule", reason)
    assert len(record.steps) == 3
    assert {"map", "report.html", "check.json"} <= {path.name for path in folder.iterdir()}
    assert not may_retry(record, 2)
    run(words, resumed=True)
    assert builds(fake) == 1


def test_a_job_beyond_its_memory_is_stopped_and_tried_again_with_more(
    run: Run, tmp_path: Path
) -> None:
    small = Limits(memory_mb=80)
    first = run("hungry", small)
    assert first.kind == "memory"
    assert first.reason == "build needed more than 80 MB of memory, the limit"
    assert first.memory_mb is not None
    assert first.memory_mb > 80
    assert may_retry(first, 2)
    run("hungry", small, resumed=True)  # the same would happen again
    second = run("hungry", small, attempt=2)
    assert (second.attempts, may_retry(second, 2)) == (2, False)
    run("hungry", small, resumed=True)
    assert run("hungry", Limits(memory_mb=2000)).state == "done"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"monday"}


def test_a_job_beyond_its_time_is_stopped(run: Run) -> None:
    record = run("slow", Limits(time_s=0.3))
    told = "the job took more than 0.3 s, the limit; it was in build"
    assert (record.kind, record.reason, may_retry(record, 2)) == ("time", told, False)
    run("slow", Limits(time_s=0.2), resumed=True)


def test_without_the_extra_one_line_says_what_to_install(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "psutil", None)
    record = run()
    assert record.kind == "settings"
    assert record.reason == "jobs need an extra: pip install 'specmap-cli[batch]'"


def test_a_lost_worker_is_told_of_without_a_file() -> None:
    for attempt, again in ((1, True), (2, False)):
        turn = Turn(Job("monday", ("monday.mcap",), ALL), attempt)
        lost = failure(turn, "worker", "the worker\nwas lost\udcff", Limits()).record
        assert (lost.state, lost.files, may_retry(lost, 2)) == ("failed", {}, again)
        assert lost.reason == "the worker was lost\\udcff"


def test_a_missing_log_fails_the_job_in_a_line_whatever_it_is_called(tmp_path: Path) -> None:
    for _ in range(2):
        made = run_of(f"{tmp_path}/gone\n\udcff\x1b.mcap", tmp_path)
        assert (made.record.kind, made.record.digest, made.resumed) == ("log", "", False)
        told = f"{tmp_path}/gone \\udcff\\x1b.mcap: no such file or directory"
        assert made.record.reason == told


def test_what_a_person_decided_about_a_map_is_never_lost(
    fake: Path, run: Run, folder: Path
) -> None:
    run()
    (folder / "map" / "edits.toml").write_text("[names]\n", encoding="utf-8")
    for name in (folder / "map").iterdir():  # an edit writes the map anew
        name.write_bytes(name.read_bytes() + b" ")
    run(resumed=True)
    for redo in (False, True):
        refused = run("other words", redo=redo)
        assert (refused.state, refused.kind) == ("failed", "settings")
        assert "edits.toml: holds a person's decisions" in str(refused.reason)
    assert builds(fake) == 1
    assert (folder / "map" / "edits.toml").read_text() == "[names]\n "
    (folder / "map" / "edits.toml").unlink()
    assert run("other words").state == "done"


@pytest.mark.parametrize(
    ("place", "kind", "reason"),
    [
        ("out/monday/thesis.txt", "settings", "choose another output directory"),
        ("out", "place", ""),  # may be tried again
    ],
)
def test_what_somebody_else_keeps_there_is_not_touched(
    run: Run, tmp_path: Path, place: str, kind: str, reason: str
) -> None:
    mine = tmp_path / place
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text("years of work")
    record = run()
    assert (record.kind, may_retry(record, 2)) == (kind, kind == "place")
    assert reason in str(record.reason)
    assert mine.read_text() == "years of work"


def test_killed_at_any_instant_it_leaves_a_complete_result_or_none(
    fake: Path, run: Run, folder: Path, tmp_path: Path
) -> None:
    """SIGKILL, as a system does: no `finally` runs. The steps die with their worker."""
    run()
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
        with suppress(OSError):
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            if fake_specmap.__file__.encode() in command:
                time.sleep(0.02)
                continue
        return False  # ended, or the number is another's now
    return True


def test_a_real_log_without_its_end_becomes_a_map_with_figures_and_a_warning(
    tiny_log: Path, tmp_path: Path
) -> None:
    log = tmp_path / "short.mcap"
    log.write_bytes(tiny_log.read_bytes()[:-40])
    options = {"build": {"set": list(QUICK[1::2])}}
    (job,) = jobs_of([str(log)], Plan(("build",), options, known_options()))
    scratch = tmp_path / "scratch"
    terms = Terms(str(tmp_path / "out"), Limits(memory_mb=4000), str(scratch))
    record = run_job(Turn(job), terms).record
    assert record.state == "done", record.reason
    assert record.figures["scans"] == 61
    assert record.figures["verdict"] in ("good", "doubtful", "poor")
    assert (tmp_path / "out" / "short" / "map" / "topology.json").is_file()
    assert record.inputs[0].bytes == log.stat().st_size
    assert record.memory_mb is not None
    assert record.memory_mb > 50
    assert list(scratch.iterdir()) == []
    (build,) = record.steps
    assert any(f"{log}: cut off" in each for each in build.warnings), build.warnings
    stored = json.loads((tmp_path / "out" / "short" / "job.json").read_text())
    assert stored["steps"][0]["warnings"] == list(build.warnings)


@pytest.mark.parametrize(
    "changed",
    [
        {"odd": 1},
        {"wall_s": math.inf},
        {"figures": {"scans": math.nan}},
        {"limits": {"memory_mb": 1, "time_s": math.inf}},
        {"limits": {"memory_mb": 1, "time_s": None, "odd": 1}},
        {"inputs": ({"log": "a", "bytes": 1, "identity": "", "odd": 1},)},
    ],
)
def test_a_record_has_no_other_keys_and_no_other_numbers(changed: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        result("a", **changed)


def test_the_digest_knows_the_contents_of_option_files(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(b"log")

    def digest(rules: str, text: str, version: str = "1") -> str:
        (tmp_path / rules).write_text(text)
        option = f"--rules={tmp_path / rules}"
        job = Job("a", (str(log),), (Step("build"), Step("check", (option,), (option,))))
        return digest_of(job, version, inputs_of(job))

    before = digest("rules.toml", "verdict = 'good'")
    assert digest("others.toml", "verdict = 'good'") == before
    assert digest("rules.toml", "verdict = 'good'", "2") != before
    assert digest("rules.toml", "verdict = 'poor'") != before

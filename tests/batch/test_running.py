"""What a worker does with a job: done, done already, failed in every way, and killed."""

import json
import math
import multiprocessing
import random
import shutil
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path

import jsonschema
import pytest
from pydantic import ValidationError

from specmap_cli.batch import processes
from specmap_cli.batch.jobs import jobs_of
from specmap_cli.batch.places import folder_at
from specmap_cli.batch.records import Job, JobRecord, Limits, Plan, Step, Terms, Turn
from specmap_cli.batch.running import may_retry, run_job, worker_lost
from specmap_cli.batch.sources import digest_of, inputs_of
from specmap_cli.cli.making import known_options
from specmap_cli.core.files import is_nobody_s
from specmap_cli.core.schemas import read_schema
from specmap_cli.core.text import to_json
from tests.batch import fake_specmap
from tests.batch.results import ALL, faked, result
from tests.cli.conftest import QUICK

pytest.importorskip("psutil")


class Bench:
    """Where the fake program does the job of a log of some words; a note has a line a build."""

    def __init__(self, path: Path) -> None:
        self.log, self.note = path / "monday.mcap", path / "builds"
        self.out, self.scratch = path / "out", path / "scratch"
        self.folder = self.out / "monday"

    def __call__(
        self,
        words: str = "fine",
        limits: Limits = Limits(),
        attempt: int = 1,
        *,
        log: Path | str | None = None,  # another one, as it is
        steps: tuple[Step, ...] = ALL,
        redo: bool = False,
        resumed: bool = False,
    ) -> JobRecord:
        """Run the job; it was `resumed` or not."""
        if log is None and (not self.log.exists() or self.log.read_text() != words):
            self.log.write_text(words)
        turn = Turn(Job("monday", (str(log or self.log),), steps), attempt)
        made = run_job(turn, Terms(str(self.out), limits, str(self.scratch), redo))
        assert made.resumed == resumed
        return made.record

    @property
    def builds(self) -> int:
        return len(self.note.read_text().splitlines()) if self.note.exists() else 0

    @property
    def stored(self) -> JobRecord | None:
        return folder_at(str(self.out), "monday").stored()

    @property
    def names(self) -> set[str]:
        return {path.name for path in self.folder.iterdir()}

    @property
    def files(self) -> dict[str, bytes]:
        """All files of the result but those that hold times and paths."""
        return {
            str(path.relative_to(self.folder)): path.read_bytes()
            for path in self.folder.rglob("*")
            if path.is_file() and path.name not in ("job.json", "log.txt")
        }


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bench:
    faked(monkeypatch)
    bench = Bench(tmp_path)
    monkeypatch.setattr(processes, "_WATCH_S", 0.01)  # its steps are short
    monkeypatch.setenv("FAKE_NOTE", str(bench.note))
    monkeypatch.setenv("SPECMAP_PRESET", "paper")  # of a worker: no step may see it
    return bench


def test_a_finished_job_leaves_what_it_made_and_nothing_else_and_is_made_once(run: Bench) -> None:
    record, folder = run(), run.folder
    assert (record.state, record.kind, record.reason) == ("done", None, None)
    assert run.names == {
        *("map", "report.html", "log.txt", "job.json"),
        *("build.json", "report.json", "check.json"),
    }
    assert [*run.out.iterdir(), *run.scratch.iterdir()] == [folder]
    assert record.files["map/part-3"] == (folder / "map" / "part-3").stat().st_size
    assert [step.command for step in record.steps] == ["build", "report", "check"]
    assert "$ specmap check --json -- map" in (folder / "log.txt").read_text()
    before = (folder / "job.json").stat().st_mtime_ns
    assert to_json(run(resumed=True).model_dump()) == to_json(record.model_dump())
    assert (folder / "job.json").stat().st_mtime_ns == before
    assert run.builds == 1
    run(redo=True)
    assert run.builds == 2
    damaged = run("damaged", Limits(time_s=60.0))
    written = json.loads((folder / "job.json").read_text())
    jsonschema.validate(written, read_schema("job"))
    assert run.stored is not None
    assert to_json(run.stored.model_dump()) == to_json(damaged.model_dump()) == to_json(written)


@pytest.mark.parametrize(
    ("spoil", "words", "steps"),
    [
        (None, "fine too", ALL),
        (None, "fine", (Step("build", ("--seed=3",)), *ALL[1:])),
        *((lost, "fine", ALL) for lost in ("map/part-3", "job.json", "report.html", "")),
    ],
)
def test_what_is_not_complete_or_of_other_inputs_is_made_again(
    run: Bench, spoil: str | None, words: str, steps: tuple[Step, ...]
) -> None:
    run()
    if spoil == "":  # the whole folder
        shutil.rmtree(run.folder)
    elif spoil == "map/part-3":
        (run.folder / spoil).unlink()
    elif spoil is not None:  # damaged, or cut off
        (run.folder / spoil).write_text("{" if spoil == "job.json" else "")
    assert run(words, steps=steps).state == "done"
    assert run.builds == 2
    assert words in (run.folder / "map" / "part-0").read_text()
    run(words, steps=steps, resumed=True)


def test_a_log_out_of_reach_costs_no_map_and_may_have_moved(run: Bench, tmp_path: Path) -> None:
    """As on a worker that lacks the shared folder."""
    run()
    before = run.files
    moved = tmp_path / "elsewhere" / "monday.mcap"
    moved.parent.mkdir()
    run.log.rename(moved)
    for redo in (False, True):
        record = run(log=run.log, redo=redo)
        assert (record.state, record.kind) == ("failed", "log")
        assert run.files == before
    run(log=moved, resumed=True)
    moved.rename(run.log)
    run(resumed=True)


@pytest.mark.parametrize(
    ("words", "kind", "reason"),
    [
        ("damaged", "log", "monday.mcap: cut off after 12 bytes; no message can be read"),
        ("large", "memory", "not enough memory; a shorter log needs less"),
        ("full", "place", "No space left on device"),
        ("bug", "bug", "ValueError: no good"),
        ("killed", "memory", "build was killed, as a system does for want of memory"),
        ("slow", "time", "the job took more than 0.3 s, the limit; it was in build"),
    ],
)
def test_a_failed_job_says_why_with_its_log(run: Bench, words: str, kind: str, reason: str) -> None:
    limits = Limits(time_s=0.3 if words == "slow" else None)
    record = run(words, limits)
    assert (record.state, record.kind) == ("failed", kind)
    assert str(record.reason).endswith(reason)
    assert "\n" not in str(record.reason)
    assert run.names == {"job.json", "log.txt"}
    assert may_retry(record, 2) == (kind in ("place", "memory"))
    run(words, limits, resumed=kind != "place")  # the same would happen again


@pytest.mark.parametrize(
    ("words", "reason"),
    [("broken", "breaks 1 of 2 rules: lost_share"), ("doubtful", "build: the map is doubtful")],
)
def test_a_broken_rule_fails_the_job_and_loses_nothing(run: Bench, words: str, reason: str) -> None:
    record = run(words)
    assert (record.state, record.kind, record.reason) == ("failed", "rule", reason)
    assert len(record.steps) == 3
    assert run.names >= {"map", "report.html", "check.json"}
    assert not may_retry(record, 2)
    run(words, resumed=True)
    assert run.builds == 1


def test_a_job_beyond_its_memory_is_stopped_and_tried_again_with_more(run: Bench) -> None:
    small = Limits(memory_mb=80)
    first = run("hungry", small)
    assert first.reason == "build needed more than 80 MB of memory, the limit"
    assert (first.memory_mb or 0) > 80
    assert (first.kind, may_retry(first, 2)) == ("memory", True)
    run("hungry", small, resumed=True)
    second = run("hungry", small, attempt=2)
    assert (second.attempts, may_retry(second, 2)) == (2, False)
    run("hungry", small, resumed=True)
    assert run("hungry", Limits(memory_mb=2000)).state == "done"
    assert list(run.out.iterdir()) == [run.folder]


def test_without_the_extra_a_line_asks_for_it(run: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psutil", None)
    record = run()
    assert record.kind == "settings"
    assert record.reason == "jobs need an extra: pip install 'specmap-cli[batch]'"


def test_a_lost_worker_is_told_of_without_a_file() -> None:
    for attempt, again in ((1, True), (2, False)):
        turn = Turn(Job("monday", ("monday.mcap",), ALL), attempt)
        lost = worker_lost(turn, "the worker\nwas lost\udcff", Limits()).record
        assert (lost.state, lost.files, may_retry(lost, 2)) == ("failed", {}, again)
        assert lost.reason == "the worker was lost\\udcff"


def test_a_missing_log_of_any_name_fails_the_job_in_a_line(run: Bench, tmp_path: Path) -> None:
    for _ in range(2):
        record = run(log=f"{tmp_path}/gone\n\udcff\x1b.mcap")
        assert (record.kind, record.digest) == ("log", "")
        assert record.reason == f"{tmp_path}/gone \\udcff\\x1b.mcap: no such file or directory"


def test_what_a_person_decided_about_a_map_is_never_lost(run: Bench) -> None:
    run()
    edits = run.folder / "map" / "edits.toml"
    edits.write_text("[names]\n", encoding="utf-8")
    for name in edits.parent.iterdir():  # an edit writes the map anew
        name.write_bytes(name.read_bytes() + b" ")
    run(resumed=True)
    for redo in (False, True):
        refused = run("other words", redo=redo)
        assert (refused.state, refused.kind) == ("failed", "settings")
        assert "edits.toml: holds a person's decisions" in str(refused.reason)
    assert run.builds == 1
    assert edits.read_text() == "[names]\n "
    edits.unlink()
    assert run("other words").state == "done"


@pytest.mark.parametrize(
    ("place", "kind", "reason"),
    [
        ("out/monday/thesis.txt", "settings", "choose another output directory"),
        ("out", "place", ""),  # may be tried again
    ],
)
def test_what_somebody_else_keeps_there_is_not_touched(
    run: Bench, tmp_path: Path, place: str, kind: str, reason: str
) -> None:
    mine = tmp_path / place
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text("years of work")
    record = run()
    assert (record.kind, may_retry(record, 2)) == (kind, kind == "place")
    assert reason in str(record.reason)
    assert mine.read_text() == "years of work"


def test_killed_at_any_instant_it_leaves_a_complete_result_or_none(run: Bench) -> None:
    """SIGKILL, as a system does: no `finally` runs. The steps die with their worker."""
    run()
    expected = run.files
    shutil.rmtree(run.out)
    chance = random.Random(5)
    context = multiprocessing.get_context("fork")
    for _ in range(10):
        child = context.Process(target=run)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks with threads
            child.start()
        time.sleep(chance.uniform(0.0, 0.25))
        child.kill()
        child.join()
        assert (run.stored is not None) == run.folder.exists()
        if run.folder.exists():
            assert run.files == expected
            shutil.rmtree(run.out)
    steps = [int(line.split()[0]) for line in run.note.read_text().splitlines()]
    for _ in range(1000):  # one that a busy machine has not ended yet keeps its folders
        left = [*run.out.glob("*"), *run.scratch.glob("*")]
        if not any(map(_lives, steps)) and all(map(is_nobody_s, left)):
            break
        time.sleep(0.02)
    assert not any(map(_lives, steps))
    assert run().state == "done"
    assert run.files == expected
    assert [*run.out.iterdir(), *run.scratch.iterdir()] == [run.folder]


def _lives(pid: int) -> bool:
    """Whether a process of the fake program is still there; the number may be another's now."""
    with suppress(OSError):
        return fake_specmap.__file__.encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def test_a_log_without_its_end_becomes_a_map_with_a_warning(tiny_log: Path, tmp_path: Path) -> None:
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
    assert (record.memory_mb or 0) > 50
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

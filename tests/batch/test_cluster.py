"""A batch on workers of Dask: in this process, on this machine, and behind another scheduler."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from specmap_cli import __version__
from specmap_cli.batch import batch, workers
from specmap_cli.batch.batch import EventRecord, Ledger, run_batch, work_off
from specmap_cli.batch.places import PlaceError
from specmap_cli.batch.records import Limits, Terms, Turn
from specmap_cli.batch.summaries import SUMMARIES
from specmap_cli.batch.workers import Cluster, Workers, spread
from specmap_cli.core.errors import MapError, NoResultError, UsageError
from tests.batch.results import at_once, job

distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
pytest.importorskip("psutil")

# What Dask leaves to the garbage collector in a test's process is not ours.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Two workers that are threads of this process."""
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


Ran = Callable[..., tuple[Ledger, list[EventRecord]]]


@pytest.fixture
def ran(client: Any, monkeypatch: pytest.MonkeyPatch) -> Ran:
    """Run jobs that do what their names say on these workers; also what was told."""

    def ran(
        out: Path | str, *names: str, limits: Limits = Limits(), **options: Any
    ) -> tuple[Ledger, list[EventRecord]]:
        told: list[EventRecord] = []
        jobs, terms = [job(name) for name in names], Terms(str(out), limits)
        tell = options.pop("tell", told.append)
        return run_batch(jobs, terms, Cluster(), 0, tell, **options), told

    monkeypatch.setattr(batch, "opened", lambda _, terms: workers.Workers(client, terms))
    monkeypatch.setattr(workers, "on_worker", at_once)
    return ran


def test_it_does_what_can_be_done_writes_summaries_and_a_journal(ran: Ran, tmp_path: Path) -> None:
    ledger, told = ran(tmp_path, "hungry", "bad", "buggy", "a", limits=Limits(memory_mb=500))
    assert (ledger.done, ledger.failed) == (2, 2)
    buggy = ledger.results["buggy"]
    assert buggy.kind == "worker"
    assert buggy.reason == "the worker failed: ValueError: a bug of the worker"
    # want of memory gets the memory of all workers, at the end
    assert ledger.results["hungry"].limits.memory_mb == 1000
    assert [one.job for one in told if one.event in ("retried", "done")][-1] == "hungry"
    assert (told[0].event, told[-1].event) == ("began", "ended")
    written = {path.name for path in tmp_path.iterdir() if path.name[0] != "."}
    assert written == {*SUMMARIES, "events.jsonl"}
    journal = (tmp_path / "events.jsonl").read_text(encoding="utf-8")
    assert journal == "".join(one.line() for one in told)
    ran(tmp_path, "a")
    assert (tmp_path / "events.jsonl").read_text(encoding="utf-8").startswith(journal)


def test_two_batches_do_not_share_a_directory_which_is_the_same_for_all_workers(
    ran: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs: list[str] = []

    def told(client: Any, terms: Terms) -> Workers:
        outputs.append(terms.output)
        return Workers(client, terms)

    def again(_: EventRecord) -> None:
        with pytest.raises(UsageError, match="another batch is writing there"):
            ran(tmp_path / "maps", "b")

    monkeypatch.setattr(workers, "Workers", told)
    monkeypatch.chdir(tmp_path)
    ran("maps", "a", tell=again)
    ran("maps", "b")
    assert outputs == [str(tmp_path / "maps")] * 2


def test_a_store_gets_summaries_and_a_journal(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    store = pytest.importorskip("fsspec").filesystem("memory")
    for _ in range(2):
        ran("memory://fleet/maps", "a")
    found = {path.rsplit("/", 1)[-1] for path in store.find("/fleet/maps")}
    assert found == {*SUMMARIES, "events.jsonl"}
    events = store.cat_file("/fleet/maps/events.jsonl").decode().splitlines()
    assert [json.loads(line)["event"] for line in events].count("ended") == 2
    told: list[EventRecord] = []
    monkeypatch.setattr(store, "pipe_file", Mock(side_effect=PermissionError("access denied")))
    with pytest.raises(PlaceError, match=r"memory://closed: .*access denied"):
        ran("memory://closed", "a", tell=told.append)
    assert told == [], "before any job"


def test_no_jobs_are_refused_and_a_worker_of_another_version_makes_nothing(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no logs"):
        run_batch([], Terms(str(tmp_path)))
    made = workers.on_worker(Turn(job("a")), Terms(str(tmp_path)), "0.0").record
    assert made.kind == "worker"
    assert f"the worker has specmap {__version__}, the client 0.0" in str(made.reason)
    assert list(tmp_path.iterdir()) == []


def test_a_job_whose_worker_dies_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Real workers, one of which is killed by its job."""
    monkeypatch.setattr(workers, "on_worker", at_once)
    names = ("deadly", "a", "b")
    ledger = Ledger([job(name) for name in names], dict.fromkeys(names, 1))
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0
        ) as local,
        distributed.Client(local) as client,
        Workers(client, Terms("")) as some,
    ):
        happened = list(work_off(some, 1, ledger))
    (retried,) = (one for one in happened if one is not None and one.event == "retried")
    assert (retried.job, retried.kind) == ("deadly", "worker")
    assert str(retried.reason).startswith("the worker died with the job (tcp://127.0.0.1:")
    assert ledger.done == 3
    assert ledger.results["deadly"].attempts == 2


@contextmanager
def running(program: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", f"distributed.cli.dask_{program}", "--no-dashboard"]
    command += arguments
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_scheduler_in_another_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a worker it is refused; with one it does the jobs, which fail as their logs ask."""
    (out := tmp_path / "out").mkdir()
    (out / "summary.csv").write_text("of the batch before")
    terms, jobs = Terms(str(out), scratch=str(tmp_path)), [job("lost"), job("gone")]
    said = tmp_path / "scheduler.json"
    listening = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(said))
    with running("scheduler", *listening) as process:
        while process.poll() is None and not (said.exists() and said.stat().st_size):
            time.sleep(0.05)
        scheduler = json.loads(said.read_text(encoding="utf-8"))["address"]
        for address, answer_s, told in (
            ("tcp://127.0.0.1:9", 0.2, r"tcp://127\.0\.0\.1:9: no Dask scheduler answers"),
            (scheduler, 10.0, "no worker has come in 0 s: start one with `dask worker`"),
        ):
            monkeypatch.setattr(workers, "_ANSWER_S", answer_s)
            with pytest.raises(UsageError, match=told):
                run_batch(jobs, terms, Cluster(scheduler=address, patience_s=0.1))
            assert (out / "summary.csv").read_text() == "of the batch before"
        alone = ("--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path))
        with running("worker", scheduler, *alone):
            ledger = run_batch(jobs, terms, Cluster(scheduler=scheduler))
    for name in ("lost", "gone"):
        record = json.loads((out / name / "job.json").read_text(encoding="utf-8"))
        assert record["reason"] == f"/logs/{name}.mcap: no such file or directory"
        assert ledger.results[name].kind == "log"
        assert record["limits"]["memory_mb"] > 0  # the worker's share


def _tripled(number: int) -> int:
    if number < 0:
        raise MapError(f"{number}: not a map")
    return 3 * number


def _killing(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_function_of_many_things_is_spread_over_processes_or_workers_of_a_scheduler(
    client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is killed on the way, as for want of memory, is told of."""
    assert spread(Cluster(2), _tripled, [1, 2, 3]) == [3, 6, 9]
    with pytest.raises(MapError, match="-1: not a map"):
        spread(Cluster(2), _tripled, [-1, *range(9)])
    with pytest.raises(NoResultError, match="a worker was killed"):
        spread(Cluster(1), _killing, [1])
    monkeypatch.setattr(workers, "_connected", lambda *_: nullcontext(client))
    assert spread(Cluster(scheduler="inproc:"), _tripled, [1, 2]) == [3, 6]


def test_a_failed_worker_stops_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "run_job", at_once)
    ledger = run_batch([job("a"), job("buggy")], Terms(str(tmp_path)), Cluster(2))
    assert (ledger.done, ledger.failed) == (1, 1)
    assert ledger.results["buggy"].reason == "the worker failed: ValueError: a bug of the worker"

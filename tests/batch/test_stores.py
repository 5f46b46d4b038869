"""Stores that fsspec knows, and temporary directories: whole, private, and killed in between."""

import importlib.util
import itertools
import json
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from specmap_cli.batch import places
from specmap_cli.batch.jobs import jobs_of
from specmap_cli.batch.places import (
    PlaceError,
    files_in,
    folder_at,
    path_at,
    reaching,
    scratch_directory,
    store_at,
    write_record,
)
from specmap_cli.batch.records import Job, JobRecord, JobResult, Terms, Turn
from specmap_cli.batch.running import run_job
from specmap_cli.batch.sources import bytes_of, fetched
from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.files import lock
from tests.batch.results import ALL, faked

fsspec = pytest.importorskip("fsspec")
pytest.importorskip("psutil")

OUT = "memory://bucket/maps"


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Any:
    """An empty store in memory, and the fake program in the place of specmap."""
    faked(monkeypatch)
    system = fsspec.filesystem("memory")
    monkeypatch.setattr(type(system), "store", {})
    monkeypatch.setattr(type(system), "pseudo_dirs", [""])
    return system


def put(system: Any, path: str, words: str = "fine") -> str:
    system.pipe(f"/bucket/{path}", words.encode())
    return f"memory://bucket/{path}"


def run(job: Job, output: str, scratch: Path) -> JobResult:
    return run_job(Turn(job), Terms(output, scratch=str(scratch)))


def record_of(log: str, scratch: Path, name: str = "monday") -> JobRecord:
    return run(Job(name, (log,), ALL), OUT, scratch).record


def names(system: Any, folder: str = "/bucket/maps") -> set[str]:
    return {path.removeprefix(f"{folder}/") for path in system.find(folder)}


def test_a_job_from_store_to_store(store: Any, tmp_path: Path) -> None:
    put(store, "logs/monday.mcap", "fine")
    (job,) = jobs_of(["memory://bucket/logs"])
    assert (job.name, job.logs) == ("monday", ("memory:///bucket/logs/monday.mcap",))
    assert bytes_of(job) == 4
    result = run(job, OUT, tmp_path).record
    assert (result.state, result.reason) == ("done", None)
    assert names(store, "/bucket/maps/monday") == {*result.files, "job.json"}
    assert {"map/part-0", "report.html", "log.txt"} <= set(result.files)
    assert list(tmp_path.iterdir()) == []
    assert run(job, OUT, tmp_path).resumed
    put(store, "logs/monday.mcap", "changed")
    assert not run(job, OUT, tmp_path).resumed
    assert b"changed" in store.cat("/bucket/maps/monday/map/part-0")
    store.rm("/bucket/maps/monday/report.html")
    assert folder_at(OUT, "monday").stored() is None


def test_a_reason_names_the_log_as_the_user_does(store: Any, tmp_path: Path) -> None:
    url = "memory://bucket/logs/monday.mcap"
    for told in ("no such file or directory", "cut off after 12 bytes; no message can be read"):
        record = record_of(url, tmp_path)
        assert (record.kind, record.reason) == ("log", f"{url}: {told}")
        assert names(store, "/bucket/maps/monday") - {"log.txt"} == {"job.json"}
        put(store, "logs/monday.mcap", "damaged")


def test_what_is_found_in_a_store_and_fetched_whole(store: Any, tmp_path: Path) -> None:
    bag = ("bag/metadata.yaml", "bag/bag_0.db3", "bag/bag_1.db3")
    others = ("b/notes.txt", ".x/c.mcap", "map/topology.json", "map/keyframes.mcap")
    for path in ("a.mcap", "b/run.bag.zst", *bag, *others):
        put(store, f"logs/{path}", path)
    found = {job.name: job.logs[0] for job in jobs_of(["memory://bucket/logs"])}
    under = {name: log.rsplit("logs/")[1] for name, log in found.items()}
    assert under == {"a": "a.mcap", "b-run": "b/run.bag.zst", "bag": "bag"}
    for pattern in ("*.mcap", "a.mcap"):
        assert [job.name for job in jobs_of([f"memory://bucket/logs/{pattern}"])] == ["a"]
    with pytest.raises(LogError, match="no recording there"):
        jobs_of(["memory://bucket/none"])
    ((log, place),) = fetched((found["bag"],), tmp_path).items()
    assert (log, Path(place).name) == (found["bag"], "bag")
    texts = {f"bag/{path.name}": path.read_text() for path in Path(place).iterdir()}
    assert texts == {name: name for name in bag}


@pytest.mark.parametrize("name", ["bag/../../../../escaped.db3", ".."])
def test_a_name_in_a_store_stays_in_the_scratch(name: str, store: Any, tmp_path: Path) -> None:
    put(store, "logs/bag/metadata.yaml")
    put(store, f"logs/{name}")
    place = tmp_path / "a" / "b" / "c"
    place.mkdir(parents=True)
    log = "memory://bucket/logs" if name == ".." else "memory://bucket/logs/bag"
    with pytest.raises(LogError, match="a name that leads out of the log: rename it"):
        fetched([log], place)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_logs_that_do_not_fit_into_the_scratch_are_refused(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = put(store, "logs/monday.mcap", "x" * 3_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=1_000_000))
    result = record_of(url, tmp_path)
    assert result.kind == "place"
    told = "the logs need 3 MB, 1 MB are free: choose another scratch directory"
    assert str(result.reason).endswith(told)


def test_a_log_that_did_not_arrive_whole_is_told_of_in_parts(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = put(store, "logs/monday.mcap", "fine")
    monkeypatch.setattr(store, "get_file", lambda _, place: Path(place).write_bytes(b"fin"))
    with pytest.raises(PlaceError) as told:
        fetched([url], tmp_path)
    assert told.value.where == "memory:///bucket/logs/monday.mcap"
    assert told.value.found == "3 of 4 bytes arrived: it changed, or the connection broke"
    assert told.value.hint == "run the job again"


class _Cut(BaseException):
    """As when the process is killed: nothing is put right after it."""


def test_cut_off_at_any_call_there_is_a_complete_result_or_none(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = record_of(put(store, "logs/monday.mcap"), tmp_path)
    old, new = tmp_path / "old", tmp_path / "new"
    store.get("/bucket/maps/monday", str(old), recursive=True)
    shutil.copytree(old, new)
    part = new / "map" / "part-0"
    part.write_text(part.read_text().upper())  # as long as the old one
    (new / "job.begun").unlink(missing_ok=True)
    write_record(new, result.model_copy(update={"files": files_in(new), "attempts": 2}))

    def publish(source: Path) -> None:
        """What a job makes becomes its result in the store."""
        with folder_at(OUT, "monday").fresh(Path(mkdtemp(dir=tmp_path))) as directory:
            shutil.copytree(source, directory, dirs_exist_ok=True)

    seen: set[int | None] = set()
    whole = False
    for calls in itertools.count(1):
        publish(old)
        with monkeypatch.context() as context, suppress(_Cut):
            _cut_after(store, context, calls)
            publish(new)
            whole = True
        stored = folder_at(OUT, "monday").stored()
        seen.add(None if stored is None else stored.attempts)
        if stored is not None:  # it is one of the two, whole
            source = old if stored.attempts == 1 else new
            for name in stored.files:
                assert store.cat(f"/bucket/maps/monday/{name}") == (source / name).read_bytes()
        if whole:
            break
    assert seen == {1, None, 2}
    assert names(store, "/bucket/maps/monday") == {*files_in(new), "job.json"}


def _cut_after(system: Any, monkeypatch: pytest.MonkeyPatch, calls: int) -> None:
    """The process ends before the call number `calls` that writes or removes."""
    left = iter(range(calls - 1))

    def counted(real: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            if next(left, None) is None:
                raise _Cut
            return real(*arguments, **options)

        return call

    for name in ("pipe_file", "rm_file", "put_file"):
        monkeypatch.setattr(system, name, counted(getattr(system, name)))


def test_what_somebody_else_keeps_in_the_store_is_not_touched_and_what_cannot_be_reached_told(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = put(store, "logs/monday.mcap")
    put(store, "maps/monday/thesis.txt", "years of work")
    assert record_of(url, tmp_path).kind == "settings"
    assert names(store, "/bucket/maps/monday") == {"thesis.txt"}

    monkeypatch.setattr(store, "put_file", Mock(side_effect=ConnectionError("the line is\ncut")))
    result = record_of(url, tmp_path, "tuesday")
    assert result.kind == "place", "it may be tried again"
    assert str(result.reason).endswith("cannot be reached or used: the line is cut")


def test_what_is_a_store_and_what_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert path_at("s3:/x") == Path("s3:/x")
    assert path_at(f"file://{tmp_path}") == tmp_path
    (tmp_path / "a.mcap").write_bytes(b"x")
    assert jobs_of([f"file://{tmp_path}/a.mcap"])[0].logs == (str(tmp_path / "a.mcap"),)
    with pytest.raises(UsageError, match="nowhere"):
        store_at("nowhere://x/y")
    with pytest.raises(PlaceError), reaching("here"):
        raise RuntimeError("anything")
    monkeypatch.setitem(sys.modules, "fsspec", None)  # without the extra
    with pytest.raises(UsageError, match=r"pip install 'specmap-cli\[batch\]'"):
        store_at("s3://bucket/logs")


def test_what_killed_runs_left_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left, other = tmp_path / "specmap-job-0123abcd", tmp_path / "specmap-job-thesis"
    for directory in (left, other):
        directory.mkdir()
    with scratch_directory(str(tmp_path)) as first, scratch_directory(str(tmp_path)) as second:
        assert set(tmp_path.iterdir()) == {first, second, other}
        assert stat.S_IMODE(first.stat().st_mode) == 0o700
    assert list(tmp_path.iterdir()) == [other]
    monkeypatch.setattr(places, "lock", lambda _: False)  # a system without locks
    with scratch_directory(str(tmp_path)) as directory:
        assert set(tmp_path.iterdir()) == {directory, other}
    assert list(tmp_path.iterdir()) == [other]


def test_a_swept_directory_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The other run has its lock already, and removes it only later."""
    locked = lock
    refused = iter([True])
    monkeypatch.setattr(places, "lock", lambda one: not next(refused, False) and locked(one))
    with scratch_directory(str(tmp_path)) as directory:
        assert list(tmp_path.iterdir()) == [directory]
        descriptor = os.open(directory, os.O_RDONLY)
        assert not locked(descriptor)  # it is ours alone
        os.close(descriptor)


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A bucket of a server that speaks as S3 does."""
    for name in ("s3fs", "moto", "flask"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"needs {name}: pip install s3fs 'moto[server]'")
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for key, value in {
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(key, value)
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    s3fs.S3FileSystem().mkdir("fleet")
    yield "s3://fleet"
    s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


@pytest.mark.filterwarnings("ignore")  # of libraries that only this test uses
def test_a_bucket(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faked(monkeypatch)
    system, _ = store_at(bucket)
    system.pipe_file("fleet/logs/monday.mcap", b"fine")
    (job,) = jobs_of([f"{bucket}/logs"])
    first = run(job, f"{bucket}/maps", tmp_path).record
    assert (first.state, first.reason) == ("done", None)
    record = json.loads(system.cat_file("fleet/maps/monday/job.json"))
    assert record["files"]["map/part-0"] == system.info("fleet/maps/monday/map/part-0")["size"]
    assert run(job, f"{bucket}/maps", tmp_path).resumed
    system.pipe_file("fleet/logs/monday.mcap", b"fine too")
    assert not run(job, f"{bucket}/maps", tmp_path).resumed
    missing = Job("gone", (f"{bucket}/logs/gone.mcap",), ALL)
    assert run(missing, f"{bucket}/maps", tmp_path).record.kind == "log"
    nowhere = run(job, "s3://no-such-bucket/maps", tmp_path).record
    assert nowhere.kind == "place", nowhere.reason

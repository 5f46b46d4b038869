"""A batch beside somebody else on the machine: no port, no file that he may write, no link."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.batch.batch import EventRecord, run_batch
from specmap_cli.batch.places import taken
from specmap_cli.batch.records import Job, Step, Terms
from specmap_cli.batch.workers import Cluster, spread
from specmap_cli.core.errors import UsageError
from tests.batch.results import faked

psutil = pytest.importorskip("psutil")
NEIGHBOUR: Any = {"user": 65534, "group": 65534, "extra_groups": [], "cwd": "/"}  # nobody


class SeenError(Exception):
    """A batch was looked at while it ran."""


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that others reach, as those of pytest are not."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def sockets(_: int = 0) -> set[tuple[object, ...]]:
    """The sockets at which this process and its children can be spoken to."""
    me = psutil.Process()
    return {
        (one.pid, each.laddr)
        for one in (me, *me.children(recursive=True))
        for each in one.net_connections("all")
        if each.laddr and not each.raddr
    }


def seen_running(folder: Path, monkeypatch: pytest.MonkeyPatch, look: Callable[[], None]) -> None:
    """Look at a batch of two workers, both of which write their results."""
    pytest.importorskip("distributed")
    faked(monkeypatch)
    logs = [folder / "monday.mcap", folder / "tuesday.mcap"]
    for log in logs:
        log.write_text("slow")
    out = folder / "maps"

    def tell(event: EventRecord) -> None:
        if event.event == "started" and event.job == "tuesday":
            end = time.monotonic() + 60
            while len(list(out.glob(".*/.map.partial-*/half"))) < 2 and time.monotonic() < end:
                time.sleep(0.01)
            look()
            raise SeenError

    terms = Terms(str(out), scratch=str(folder / "scratch"))
    jobs = [Job(log.stem, (str(log),), (Step("build"),)) for log in logs]
    with pytest.raises(SeenError):
        run_batch(jobs, terms, Cluster(2), 0, tell)


def test_nobody_can_speak_to_the_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they had a scheduler at a port, any user ran code as the caller."""
    before = sockets()
    found: list[set[tuple[object, ...]]] = []
    seen_running(tmp_path, monkeypatch, lambda: found.append(sockets()))
    assert found == [before]
    assert spread(Cluster(2), sockets, [0, 1]) == [set(), set()]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as somebody else")
def test_a_neighbour_may_write_nothing_of_a_batch_and_see_no_temporary_file(
    shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []

    def look() -> None:
        for test in (["-writable"], ["-path", "*/scratch/specmap-job-*/*"]):
            command = ["/usr/bin/find", str(shared), *test]
            told.append(subprocess.run(command, capture_output=True, text=True, **NEIGHBOUR).stdout)

    seen_running(shared, monkeypatch, look)
    assert told == ["", ""]


@pytest.mark.parametrize("kind", ["link", "nowhere", "pipe"])
def test_what_a_neighbour_put_for_the_journal_is_not_written(kind: str, tmp_path: Path) -> None:
    """In a folder of his a batch wrote its lines into a file of the caller, or waited for ever."""
    precious, journal = tmp_path / "precious", tmp_path / "maps" / "events.jsonl"
    journal.parent.mkdir()
    if kind == "pipe":
        os.mkfifo(journal)
    else:
        journal.symlink_to(precious)
    if kind == "link":
        precious.write_text("precious")
    told = r"events\.jsonl: cannot be written: is a link or no regular file"
    with pytest.raises(UsageError, match=told), taken(str(journal.parent)):
        pass
    assert precious.exists() == (kind == "link")
    assert not precious.exists() or precious.read_text() == "precious"

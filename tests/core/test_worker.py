"""Work done ahead in a child process: the same items, the same errors, and nothing left behind."""

import copyreg
import multiprocessing
import os
import platform
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from specmap_cli.core import worker as module
from specmap_cli.core.errors import InputError, LogError, SpecmapError
from specmap_cli.core.process import give_memory_back
from specmap_cli.core.worker import ahead
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.writing import write_scans
from specmap_cli.pipelines import finishing
from specmap_cli.pipelines.build import build_map
from tests.flats import QUICK, record_tour
from tests.maps.test_store import files_in


@pytest.fixture
def two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "processors", lambda: 2)


Work = Generator[int, None, int]


def pids(count: int) -> Work:
    """The process that makes the items, again and again; returns how many there were."""
    for _ in range(count):
        yield os.getpid()
    return count


class StubbornError(Exception):
    """An error that cannot be made again from what it was pickled as."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


@pytest.mark.parametrize(
    ("processors", "said", "platform", "apart"),
    [
        ({0, 1}, "", "linux", True),
        ({0, 1}, "2", "linux", True),
        ({0, 1}, "1", "linux", False),  # others need the second one
        ({0}, "", "linux", False),
        ({0, 1}, "", "darwin", False),
    ],
)
def test_work_is_done_ahead_where_it_can_be(
    processors: set[int], said: str, platform: str, apart: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: processors)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setenv("SPECMAP_PROCESSES", said)
    with ahead(lambda: pids(3)) as work:
        assert (set(work) != {os.getpid()}) == apart
        assert work.result == 3
    with ahead(lambda: pids(3), worthwhile=False) as work:
        assert set(work) == {os.getpid()}


@pytest.mark.usefixtures("two_processors")
def test_another_thread_works_in_one_process() -> None:
    def work() -> list[int]:
        with ahead(lambda: pids(1)) as items:
            return list(items)

    with ThreadPoolExecutor() as pool:
        assert pool.submit(work).result() == [os.getpid()]


@pytest.mark.usefixtures("two_processors")
class TestChild:
    def test_the_items_come_in_order_and_as_they_were_and_the_result_after_them(self) -> None:
        made = [(k, np.arange(k, dtype=np.float32)) for k in range(300)]
        with ahead(lambda: (each for each in made)) as items:
            for (number, array), (expected, original) in zip(items, made, strict=True):
                assert number == expected
                np.testing.assert_array_equal(array, original)
        with ahead(lambda: pids(3)) as running:
            next(running)
            assert running.result == 3  # what was not taken is skipped
            assert running.result == 3

    @pytest.mark.parametrize("count", [3, 10**9], ids=["at the end", "early"])
    def test_they_are_made_in_one_process_that_is_gone_when_they_are_left(self, count: int) -> None:
        with ahead(lambda: pids(count)) as items:
            (maker,) = {maker for maker, _ in zip(items, range(3), strict=False)}
        assert maker != os.getpid()
        assert multiprocessing.active_children() == []
        with pytest.raises(ProcessLookupError):
            os.kill(maker, 0)

    @pytest.mark.parametrize(
        ("error", "kind", "words"),
        [
            (LogError("log.mcap: damaged"), LogError, r"^log\.mcap: damaged$"),
            (ZeroDivisionError("a bug"), ZeroDivisionError, "^a bug"),
            (FileNotFoundError(2, "gone", "/nowhere"), FileNotFoundError, "/nowhere"),
            (StubbornError("this", "that"), RuntimeError, "^StubbornError: this and that"),
            (ValueError("locked", threading.Lock()), RuntimeError, "ValueError: .*locked"),
        ],
    )
    def test_an_error_comes_after_the_items_before_it_or_is_told_as_itself(
        self, error: Exception, kind: type[Exception], words: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """One that is not meant for the user comes with its place."""
        # Dask, imported after this module, can send every error that there is by then
        monkeypatch.delitem(copyreg.dispatch_table, StubbornError, raising=False)

        def work() -> Work:
            os.kill(os.getpid(), signal.SIGINT)  # for the parent to decide
            yield 1
            raise error

        with ahead(work) as items:
            assert next(items) == 1
            with pytest.raises(kind, match=words) as caught:
                next(items)
        notes = getattr(caught.value, "__notes__", [])
        assert notes == [] if kind is LogError else "in work" in notes[0]

    @pytest.mark.parametrize("size", [10, 100_000, 10_000_000])
    def test_a_child_that_dies_in_the_middle_of_a_message_is_an_error(self, size: int) -> None:
        """The pipe is smaller than the message: the child waits in the middle of it."""

        def work() -> Generator[bytes, None, None]:
            yield bytes(size)
            threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGKILL)).start()
            while True:
                yield bytes(size)

        with ahead(work) as items:
            next(items)
            time.sleep(0.5)
            with pytest.raises(InputError, match="was killed, as a"):
                deque(items, maxlen=0)

    @pytest.mark.parametrize("cut", [1, 3, 4, 5, 40])
    def test_half_a_message_is_told_as_the_death_of_the_child(self, cut: int) -> None:
        """Also when the child dies between two bytes: of the length, or of what follows it."""
        receiver, sender = multiprocessing.get_context("fork").Pipe(duplex=False)
        whole = struct.pack("!i", 100) + bytes(100)
        os.write(sender.fileno(), whole[:cut])
        sender.close()
        child = multiprocessing.get_context("fork").Process(target=os._exit, args=(7,))
        child.start()
        with receiver, pytest.raises(SpecmapError, match="ended with status 7"):
            next(module._received(receiver, child))

    @pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
    def test_a_child_that_somebody_ended_is_an_interruption(self, number: int, code: int) -> None:
        receiver, sender = multiprocessing.get_context("fork").Pipe(duplex=False)
        sender.close()
        child = Mock(exitcode=-number)
        with receiver, pytest.raises(SpecmapError) as caught:
            next(module._received(receiver, child))
        assert (caught.value.exit_code, caught.value.code) == (code, "interrupted")

    def test_threads_of_opencv_are_as_before(self) -> None:
        before = cv2.getNumThreads()
        try:
            cv2.setNumThreads(2)
            with ahead(lambda: pids(1)) as items:
                list(items)
            assert cv2.getNumThreads() == 2
        finally:
            cv2.setNumThreads(before)

    def test_it_waits_for_a_slow_reader(self) -> None:
        """What is made ahead waits in the pipe, and no more than fits there."""
        made = multiprocessing.get_context("fork").Value("i", 0)

        def work() -> Generator[bytes, None, None]:
            for _ in range(1000):
                made.value += 1
                yield bytes(100_000)

        with ahead(work) as items:
            next(items)
            time.sleep(0.3)
            assert made.value < 20


def test_small_items_travel_together_and_large_ones_alone() -> None:
    sender = Mock()
    module._send_items(iter(range(1000)), sender)
    small = len(sender.send.mock_calls)
    module._send_items(iter([bytes(1_000_000)] * 5), sender)
    large = len(sender.send.mock_calls) - small
    assert small <= 2
    assert large in {5, 6}


def test_a_killed_parent_leaves_no_child() -> None:
    code = """
import os
from specmap_cli.core import worker as module
module.processors = lambda: 2
def work():
    while True:
        yield os.getpid()
with module.ahead(work) as items:
    print(next(items), flush=True)
    for _ in items:
        pass
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    child = int(process.stdout.readline())
    process.kill()
    process.wait()
    process.stdout.close()
    for _ in range(500):
        if not alive(child):
            return
        time.sleep(0.01)
    pytest.fail("the child lives on")


def alive(pid: int) -> bool:
    """Whether a process runs; one that nobody has waited for yet has ended all the same."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


def test_a_map_is_the_same_with_and_without_the_child(
    flat: GridMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def written(*given: Any) -> None:
        with (tmp_path / "writers").open("a", encoding="ascii") as writers:
            writers.write(f"{os.getpid()} ")
        write_scans(*given)

    monkeypatch.setattr(finishing, "write_scans", written)
    log = record_tour(flat, tmp_path / "tour.mcap", rate_hz=3, max_duration_s=50)
    for processors, name in ((1, "one"), (2, "two")):
        monkeypatch.setattr(module, "processors", lambda n=processors: n)
        build_map(log, tmp_path / name, QUICK)
    alone, beside = (tmp_path / "writers").read_text(encoding="ascii").split()
    assert int(alone) == os.getpid() != int(beside)
    one, two = files_in(tmp_path / "one"), files_in(tmp_path / "two")
    assert len(one) > 5
    assert [name for name in one if one[name] != two[name]] == ["run.json"], "which holds seconds"


def resident_kb() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("VmRSS:"))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps no holes")
def test_holes_between_what_is_held_go_back() -> None:
    blocks = [np.ones(12_000) for _ in range(1000)]  # 96 kB each: too small to be mapped alone
    held = blocks[99::100]  # the last among them: what lies before are holes
    full = resident_kb()
    del blocks
    give_memory_back()
    assert full - resident_kb() > 0.9 * 1000 * 12_000 * 8 / 1024
    assert sum(float(each.sum()) for each in held) == 12_000.0 * 1000 / 100

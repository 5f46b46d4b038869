"""Work done ahead in a child process: the same items, the same errors, and nothing left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.errors import LogError, SpecmapError
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines import worker as module
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.simulate import SimulationOptions, simulate
from specmap_cli.pipelines.worker import ahead


@pytest.fixture
def two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_processors", lambda: 2)


def pids(count: int) -> Iterator[int]:
    """The process that makes the items, again and again."""
    for _ in range(count):
        yield os.getpid()


@pytest.mark.usefixtures("two_processors")
class TestChild:
    def test_the_items_come_in_order_and_as_they_were(self) -> None:
        made = [(k, np.arange(k, dtype=np.float32)) for k in range(300)]
        with ahead(lambda: iter(made)) as items:
            for (number, array), (expected, original) in zip(items, made, strict=True):
                assert number == expected
                np.testing.assert_array_equal(array, original)

    def test_they_are_made_in_another_process_that_is_gone_afterwards(self) -> None:
        with ahead(lambda: pids(3)) as items:
            makers = set(items)
        assert len(makers) == 1
        assert makers != {os.getpid()}
        assert multiprocessing.active_children() == []
        with pytest.raises(ProcessLookupError):
            os.kill(makers.pop(), 0)

    def test_leaving_early_ends_the_child(self) -> None:
        with ahead(lambda: pids(10**9)) as items:
            maker = next(items)
        with pytest.raises(ProcessLookupError):
            os.kill(maker, 0)

    def test_an_error_meant_for_the_user_comes_as_it_was_after_the_items_before_it(self) -> None:
        def work() -> Iterator[int]:
            yield 1
            raise LogError("log.mcap: damaged")

        with ahead(work) as items:
            assert next(items) == 1
            with pytest.raises(LogError, match=r"^log\.mcap: damaged$") as caught:
                next(items)
        assert not hasattr(caught.value, "__notes__")

    def test_a_bug_tells_where_it_is(self) -> None:
        def faulty() -> Iterator[float]:
            yield 1 / 0

        with ahead(faulty) as items, pytest.raises(ZeroDivisionError) as caught:
            next(items)
        assert "in faulty" in caught.value.__notes__[0]

    def test_errors_of_the_system_keep_their_number(self) -> None:
        def work() -> Iterator[int]:
            yield len(Path("/nowhere/log.mcap").read_bytes())

        with ahead(work) as items, pytest.raises(FileNotFoundError) as caught:
            next(items)
        assert caught.value.filename == "/nowhere/log.mcap"

    def test_a_child_that_was_killed_is_an_error(self) -> None:
        def work() -> Iterator[int]:
            yield 1
            os.kill(os.getpid(), signal.SIGKILL)

        with ahead(work) as items, pytest.raises(SpecmapError, match="status -9"):
            list(items)

    def test_ctrl_c_is_for_the_parent_to_decide(self) -> None:
        def work() -> Iterator[int]:
            os.kill(os.getpid(), signal.SIGINT)
            yield 7

        with ahead(work) as items:
            assert list(items) == [7]

    def test_it_waits_for_a_slow_reader(self) -> None:
        """What is made ahead waits in the pipe, and no more than fits there."""
        made = multiprocessing.get_context("fork").Value("i", 0)

        def work() -> Iterator[bytes]:
            for _ in range(1000):
                made.value += 1
                yield bytes(100_000)

        with ahead(work) as items:
            next(items)
            time.sleep(0.3)
            assert made.value < 20


@pytest.mark.usefixtures("two_processors")
def test_another_thread_works_in_one_process() -> None:
    makers: list[int] = []

    def work() -> None:
        with ahead(lambda: pids(1)) as items:
            makers.extend(items)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert makers == [os.getpid()]


def test_a_single_processor_works_in_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_processors", lambda: 1)
    with ahead(lambda: pids(2)) as items:
        assert set(items) == {os.getpid()}


def test_a_killed_parent_leaves_no_child() -> None:
    code = """
import os
from specmap_cli.pipelines import worker as module
module._processors = lambda: 2
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
    log = tmp_path / "tour.mcap"
    robot = SimulationOptions(beams=91, rate_hz=5, max_duration_s=60, seed=2)
    simulate(flat, robot, log)
    quick = {"recognition": {"rounds": 4}, "localization": {"augmentation": 20}}
    for processors, name in ((1, "one"), (2, "two")):
        monkeypatch.setattr(module, "_processors", lambda n=processors: n)
        build_map([log], tmp_path / name, load_config(None, None, quick))
    files = [path for path in sorted((tmp_path / "one").rglob("*")) if path.is_file()]
    assert len(files) > 5
    for path in files:
        if path.name != "run.json":  # which holds seconds
            other = tmp_path / "two" / path.relative_to(tmp_path / "one")
            assert path.read_bytes() == other.read_bytes(), path.name

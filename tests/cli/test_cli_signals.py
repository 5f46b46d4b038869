"""Ctrl-C and SIGTERM: the exit code says so, and nothing half-written is left."""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from specmap_cli.cli.entry import ConsoleProgress, Interruption, interruptible
from tests.cli.conftest import QUICK, ROOT, Run, leftovers, spawn

SIGNALS = [signal.SIGINT, signal.SIGTERM]


@pytest.fixture
def _handlers_are_as_before() -> Iterator[None]:
    before = [signal.getsignal(number) for number in SIGNALS]
    yield
    assert [signal.getsignal(number) for number in SIGNALS] == before


@pytest.mark.usefixtures("_handlers_are_as_before")
class TestInThisProcess:
    """The signal comes at a certain step of the work."""

    @pytest.mark.parametrize("number", SIGNALS)
    @pytest.mark.parametrize("step", [1, 40, 62])
    @pytest.mark.parametrize("present", [False, True])
    def test_a_build(
        self,
        step: int,
        number: int,
        present: bool,
        tiny_log: Path,
        tmp_path: Path,
        run: Run,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        if present:
            (tmp_path / "map").mkdir()
            mine = '{"schema_version": 2}'
            (tmp_path / "map" / "topology.json").write_text(mine, encoding="utf-8")
        raise_at(step, number, monkeypatch)
        said = run("build", tiny_log, "-o", tmp_path / "map", "--overwrite", *QUICK)
        assert said.code == 128 + number
        name = signal.Signals(number).name
        assert said.error == f"interrupted by {name}; nothing half-written is left"
        left = [path.name for path in tmp_path.rglob("*")]
        assert left == (["map", "topology.json"] if present else [])

    @pytest.mark.parametrize("step", [1, 3])
    def test_what_writes_a_single_file(
        self,
        step: int,
        plan: Path,
        tiny_log: Path,
        tiny_map: Path,
        tmp_path: Path,
        run: Run,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        for line in (
            ("simulate", plan, "-o", tmp_path / "tour.mcap", "--max-duration", "1"),
            ("convert", tiny_log, tmp_path / "copy.mcap"),
            ("localize", tiny_log, "--map", tiny_map, "-o", tmp_path / "labels.csv"),
        ):
            raise_at(step, signal.SIGTERM, monkeypatch)
            assert run(*line).code == 143
            assert list(tmp_path.iterdir()) == []

    def test_impatience_does_not_stop_the_cleaning_up(self) -> None:
        cleaned = False

        def work() -> None:
            nonlocal cleaned
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(5)
            finally:
                os.kill(os.getpid(), signal.SIGTERM)
                cleaned = True

        with interruptible(), pytest.raises(Interruption) as caught:
            work()
        assert cleaned
        assert (caught.value.name, caught.value.exit_code) == ("SIGINT", 130)

    def test_a_thread_runs_without_signals(self) -> None:
        def work() -> bool:
            with interruptible():
                return True

        with ThreadPoolExecutor() as pool:
            assert pool.submit(work).result()


def raise_at(step: int, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the process receive a signal at the given step of the progress."""
    steps, original = itertools.count(1), ConsoleProgress.advance

    def advance(self: ConsoleProgress, done: int = 1) -> None:
        if next(steps) == step:
            os.kill(os.getpid(), number)
        original(self, done)

    monkeypatch.setattr(ConsoleProgress, "advance", advance)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_process_told_twice(number: int, tmp_path: Path) -> None:
    """The build of a long log, interrupted once its hidden directory is there."""
    process = spawn("build", ROOT / "sample_logs" / "office.mcap", "-o", tmp_path / "deep" / "map")
    while process.poll() is None and not leftovers(tmp_path):
        time.sleep(0.01)
    for _ in range(2):
        process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (128 + number, "")
    assert err.splitlines()[-1].startswith("specmap: error: interrupted by SIG")
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []

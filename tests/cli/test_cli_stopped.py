"""A run that is interrupted, or for which there is too little of the disk or of the memory."""

import itertools
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli.cli.entry import ConsoleProgress, Interruption, interruptible
from tests.cli.conftest import QUICK, ROOT, Outcome, Run, leftovers, ran, spawn, standing_log

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")


def limited(limits: Mapping[int, int], *arguments: str | Path) -> Outcome:
    """What a command leaves in a process of limits."""

    def limit() -> None:
        for which, most in limits.items():
            resource.setrlimit(which, (most, most))

    ended = ran(*arguments, preexec_fn=limit)
    assert "Traceback" not in ended.err
    return ended


def test_more_files_than_may_be_open(tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    parts.mkdir()
    for number in range(30):
        standing_log(parts / f"{number:02}.mcap", 3.0, scans=2)
    told = "Too many open files; give fewer files at once, or raise the limit with `ulimit -n`"
    said = limited({resource.RLIMIT_NOFILE: 24}, "info", parts)
    said.fails(3, f"{parts}/", f".mcap: cannot read: {told}")


TOO_LARGE = "File too large; see `ulimit -f`, or"


@pytest.mark.parametrize(
    ("what", "most", "told"),
    [
        ("build", 500, f"temporary files cannot be written: {TOO_LARGE}"),
        ("build", 2000, f"out: cannot be written: {TOO_LARGE} choose another output"),
        ("convert", 500, f"out: cannot be written: {TOO_LARGE} choose"),
    ],
)
def test_files_that_may_not_grow(tmp_path: Path, what: str, most: int, told: str) -> None:
    log = standing_log(tmp_path / "log.mcap", 3.0)
    out = tmp_path / "out"
    options = QUICK if what == "build" else ()
    limited({resource.RLIMIT_FSIZE: most}, what, log, "-o", out, *options).fails(2, told)
    assert leftovers(tmp_path) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap"]


def test_a_picture_that_does_not_fit_into_memory(tmp_path: Path) -> None:
    path = tmp_path / "plan.png"
    cv2.imwrite(str(path), np.zeros((9000, 9000), dtype=np.uint8))
    limits = {resource.RLIMIT_AS: 700_000_000}
    smaller = "a shorter log or a coarser grid (--set grid.resolution_m) needs less"
    said = limited(limits, "segment", path, "--resolution", "0.05", "-o", tmp_path / "rooms")
    said.fails(3, "not enough memory", smaller)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["plan.png"]


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
        with ThreadPoolExecutor() as pool:
            assert pool.submit(interruptible()(dict)).result() == {}


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

"""Output directories appear complete or not at all, whatever happens meanwhile."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import subprocess
import sys
import textwrap
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.maps import directory as leftovers
from specmap_cli.maps import directory as module
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.filenames import TOPOLOGY


def fill(directory: Path, words: str = "new") -> None:
    (directory / TOPOLOGY).write_text(words)
    (directory / "submaps").mkdir()
    (directory / "submaps" / "000.png").write_text(words)


def fill_and_raise(directory: Path, error: type[BaseException]) -> None:
    fill(directory)
    raise error


def a_map(path: Path) -> Path:
    path.mkdir()
    fill(path, "old")
    return path


def hidden(parent: Path) -> list[str]:
    return sorted(entry.name for entry in parent.iterdir() if entry.name.startswith("."))


def test_appears_complete(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with OutputDirectory(out) as partial:
        assert partial.parent == tmp_path
        fill(partial)
        assert not out.exists()
    assert (out / "submaps" / "000.png").read_text() == "new"
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_interruption_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), OutputDirectory(tmp_path / "a" / "b" / "out") as partial:
        fill_and_raise(partial, error)
    assert os.listdir(tmp_path) == []


def test_an_interruption_keeps_the_old_map(tmp_path: Path) -> None:
    out = a_map(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt), OutputDirectory(out, overwrite=True) as partial:
        fill_and_raise(partial, KeyboardInterrupt)
    assert (out / TOPOLOGY).read_text() == "old"
    assert hidden(tmp_path) == []


def test_missing_parents_are_made(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path / "a" / "b" / "out") as partial:
        fill(partial)
    assert (tmp_path / "a" / "b" / "out" / TOPOLOGY).is_file()


def test_an_existing_map_needs_overwrite(tmp_path: Path) -> None:
    out = a_map(tmp_path / "out")
    with pytest.raises(UsageError, match="--overwrite"), OutputDirectory(out):
        pytest.fail("entered")
    assert hidden(tmp_path) == []


def test_overwrite_replaces_the_whole_map(tmp_path: Path) -> None:
    out = a_map(tmp_path / "out")
    (out / "submaps" / "007.png").write_text("stale")
    with OutputDirectory(out, overwrite=True) as partial:
        fill(partial)
        assert (out / TOPOLOGY).read_text() == "old"
    assert (out / TOPOLOGY).read_text() == "new"
    assert os.listdir(out / "submaps") == ["000.png"]
    assert hidden(tmp_path) == []


def test_an_empty_directory_is_used(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with OutputDirectory(tmp_path / "out") as partial:
        fill(partial)
    assert (tmp_path / "out" / TOPOLOGY).is_file()


@pytest.mark.parametrize("overwrite", [False, True])
def test_foreign_data_is_never_touched(tmp_path: Path, overwrite: bool) -> None:
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter1.tex").write_text("years of work")
    with pytest.raises(UsageError, match="no map"), OutputDirectory(out, overwrite):
        pytest.fail("entered")
    assert (out / "chapter1.tex").read_text() == "years of work"


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_at_the_target_is_refused(tmp_path: Path, overwrite: bool) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(UsageError, match="is a file"), OutputDirectory(tmp_path / "out", overwrite):
        pytest.fail("entered")
    assert (tmp_path / "out").read_text() == "a file"


def test_a_file_as_the_parent_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(UsageError, match=r"cannot write there.*Not a directory") as caught,
        OutputDirectory(tmp_path / "file" / "out"),
    ):
        pytest.fail("entered")
    assert "\n" not in str(caught.value)


def test_a_link_to_a_map_stays_a_link(tmp_path: Path) -> None:
    a_map(tmp_path / "real")
    link = tmp_path / "link"
    link.symlink_to("real")
    with OutputDirectory(link, overwrite=True) as partial:
        fill(partial)
    assert link.is_symlink()
    assert (tmp_path / "real" / TOPOLOGY).read_text() == "new"


def test_a_dangling_link_leads_to_its_target(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("real")
    with OutputDirectory(tmp_path / "link") as partial:
        fill(partial)
    assert (tmp_path / "real" / TOPOLOGY).read_text() == "new"


def test_links_in_an_old_map_are_not_followed(tmp_path: Path) -> None:
    out = a_map(tmp_path / "out")
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").write_text("kept")
    (out / "link").symlink_to(tmp_path / "precious")
    with OutputDirectory(out, overwrite=True) as partial:
        fill(partial)
    assert (tmp_path / "precious" / "file").read_text() == "kept"


@pytest.mark.parametrize("place", ["/", "/proc/specmap_out"])
def test_hopeless_places_are_refused(place: str) -> None:
    with pytest.raises(UsageError), OutputDirectory(Path(place)):
        pytest.fail("entered")


def test_a_target_that_turns_up_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UsageError, match="--overwrite"), OutputDirectory(out):
        a_map(out)
    assert (out / TOPOLOGY).read_text() == "old"
    assert hidden(tmp_path) == []


def test_a_failing_swap_restores_the_old_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = a_map(tmp_path / "out")
    rename = os.rename

    def failing(source: Path, target: Path) -> None:
        if ".partial-" in str(source):
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(module, "exchanged", lambda *_: False)  # as on other systems
    monkeypatch.setattr(os, "rename", failing)
    with (
        pytest.raises(UsageError, match="Input/output error"),
        OutputDirectory(out, overwrite=True) as partial,
    ):
        fill(partial)
    assert (out / TOPOLOGY).read_text() == "old"
    assert hidden(tmp_path) == []


def test_a_signal_in_the_middle_of_the_swap_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = a_map(tmp_path / "out")
    rename = os.rename

    def interrupted(source: Path, target: Path) -> None:
        rename(source, target)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(module, "exchanged", lambda *_: False)  # as on other systems
    monkeypatch.setattr(os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt), OutputDirectory(out, overwrite=True) as partial:
        fill(partial)
    assert (out / TOPOLOGY).read_text() == "new"
    assert hidden(tmp_path) == []


def test_a_path_may_be_text_and_relative(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with OutputDirectory("maps/out/") as partial:
        assert partial.is_absolute()
        monkeypatch.chdir("/")  # whoever runs inside may go elsewhere
        fill(partial)
    assert (tmp_path / "maps" / "out" / TOPOLOGY).is_file()


def test_parents_that_somebody_uses_meanwhile_stay(tmp_path: Path) -> None:
    with suppress(KeyboardInterrupt), OutputDirectory(tmp_path / "a" / "b" / "out") as partial:
        (tmp_path / "a" / "notes.txt").write_text("mine")
        fill_and_raise(partial, KeyboardInterrupt)
    assert os.listdir(tmp_path) == ["a"]
    assert os.listdir(tmp_path / "a") == ["notes.txt"]


def test_of_two_writers_of_one_place_the_first_wins(tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, second = OutputDirectory(out), OutputDirectory(out)
    for writer, words in ((first, "first"), (second, "second")):
        fill(writer.__enter__(), words)
    first.__exit__(None, None, None)
    with pytest.raises(UsageError, match="already holds a map: use --overwrite"):
        second.__exit__(None, None, None)
    assert (out / TOPOLOGY).read_text() == "first"
    assert hidden(tmp_path) == []


def test_another_thread_writes_as_well(tmp_path: Path) -> None:
    """Only the main thread can hold signals back; others must not try."""

    def write() -> Path:
        with OutputDirectory(tmp_path / "out", overwrite=True) as partial:
            fill(partial)
        return partial

    a_map(tmp_path / "out")
    with ThreadPoolExecutor(1) as threads:
        partial = threads.submit(write).result()
    assert not partial.exists()
    assert (tmp_path / "out" / TOPOLOGY).read_text() == "new"


def test_handlers_of_signals_are_those_from_before(tmp_path: Path) -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with OutputDirectory(tmp_path / "out") as partial:
        fill(partial)
    assert {number: signal.getsignal(number) for number in before} == before


def interrupted_at(event: int, out: Path) -> bool:
    """Overwrite `out`, with SIGINT at one event of tracing; False when the write has fewer.

    Events are the lines, calls and returns of the modules that an output directory is made with.
    """
    counted = 0
    ours = {module.__file__, leftovers.__file__, contextlib.__file__, weakref.__file__}

    def trace(frame: FrameType, _event: str, _argument: object) -> Any:
        nonlocal counted
        if frame.f_code.co_filename not in ours:
            return None
        counted += 1
        if counted == event:
            os.kill(os.getpid(), signal.SIGINT)
        return trace

    before = sys.gettrace()
    gc.disable()  # what earlier writes left must not be taken back in this one
    sys.settrace(trace)
    try:
        with OutputDirectory(out, overwrite=True) as partial:
            fill(partial)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
        gc.enable()
    return counted >= event


def test_an_interruption_at_any_line_leaves_a_whole_map(tmp_path: Path) -> None:
    out = a_map(tmp_path / "out")
    handler = signal.getsignal(signal.SIGINT)
    event = 1
    while interrupted_at(event, out):
        if len(os.listdir(tmp_path)) > 1:
            gc.collect()  # the object goes at the latest with the process
        assert os.listdir(tmp_path) == ["out"], event
        assert (out / "submaps" / "000.png").is_file(), event
        assert signal.getsignal(signal.SIGINT) is handler, event
        event += 1
    assert event > 100


WRITER = """
import signal, sys
from pathlib import Path
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.filenames import TOPOLOGY

def stop(number, frame):
    raise SystemExit(143)

signal.signal(signal.SIGTERM, stop)
print("ready", flush=True)
while True:
    with OutputDirectory(Path(sys.argv[1]), overwrite=True) as partial:
        for name in (TOPOLOGY, "a", "b", "c"):
            (partial / name).write_text("x")
"""


def test_sigterm_at_any_moment_leaves_a_whole_map_or_none(tmp_path: Path) -> None:
    for i in range(6):
        parent = tmp_path / str(i)
        parent.mkdir()
        command = [sys.executable, "-c", textwrap.dedent(WRITER), str(parent / "out")]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(0.004 * i)
            process.terminate()
            assert process.wait(timeout=20) == 143
        assert set(os.listdir(parent)) <= {"out"}
        if (parent / "out").exists():
            assert sorted(os.listdir(parent / "out")) == sorted([TOPOLOGY, "a", "b", "c"])

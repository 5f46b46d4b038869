"""Output directories appear complete or not at all, whatever happens meanwhile.

Runs that are killed at any moment are tried in `tests/cli/test_cli_kills.py`.
"""

import contextlib
import gc
import os
import signal
import sys
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.files import held
from specmap_cli.core.progress import Silent
from specmap_cli.maps import directory as module
from specmap_cli.maps.directory import OutputDirectory, put_right
from specmap_cli.maps.filenames import TOPOLOGY
from specmap_cli.maps.store import read_map
from specmap_cli.maps.writing import MapResult, write_map

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def fill(directory: Path, words: str = "new") -> None:
    (directory / TOPOLOGY).write_text(f'{{"schema_version": "{words}"}}')
    (directory / "submaps").mkdir()
    (directory / "submaps" / "000.png").write_text(words)


def words_of(directory: Path) -> str:
    return (directory / "submaps" / "000.png").read_text()


def fill_and_raise(directory: Path, error: type[BaseException], *others: Path) -> None:
    fill(directory)
    for path in others:
        path.write_text("mine")
    raise error


def write(out: Path) -> None:
    with OutputDirectory(out, overwrite=True) as partial:
        fill(partial)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    fill(tmp_path / "out", "old")
    return tmp_path / "out"


@contextlib.contextmanager
def handled_by(handler: Any) -> Iterator[None]:
    """What the process does when it is told to end, and what it did before."""
    before = {number: signal.signal(number, handler) for number in SIGNALS}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def hidden(parent: Path) -> list[str]:
    return sorted(entry.name for entry in parent.iterdir() if entry.name.startswith("."))


@pytest.mark.parametrize("place", ["out", "a/b/out", "empty", "dangling"])
def test_appears_complete_and_missing_parents_are_made(tmp_path: Path, place: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "dangling").symlink_to("real")
    out = tmp_path / place
    with OutputDirectory(out) as partial:
        assert partial.parent == out.parent
        fill(partial)
        assert not (out / TOPOLOGY).exists()
    assert words_of(out) == "new"
    assert hidden(out.parent) == []
    assert (tmp_path / "real").exists() == (place == "dangling")


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_interruption_leaves_nothing_of_ours(tmp_path: Path, error: type[BaseException]) -> None:
    for notes in ([], [tmp_path / "a" / "notes.txt"]):
        with pytest.raises(error), OutputDirectory(tmp_path / "a" / "b" / "out") as partial:
            fill_and_raise(partial, error, *notes)
        assert os.listdir(tmp_path) == ["a"] * len(notes)
    assert os.listdir(tmp_path / "a") == ["notes.txt"]


def test_overwrite_replaces_the_whole_map_and_follows_no_link(tmp_path: Path, out: Path) -> None:
    (out / "submaps" / "007.png").write_text("stale")
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").write_text("kept")
    (out / "link").symlink_to(tmp_path / "precious")
    with OutputDirectory(out, overwrite=True) as partial:
        fill(partial)
        assert words_of(out) == "old"
    assert words_of(out) == "new"
    assert os.listdir(out / "submaps") == ["000.png"]
    assert (tmp_path / "precious" / "file").read_text() == "kept"
    assert hidden(tmp_path) == []


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    ("place", "complaint"),
    [
        ("thesis", "no map"),
        ("program", r"holds no map \(no topology.json of specmap in it\)"),
        ("thesis/chapter1.tex", "is a file"),
        ("thesis/chapter1.tex/out", r"cannot write there.*Not a directory"),
        ("/", "not a place for a map"),
        ("/proc/specmap_out", "cannot write there"),
    ],
)
def test_what_is_no_place_for_a_map_is_refused_and_never_touched(
    tmp_path: Path, place: str, complaint: str, overwrite: bool
) -> None:
    chapter = tmp_path / "thesis" / "chapter1.tex"
    chapter.parent.mkdir()
    chapter.write_text("years of work")
    (tmp_path / "program" / "src").mkdir(parents=True)
    (tmp_path / "program" / TOPOLOGY).write_text('{"mine": 1}')  # a name alone makes no map
    refused = OutputDirectory(tmp_path / place, overwrite)
    with pytest.raises(UsageError, match=complaint) as caught, refused:
        pytest.fail("entered")
    assert "\n" not in str(caught.value)
    assert chapter.read_text() == "years of work"
    assert (tmp_path / "program" / "src").is_dir()


def test_of_two_writers_of_one_place_the_first_wins(tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, second = OutputDirectory(out), OutputDirectory(out)
    for writer, words in ((first, "first"), (second, "second")):
        fill(writer.__enter__(), words)
    first.__exit__(None, None, None)
    with pytest.raises(UsageError, match="already holds a map: use --overwrite"):
        second.__exit__(None, None, None)
    assert words_of(out) == "first"
    assert hidden(tmp_path) == []


def test_a_failing_swap_is_undone(
    tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = os.rename

    def failing(source: Path, target: Path) -> None:
        if ".partial-" in str(source):
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(module, "exchanged", lambda *_: False)  # as on other systems
    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(UsageError, match="Input/output error"):
        write(out)
    assert words_of(out) == "old"
    assert hidden(tmp_path) == []


def test_a_path_may_be_text_and_relative(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with OutputDirectory("maps/out/") as partial:
        assert partial.is_absolute()
        monkeypatch.chdir("/")  # whoever runs inside may go elsewhere
        fill(partial)
    assert (tmp_path / "maps" / "out" / TOPOLOGY).is_file()


def test_a_link_to_a_map_stays_and_another_thread_may_write(tmp_path: Path, out: Path) -> None:
    """Only the main thread can hold signals back; others must not try."""
    link = tmp_path / "link"
    link.symlink_to("out")
    with ThreadPoolExecutor(1) as threads:
        threads.submit(write, link).result()
    assert hidden(tmp_path) == []
    assert link.is_symlink()
    assert words_of(out) == "new"


@pytest.mark.parametrize(("first", "other"), [SIGNALS, SIGNALS[::-1]])
def test_a_signal_while_handlers_are_put_back_swallows_no_other(
    out: Path, monkeypatch: pytest.MonkeyPatch, first: signal.Signals, other: signal.Signals
) -> None:
    """One waits while the map is put in place, the other comes as soon as its handler is back."""
    told: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        told.append(number)
        raise SystemExit

    put = signal.signal

    def signal_between(number: int, handler: Any) -> Any:
        replaced = put(number, handler)
        if number == other and handler is stop and not told:
            os.kill(os.getpid(), other)
        return replaced

    def renamed(source: Path, target: Path) -> None:
        rename(source, target)
        monkeypatch.setattr(signal, "signal", signal_between)
        os.kill(os.getpid(), first)

    rename = os.rename
    monkeypatch.setattr(module, "exchanged", lambda *_: False)  # as on other systems
    monkeypatch.setattr(os, "rename", renamed)
    with handled_by(stop):
        with pytest.raises(SystemExit):
            write(out)
        for number in (first, other):
            with contextlib.suppress(SystemExit):
                os.kill(os.getpid(), number)
    assert told == [other, first, first, other]
    assert words_of(out) == "new"
    assert hidden(out.parent) == []


def interrupted_at(event: int, out: Path) -> bool:
    """Overwrite `out`, with a signal at one event of tracing; False when the write has fewer.

    Events are the lines, calls and returns of the modules that an output directory is made with.
    """
    counted = 0
    ours = {module.__file__, contextlib.__file__, weakref.__file__}

    def trace(frame: FrameType, _event: str, _argument: object) -> Any:
        nonlocal counted
        if frame.f_code.co_filename not in ours:
            return None
        counted += 1
        if counted == event:
            os.kill(os.getpid(), SIGNALS[event % 2])
        return trace

    before = sys.gettrace()
    gc.disable()  # what earlier writes left must not be taken back in this one
    sys.settrace(trace)
    try:
        write(out)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
        gc.enable()
    return counted >= event


def test_an_interruption_at_any_line_leaves_a_whole_map(tmp_path: Path, out: Path) -> None:
    event = 1
    with handled_by(signal.default_int_handler):
        while interrupted_at(event, out):
            if len(os.listdir(tmp_path)) > 1:
                gc.collect()  # the object goes at the latest with the process
            assert os.listdir(tmp_path) == ["out"], event
            assert (out / "submaps" / "000.png").is_file(), event
            for number in SIGNALS:
                assert signal.getsignal(number) is signal.default_int_handler, event
            event += 1
    assert event > 100


def test_a_map_that_was_moved_away_comes_back(
    tmp_path: Path, result: MapResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed between two renames: there is no map in its place, and the next run says so."""
    out = tmp_path / "map"
    with OutputDirectory(out) as partial:
        write_map(partial, replace(result, frame="old"))
    os.rename(out, tmp_path / ".map.replaced-0123abcd")
    notes: list[str] = []
    monkeypatch.setattr(Silent, "note", lambda _, line: notes.append(line))
    with pytest.raises(UsageError, match="already holds a map"):
        OutputDirectory(out).__enter__()
    assert read_map(out).record.graph.frame == "old"
    killed = f"{out}: an earlier run was killed: "
    assert notes == [f"{killed}restored the map that it had moved away as .map.replaced-0123abcd"]


def test_what_a_living_run_writes_is_left_alone(tmp_path: Path) -> None:
    partial = tmp_path / ".map.partial-89abcdef"
    partial.mkdir()
    with held(partial):
        assert put_right(tmp_path / "map") == []
        assert partial.is_dir()
    assert len(put_right(tmp_path / "map")) == 1
    assert not partial.exists()


FOREIGN = [
    *(".map.partial-12", ".map.partial-0123456g", ".map.partial-01234567.bak"),
    *(".other.partial-01234567", "map.partial-01234567"),
    ".map.replaced-01234567",  # without a map in it
]


@pytest.mark.parametrize("name", FOREIGN)
def test_what_is_not_certainly_ours_is_left_alone(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "mine.txt").write_text("mine")
    (tmp_path / ".map.partial-01234567").symlink_to(tmp_path / name)
    assert put_right(tmp_path / "map") == []
    assert (tmp_path / name / "mine.txt").read_text() == "mine"

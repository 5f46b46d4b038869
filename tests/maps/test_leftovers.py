"""Runs that are killed, at any moment: the old map or the new one is whole, and the next run well.

A child process writes a map and kills itself at one call of the system that makes, renames, writes
or removes something: at the first, at the second, and so on to the last.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.progress import Silent
from specmap_cli.maps import directory as module
from specmap_cli.maps.directory import OutputDirectory, held, put_right
from specmap_cli.maps.store import read_map
from specmap_cli.maps.writing import MapResult, write_map

CALLS = ("rename", "replace", "mkdir", "rmdir", "unlink", "open")


def write(out: Path, result: MapResult, frame: str) -> None:
    """Write the small house to `out`, told apart by the name of its frame."""
    with OutputDirectory(out, overwrite=True) as partial:
        write_map(partial, replace(result, frame=frame))


def killing(at: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A stub that counts the calls of all functions it stands for, and kills the process at one."""
    counted = [0]

    def around(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            counted[0] += 1
            if counted[0] == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **named)

        return call

    return around


def killed_at(
    at: int, out: Path, result: MapResult, calls: Sequence[str], *, at_once: bool
) -> bool:
    """Overwrite the map in a child that dies at one of its `calls`; False when it came to its end.

    `at` is the number of the call.
    """
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            stub = killing(at)
            for name in calls:
                setattr(os, name, stub(getattr(os, name)))
            if "open" in calls:
                Path.open = stub(Path.open)  # type: ignore[method-assign]
            if not at_once:
                module.exchanged = lambda *_: False
            write(out, result, "new")
            code = 0
        finally:
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    died = os.WIFSIGNALED(status)
    assert died or os.waitstatus_to_exitcode(status) == 0
    return died


@pytest.mark.parametrize(
    ("at_once", "calls", "least"),
    [(True, CALLS, 20), (False, ("rename",), 3)],  # nothing else differs one by one
    ids=["exchanged", "one by one"],
)
def test_a_run_killed_at_any_call_leaves_a_whole_map(
    at_once: bool,
    calls: Sequence[str],
    least: int,
    tmp_path: Path,
    result: MapResult,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    out, old = tmp_path / "map", tmp_path_factory.mktemp("old") / "map"
    write(old, result, "old")
    moments = 0
    died = True
    while died:
        moments += 1
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(old, out)
        died = killed_at(moments, out, result, calls, at_once=at_once)
        if out.exists():  # not between the two renames
            assert read_map(out).record.graph.frame in ("old", "new")
            assert len(read_map(out).topology.submaps) == 3
        write(out, result, "next")
        assert read_map(out).record.graph.frame == "next"
        assert [path.name for path in tmp_path.iterdir()] == ["map"], moments
    assert moments > least


def test_a_map_that_was_moved_away_comes_back(
    tmp_path: Path, result: MapResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed between two renames: there is no map in its place, and the next run says so."""
    out = tmp_path / "map"
    write(out, result, "old")
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

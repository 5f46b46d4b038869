"""`build` and `localize` killed at any moment: old or new outputs are whole, the next run is well.

A child runs the command and stops before every call that makes, renames, removes, opens for writing
or writes something beside the output. What the disk has then is what a kill would leave: it is
copied and looked at. At some of these moments another child is killed in earnest.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.cli import main
from specmap_cli.maps import directory as map_directory
from specmap_cli.maps.directory import put_right
from specmap_cli.maps.store import read_map
from tests.cli.conftest import QUICK, leftovers

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks, as Linux does them safely")

EVENTS = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate"}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT

Stop = Callable[[], None]


class Half:
    """An open file that stops in the middle of every write."""

    def __init__(self, file: Any, stop: Stop) -> None:
        self._file = file
        self._stop = stop

    def write(self, data: Any) -> int:
        middle = len(data) // 2
        self._file.write(data[:middle])
        self._file.flush()
        self._stop()
        return middle + int(self._file.write(data[middle:]))

    def __enter__(self) -> Half:
        self._file.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._file.__exit__(*error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def watch(place: Path, stop: Stop) -> None:
    """Call `stop` before whatever this process changes in `place`, until it ends."""
    inside = [False]

    def stopped() -> None:
        if not inside[0]:
            inside[0] = True
            stop()
            inside[0] = False

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        opens = event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITING
        if (opens or event in EVENTS) and str(arguments[0]).startswith(f"{place}/"):
            stopped()

    opened, exchanged = Path.open, map_directory.exchanged

    def open_half(path: Path, mode: str = "r", *arguments: Any, **named: Any) -> Any:
        file = opened(path, mode, *arguments, **named)
        watched = "w" in mode and str(path).startswith(f"{place}/")
        return Half(file, stopped) if watched else file

    def exchange(one: Path, other: Path) -> bool:
        stopped()
        return exchanged(one, other)

    sys.addaudithook(hook)
    Path.open = open_half  # type: ignore[method-assign, assignment]
    map_directory.exchanged = exchange
    os.environ["SPECMAP_PROCESSES"] = "1"


def in_child(command: Sequence[str], place: Path, stop: Stop) -> int:
    """Run a command in a child that is watched; what `os.waitpid` says of its end."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            watch(place, stop)
            code = main([*command, "--quiet", "--json"])
        finally:
            os._exit(code)
    return os.waitpid(pid, 0)[1]


def snapshots(command: Sequence[str], place: Path, copies: Path) -> list[Path]:
    """Copies of `place` as it is before each change that the command makes, in order."""
    numbers = itertools.count(1)

    def stop() -> None:
        shutil.copytree(place, copies / f"{next(numbers):04}", symlinks=True)

    copies.mkdir()
    assert in_child(command, place, stop) == 0
    return sorted(copies.iterdir())


def kill_at(moment: int, command: Sequence[str], place: Path) -> None:
    """Run the command in a child that kills itself before its change number `moment`."""
    moments = itertools.count(1)

    def stop() -> None:
        if next(moments) == moment:
            os.kill(os.getpid(), signal.SIGKILL)

    assert os.WIFSIGNALED(in_child(command, place, stop))


def seed_of(path: Path) -> int:
    """The seed that a map was built with; every file of it is read."""
    stored = read_map(path)
    assert stored.classifiers
    assert len(stored.labels.stamps_ns)
    assert stored.map_grid.cells.size
    assert len(stored.topology.submaps) == len(stored.ids) > 0
    return stored.config.seed


def digest(place: Path) -> str:
    """What tells the contents of two directories apart."""
    found = hashlib.sha256()
    for path in sorted(place.rglob("*")):
        found.update(f"{path.relative_to(place)}\0".encode())
        found.update(path.read_bytes() if path.is_file() else b"")
    return found.hexdigest()


@pytest.mark.parametrize("at_once", [True, False], ids=["exchanged", "one by one"])
def test_a_build(
    at_once: bool, tiny_log: Path, tiny_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not at_once:
        monkeypatch.setattr(map_directory, "exchanged", lambda *_: False)
    place = tmp_path / "place"
    shutil.copytree(tiny_map, place / "map")
    command = ["build", str(tiny_log), "-o", str(place / "map"), "--overwrite", "--set", "seed=7"]
    command += QUICK
    copies = snapshots(command, place, tmp_path / "copies")
    seeds, known = [], dict[str, int]()
    for copy in copies:
        moved_away = not (copy / "map").exists()
        assert moved_away == any("restored the map" in note for note in put_right(copy / "map"))
        content = digest(copy / "map")
        if content not in known:  # most copies hold the same map
            known[content] = seed_of(copy / "map")
        seeds.append(known[content])
        assert leftovers(copy) == []
    assert len(copies) > 30
    assert seeds == sorted(seeds)  # 0 is the old one, 7 the new
    assert {seeds[0], seeds[-1]} == {0, 7}
    shutil.rmtree(place)
    shutil.copytree(tiny_map, place / "map")
    kill_at(len(copies) // 2, command, place)
    assert main([*command, "--quiet"]) == 0
    assert seed_of(place / "map") == 7
    assert [path.name for path in place.iterdir()] == ["map"]


def test_localize_with_a_plot(tiny_log: Path, tiny_map: Path, tmp_path: Path) -> None:
    place = tmp_path / "place"
    table, plot = place / "labels.csv", place / "plot.png"
    command = ["localize", str(tiny_log), "--map", str(tiny_map), "--output", str(table)]
    command += ["--plot", str(plot), "--overwrite"]

    def begin() -> None:
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        table.write_text("old table\n")
        plot.write_text("old plot\n")

    begin()
    copies = snapshots(command, place, tmp_path / "copies")
    new = {path.name: path.read_bytes() for path in (table, plot)}
    old = {"labels.csv": b"old table\n", "plot.png": b"old plot\n"}
    assert len(copies) >= 6
    for copy in copies:
        for name in old:
            assert (copy / name).read_bytes() in (old[name], new[name])
    begin()
    kill_at(len(copies) // 2, command, place)
    assert leftovers(place)
    assert main([*command, "--quiet"]) == 0
    assert {path.name: path.read_bytes() for path in place.iterdir()} == new

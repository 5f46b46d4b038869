"""What sections work with: the data, a folder, and maps that several of them look at."""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.cost.processes import SPECMAP, Cost, measure
from benchmarks.data import recording

MakeLog = Callable[[Path], object]  # writes a recording to a file


class Bench:
    """A folder of one run of the scoreboard. Maps are built once, by whichever section needs them.

    Sections run in processes of their own, so each map has a lock.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        (self.folder / "maps").mkdir(parents=True, exist_ok=True)

    def recorded(self, name: str, *options: str) -> Path:
        """The map of a real recording, such as `fr079`, with some options of `build`."""
        return self._made(
            "-".join([name, *options]), lambda out: build(recording(name), out, *options)
        )

    def simulated(self, name: str, make: MakeLog, *options: str) -> Path:
        """The map of a recording that `make` writes; the recording stays beside it."""

        def built(out: Path) -> None:
            log = self.log(name)
            make(log)
            build(log, out, *options)

        return self._made(name, built)

    def log(self, name: str) -> Path:
        """Where the recording of a simulated map is, and its truth as `.tum` where it has one."""
        return self.folder / "maps" / f"{name}.mcap"

    def adopt(self, name: str, map_: Path) -> None:
        """Keep the map of a real recording that was built while the time was taken."""
        self._made(name, lambda out: shutil.copytree(map_, out))

    def _made(self, name: str, make: Callable[[Path], object]) -> Path:
        out = self.folder / "maps" / name
        with _locked(out.with_suffix(".lock")):
            if not out.exists():
                make(out)
        return out

    @contextmanager
    def scratch(self, name: str) -> Iterator[Path]:
        """A folder for one section, gone after it."""
        folder = self.folder / "scratch" / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def build(log: Path, out: Path, *options: str) -> Cost:
    """Build a map as a user would."""
    command = [SPECMAP, "build", str(log.resolve()), "-o", str(out), "--overwrite", "-q", *options]
    return measure(command, out.parent)


def verdict_of(map_: Path) -> str:
    """What a map thinks of itself."""
    quality = json.loads((map_ / "topology.json").read_text(encoding="utf-8"))["graph"]["quality"]
    return str(quality["verdict"])


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield

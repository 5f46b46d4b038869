"""Sections of the scoreboard in processes of their own: timed ones alone, others three at once."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2

from benchmarks.data import missing
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.digest import ROOT, digest
from benchmarks.scoreboard.rows import Figure, Row, Section, figure
from specmap_cli.core.process import one_blas_thread

AT_ONCE = 3  # of two processors: one may wait for a map that another builds
_POLL_S = 0.2


@dataclass(frozen=True, slots=True)
class Done:
    """What came of a section: its figures by key, the seconds it took, or why there are none."""

    figures: Mapping[str, Figure]
    seconds: float = 0.0
    why: str = ""


def rows_of(section: Section) -> Sequence[Row]:
    """The rows of a section."""
    rows: Sequence[Row] = importlib.import_module(section.module).ROWS
    return rows


def measure(section: Section, folder: Path) -> Done:
    """Measure a section in this process; what it prints is kept beside its figures."""
    start = time.perf_counter()
    lacking = missing(section.needs)
    if lacking:
        return Done({}, why=f"no data: {lacking}")
    told = _Both()
    cv2.setNumThreads(1)  # several sections run at a time
    with contextlib.redirect_stdout(told), one_blas_thread():
        found = importlib.import_module(section.module).measure(Bench(folder))
    figures = {key: figure(value) for key, value in found.items()}
    _check(section, figures)
    _file(folder, section, "txt").write_text(told.getvalue(), encoding="utf-8")
    done = Done(figures, time.perf_counter() - start)
    _file(folder, section, "json").write_text(json.dumps(asdict(done)), encoding="utf-8")
    return done


class _Both(io.StringIO):
    """Text that is shown and kept."""

    def write(self, text: str) -> int:
        sys.__stdout__.write(text)  # type: ignore[union-attr]
        sys.__stdout__.flush()  # type: ignore[union-attr]
        return super().write(text)


def _check(section: Section, figures: Mapping[str, Figure]) -> None:
    """A section measures its rows, all of them and no others."""
    keys = [row.key for row in rows_of(section)]
    if sorted(keys) != sorted(figures):
        raise RuntimeError(f"{section.name}: rows {sorted(keys)}, figures {sorted(figures)}")


def read(section: Section, folder: Path) -> Done | None:
    """What a section gave in this folder, None if it was not measured there."""
    path = _file(folder, section, "json")
    if not path.exists():
        return None
    kept = json.loads(path.read_text(encoding="utf-8"))
    figures = {key: Figure(**value) for key, value in kept["figures"].items()}
    return Done(figures, kept["seconds"])


def _file(folder: Path, section: Section, kind: str) -> Path:
    path = folder / "sections" / f"{section.name}.{kind}"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def folder_of(work: Path) -> Path:
    """The folder of this tree; those of other trees are removed."""
    mine = work / digest()
    for other in work.iterdir() if work.is_dir() else ():
        if other != mine:
            shutil.rmtree(other, ignore_errors=True)
    mine.mkdir(parents=True, exist_ok=True)
    return mine


def run(sections: Sequence[Section], folder: Path) -> dict[str, Done]:
    """Measure what is not measured yet: the timed sections first, one at a time.

    Raises RuntimeError when the tree is changed meanwhile.
    """
    found = dict[str, Done]()
    waiting = []
    for section in sections:
        lacking = missing(section.needs)
        done = Done({}, why=f"no data: {lacking}") if lacking else read(section, folder)
        if done is None:
            waiting.append(section)
        else:
            found[section.name] = done
    for some, at_once in (
        ([section for section in waiting if section.timed], 1),
        ([section for section in waiting if not section.timed], AT_ONCE),
    ):
        found |= _run(some, folder, at_once)
    if digest() != folder.name:
        raise RuntimeError("the sources were changed while they were measured: start again")
    return found


def _run(sections: list[Section], folder: Path, at_once: int) -> dict[str, Done]:
    """Some sections, so many at a time, in their order."""
    waiting, running, found = list(sections), list[_Running](), dict[str, Done]()
    while waiting or running:
        while waiting and len(running) < at_once:
            running.append(_Running(waiting.pop(0), folder))
        for each in [each for each in running if each.process.poll() is not None]:
            running.remove(each)
            found[each.section.name] = each.done(folder)
        time.sleep(_POLL_S)
    return found


class _Running:
    """A section that is being measured by a process."""

    def __init__(self, section: Section, folder: Path) -> None:
        self.section, self.start = section, time.perf_counter()
        self.log = _file(folder, section, "log")
        command = [sys.executable, "-m", "benchmarks.scoreboard", "--section", section.name]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [*command, "--work", str(folder)],
                cwd=ROOT,
                env=os.environ,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def done(self, folder: Path) -> Done:
        """What came of it, told in a line."""
        found = read(self.section, folder)
        if found is None:
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            found = Done({}, why=f"failed: {lines[-1] if lines else 'no word'}")
        seconds = time.perf_counter() - self.start
        print(f"{self.section.name:24} {seconds:6.0f} s  {found.why}", flush=True)
        return found

"""A tiny log and its map, made once a session, and a way to run a command and see what it says."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import typer

from specmap_cli.cli import main
from specmap_cli.cli.app import app
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.schemas import read_schema
from specmap_cli.logs.writer import LogWriter
from tests.flats import Mapped
from tests.sharing import made_once

ROOT = Path(__file__).parents[2]
# training would take most of the time of a tiny build
QUICK = ("--set", "recognition.rounds=4", "--set", "localization.augmentation=10")
ERROR = "specmap: error: "
COMMANDS: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]
ERROR_SCHEMA = "error"  # of what any command prints when it fails
# The schemas of the JSON files that are written: in map directories, and beside pages and tables.
FILE_SCHEMAS = {
    "topology.json": "topology",
    "run.json": "run",
    "classifiers.json": "classifiers",
    "compare.json": "comparison",
    "history.json": "history",
    "job.json": "job",
}
START_NS = 1_700_000_000 * 10**9

Run = Callable[..., "Outcome"]


@dataclass(frozen=True)
class Outcome:
    """What a command left: its exit code and what it said."""

    code: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The one line of an error; nothing may have gone to stdout."""
        assert self.out == ""
        return self.line

    @property
    def line(self) -> str:
        """The one line of an error, whatever stdout has."""
        *notes, line = self.err.splitlines()
        assert line.startswith(ERROR)
        assert not any(note.startswith(ERROR) for note in notes)
        return line.removeprefix(ERROR)

    @property
    def result(self) -> Any:
        """What a command that succeeded printed with `--json`."""
        assert self.code == 0
        return json.loads(self.out)

    def fails(self, code: int, *told: str) -> None:
        """It ended with this code, and its one line has all these words."""
        assert self.code == code
        for words in told:
            assert words in self.error


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process: `run("info", path) -> Outcome`. A bug raises."""

    def run_command(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        hold_to_schema(arguments, captured.out)
        return Outcome(code, captured.out, captured.err)

    return run_command


def hold_to_schema(arguments: Sequence[str | Path], out: str) -> None:
    """What a command printed with `--json` must be as its schema says, an error as that of errors.

    `schema NAME` prints a schema.
    """
    words = [str(word) for word in arguments]
    if "--json" not in words or not out:
        return
    for found in map(json.loads, out.splitlines()) if words[0] == "batch" else [json.loads(out)]:
        if "$schema" in found:
            jsonschema.Draft202012Validator.check_schema(found)
        else:
            validate(found, ERROR_SCHEMA if "error" in found else name_of_command(words[0]))


def name_of_command(command: str) -> str:
    """The schema of what a command prints with `--json`: its own name, but for `compare`."""
    return "comparison" if command == "compare" else command


def validate(found: Any, name: str) -> None:
    """`found` must be as the schema of that name says."""
    jsonschema.Draft202012Validator(read_schema(name)).validate(found)


def command(*arguments: str | Path) -> list[str]:
    """The command line of a process of its own."""
    return [sys.executable, "-m", "specmap_cli", *map(str, arguments)]


def spawn(*arguments: str | Path, **options: Any) -> subprocess.Popen[str]:
    """A command as a process of its own, its stdout and stderr in pipes unless given."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **options.pop("env", {})}
    return subprocess.Popen(command(*arguments), text=True, env=environment, **options)


def ran(*arguments: str | Path, **options: Any) -> Outcome:
    """What a command left that has run as a process of its own; see `spawn`."""
    with spawn(*arguments, **options) as process:
        out, err = process.communicate(timeout=300)
    return Outcome(process.returncode, out or "", err or "")


def leftovers(directory: Path) -> list[str]:
    """Names of files that no command may leave."""
    return [path.name for path in directory.rglob(".*")]


@pytest.fixture(scope="session")
def tiny_map(tiny_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of the tiny log: one submap. Not to be changed."""

    def make(folder: Path) -> Path:
        assert main(["build", str(tiny_log), "-o", str(folder / "map"), "--quiet", *QUICK]) == 0
        return folder / "map"

    return made_once(tmp_path_factory, "tiny_map", make)


@pytest.fixture
def own_map(tiny_map: Path, tmp_path: Path) -> Path:
    """A copy of the tiny map, to be changed."""
    return Path(shutil.copytree(tiny_map, tmp_path / "own_map"))


def standing_log(
    path: Path, distance: float, topics: tuple[str, ...] = ("/scan",), scans: int = 5
) -> Path:
    """A robot that stands in a round room: scans of one distance, 91 beams over 270 degrees."""
    view = np.radians(270.0)
    with LogWriter(path) as writer:
        writer.static_transform("base_link", "laser", stamp_ns=START_NS)
        for k in range(scans):
            stamp = START_NS + k * 200_000_000
            writer.odometry("/odom", "odom", "base_link", stamp, Pose2(0.0, 0.0, 0.0))
            for topic in topics:
                ranges = np.full(91, distance)
                writer.scan(topic, "laser", stamp, -view / 2, view / 90, ranges, range_max=12.0)
    return path


@pytest.fixture
def words(
    first_tour: Mapped,
    second_tour: Mapped,
    tiny_log: Path,
    tiny_map: Path,
    plan: Path,
    tmp_path: Path,
) -> Callable[[str], list[str]]:
    """The arguments in a line of `LINES` of test_cli_schemas.py; `{out}` is `tmp_path`."""
    tum, relations = tiny_map / "trajectory.tum", tmp_path / "relations.txt"
    stamps = [line.split()[0] for line in tum.read_text(encoding="utf-8").splitlines()]
    relations.write_text(f"{stamps[0]} {stamps[-1]} 1 0 0 0 0 0\n", encoding="utf-8")
    places = {
        **{"log": tiny_log, "map": tiny_map, "tum": tum, "relations": relations, "plan": plan},
        **{"one": first_tour.map, "other": second_tour.map, "other_log": second_tour.log.log},
        **{"out": tmp_path, "quick": " ".join(QUICK)},
    }
    return lambda line: shlex.split(line.format(**places))

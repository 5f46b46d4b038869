"""The examples for CI servers and cron: their shell steps run, with the command line alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions
from tests.cli.conftest import ROOT, command, validate
from tests.exports.consumers import consumer

EXAMPLES = ROOT / "docs" / "examples"
QUICK = "[recognition]\nrounds = 4\n[localization]\naugmentation = 10\n"


@dataclass(frozen=True)
class Step:
    """Lines of a shell that a server runs, and whether it does so after a failure, too."""

    script: str
    always: bool = False


def read(name: str) -> Any:
    """An example as YAML."""
    return consumer("yaml").safe_load((EXAMPLES / name).read_text(encoding="utf-8"))


def github_steps() -> Iterator[Step]:
    """The shell steps of the workflow, but for that which installs."""
    for step in read("github.yml")["jobs"]["map"]["steps"]:
        if "run" in step and not step["run"].startswith("pip install"):
            yield Step(step["run"], always=step.get("if") == "always()")


def gitlab_steps() -> Iterator[Step]:
    """The lines of the job."""
    yield from map(Step, read("gitlab.yml")["map"]["script"])


def cron_line() -> str:
    """What cron runs: the line without its five fields of time."""
    lines = (EXAMPLES / "crontab").read_text(encoding="utf-8").splitlines()
    (line,) = [line for line in lines if not line.startswith("#")]
    assert "%" not in line  # it would end the command
    return line.split(maxsplit=5)[5]


@dataclass(frozen=True)
class Server:
    """A directory in which steps run as on a server, with `specmap` on the path."""

    place: Path
    environment: Mapping[str, str]

    def sh(self, script: str) -> subprocess.CompletedProcess[str]:
        """Run a script as CI servers do: the first line that fails ends it."""
        return subprocess.run(
            ["bash", "-e", "-o", "pipefail", "-c", script],
            cwd=self.place,
            env=dict(self.environment),
            capture_output=True,
            text=True,
            check=False,
        )

    def job(self, steps: Iterator[Step]) -> int:
        """Run a job: after a step that failed only those that always run; its exit code."""
        code = 0
        for step in steps:
            if not code or step.always:
                code = self.sh(step.script).returncode or code
        return code


@pytest.fixture(scope="module")
def logs(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Recordings of yesterday and of tonight, a map of yesterday's, and quick settings."""
    folder = tmp_path_factory.mktemp("nights")
    once = flat_options.model_copy(update={"laps": 1, "rate_hz": 3.0})
    simulate(flat, once, folder / "yesterday.mcap")
    again = once.model_copy(update={"seed": 8, "spacing_m": 1.2})
    simulate(flat, again, folder / "tonight.mcap")
    (folder / "quick.toml").write_text(QUICK, encoding="utf-8")
    line = command("build", folder / "yesterday.mcap", "-o", folder / "golden", "-q")
    config = {"SPECMAP_CONFIG": str(folder / "quick.toml"), "PYTHONPATH": str(ROOT)}
    subprocess.run(line, check=True, capture_output=True, env={**os.environ, **config})
    return folder


@pytest.fixture
def server(logs: Path, tmp_path: Path) -> Server:
    programs = tmp_path / "bin"
    programs.mkdir()
    program = programs / "specmap"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m specmap_cli "$@"\n', "utf-8")
    program.chmod(0o755)
    place = tmp_path / "maps"
    place.mkdir()
    return Server(
        place,
        {
            **os.environ,
            "PATH": f"{programs}:{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "HOME": str(tmp_path),
            "LOG": str(logs / "tonight.mcap"),
            "SPECMAP_LOG_LEVEL": "warning",
            "SPECMAP_CONFIG": str(logs / "quick.toml"),
            "GITHUB_STEP_SUMMARY": str(place / "summary.md"),
        },
    )


def failures(junit: Path) -> int:
    """How many tests failed by a JUnit file."""
    return len(ElementTree.parse(junit).findall(".//failure"))


def test_the_workflow_makes_a_map_and_checks_it(server: Server, logs: Path) -> None:
    shutil.copytree(logs / "golden", server.place / "golden")
    assert server.job(github_steps()) == 0
    assert failures(server.place / "check.xml") == 0
    assert "keeps" in (server.place / "summary.md").read_text(encoding="utf-8")
    validate(json.loads((server.place / "build.json").read_text(encoding="utf-8")), "build")
    for path in read("github.yml")["jobs"]["map"]["steps"][-1]["with"]["path"].split():
        assert (server.place / path).exists(), path


def test_the_workflow_fails_on_a_map_of_one_room_and_shows_why(
    server: Server, logs: Path, tiny_log: Path
) -> None:
    shutil.copytree(logs / "golden", server.place / "golden")
    shutil.copy(tiny_log, server.place)
    one_room = replace(server, environment={**server.environment, "LOG": tiny_log.name})
    assert one_room.job(github_steps()) == 3, "the last step finds no route to export"
    assert failures(server.place / "check.xml") > 0
    assert "golden.aligned" in (server.place / "summary.md").read_text(encoding="utf-8")
    assert (server.place / "map.html").exists(), "a person wants to see what is wrong"


def test_the_job_updates_the_map_and_says_what_changed(server: Server, logs: Path) -> None:
    shutil.copytree(logs / "golden", server.place / "golden")
    assert server.job(gitlab_steps()) == 0
    artifacts = read("gitlab.yml")["map"]["artifacts"]
    for path in [*artifacts["paths"], artifacts["reports"]["junit"]]:
        assert (server.place / path).exists(), path
    validate(json.loads((server.place / "update.json").read_text(encoding="utf-8")), "update")


def test_the_line_of_cron_keeps_a_map_and_is_silent(server: Server, logs: Path) -> None:
    shutil.copytree(logs / "golden", server.place / "map")
    shutil.copy(logs / "tonight.mcap", server.place)
    done = server.sh(cron_line())
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    before, after = (server.place / name / "run.json" for name in ("before", "map"))
    assert json.loads(before.read_text("utf-8"))["inputs"] == ["yesterday.mcap"]
    assert json.loads(after.read_text("utf-8"))["inputs"] == ["tonight.mcap"]


def test_the_line_of_cron_tells_what_is_wrong_and_leaves_the_map(
    server: Server, logs: Path, tiny_log: Path
) -> None:
    shutil.copytree(logs / "golden", server.place / "map")
    shutil.copy(tiny_log, server.place / "tonight.mcap")
    (server.place / "tonight.mcap").write_bytes(b"nothing")
    done = server.sh(cron_line())
    assert done.stderr.startswith("specmap: error: tonight.mcap: ")
    assert not (server.place / "before").exists()


def test_the_examples_use_the_command_line_alone() -> None:
    text = "\n".join(step.script for step in (*github_steps(), *gitlab_steps()))
    words = {line.split()[0] for line in text.splitlines() if line.strip()}
    assert words == {"specmap", "if", "else", "fi"}

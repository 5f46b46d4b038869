"""The examples for CI servers and cron: their shell steps run, with the command line alone."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from tests.cli.conftest import ROOT, validate
from tests.cli.loaded import write_program
from tests.flats import Mapped

EXAMPLES = ROOT / "docs" / "examples"
SETTINGS = "[recognition]\nrounds = 4\n[localization]\naugmentation = 20\n"


Step = tuple[str, bool]  # lines of a shell that a server runs, and whether after a failure, too


def read(name: str) -> Any:
    """An example as YAML."""
    return yaml.safe_load((EXAMPLES / name).read_text(encoding="utf-8"))


def github_steps() -> Iterator[Step]:
    """The shell steps of the workflow, but for that which installs."""
    for step in read("github.yml")["jobs"]["map"]["steps"]:
        if "run" in step and not step["run"].startswith("pip install"):
            yield step["run"], step.get("if") == "always()"


def gitlab_steps() -> Iterator[Step]:
    """The lines of the job."""
    yield from ((line, False) for line in read("gitlab.yml")["map"]["script"])


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
        for script, always in steps:
            if not code or always:
                code = self.sh(script).returncode or code
        return code


@pytest.fixture(scope="module")
def programs() -> Iterator[Path]:
    """The directory of `specmap`, a program that is loaded already."""
    with tempfile.TemporaryDirectory() as folder:  # the path of a socket must be short
        place = Path(folder) / "socket"
        write_program(Path(folder) / "specmap", place)
        command = [sys.executable, "-m", "tests.cli.loaded", str(place)]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        yield Path(folder)
        process.kill()
        process.communicate()


@pytest.fixture
def server(first_tour: Mapped, second_tour: Mapped, programs: Path, tmp_path: Path) -> Server:
    """With the log of tonight, which is the second tour, and the map of the first, `golden`."""
    place, settings = tmp_path / "maps", tmp_path / "quick.toml"
    settings.write_text(SETTINGS, encoding="utf-8")
    shutil.copytree(first_tour.map, place / "golden")
    return Server(
        place,
        {
            **os.environ,
            "PATH": f"{programs}:{os.environ['PATH']}",
            "HOME": str(tmp_path),
            "LOG": str(second_tour.log.log),
            "SPECMAP_LOG_LEVEL": "warning",
            "SPECMAP_CONFIG": str(settings),
            "GITHUB_STEP_SUMMARY": str(place / "summary.md"),
        },
    )


def failures(junit: Path) -> int:
    """How many tests failed by a JUnit file."""
    return len(ElementTree.parse(junit).findall(".//failure"))


def test_the_workflow_makes_a_map_and_checks_it(server: Server) -> None:
    assert server.job(github_steps()) == 0
    assert failures(server.place / "check.xml") == 0
    assert "keeps" in (server.place / "summary.md").read_text(encoding="utf-8")
    validate(json.loads((server.place / "build.json").read_text(encoding="utf-8")), "build")
    for path in read("github.yml")["jobs"]["map"]["steps"][-1]["with"]["path"].split():
        assert (server.place / path).exists(), path


def test_a_workflow_fails_on_a_map_of_one_room_and_says_why(server: Server, tiny_log: Path) -> None:
    shutil.copy(tiny_log, server.place)
    one_room = replace(server, environment={**server.environment, "LOG": tiny_log.name})
    assert one_room.job(github_steps()) == 3, "the last step finds no route to export"
    assert failures(server.place / "check.xml") > 0
    assert "golden.aligned" in (server.place / "summary.md").read_text(encoding="utf-8")
    assert (server.place / "map.html").exists(), "a person wants to see what is wrong"


def test_the_job_updates_the_map_and_says_what_changed(server: Server) -> None:
    assert server.job(gitlab_steps()) == 0
    artifacts = read("gitlab.yml")["map"]["artifacts"]
    for path in [*artifacts["paths"], artifacts["reports"]["junit"]]:
        assert (server.place / path).exists(), path
    validate(json.loads((server.place / "update.json").read_text(encoding="utf-8")), "update")


def test_the_line_of_cron_keeps_a_map_and_is_silent(server: Server) -> None:
    (server.place / "golden").rename(server.place / "map")
    shutil.copy(server.environment["LOG"], server.place / "tonight.mcap")
    done = server.sh(cron_line())
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    before, after = (server.place / name / "run.json" for name in ("before", "map"))
    assert json.loads(before.read_text("utf-8"))["inputs"] == ["first.mcap"]
    assert json.loads(after.read_text("utf-8"))["inputs"] == ["tonight.mcap"]


def test_the_line_of_cron_tells_what_is_wrong_and_leaves_the_map(server: Server) -> None:
    (server.place / "golden").rename(server.place / "map")
    (server.place / "tonight.mcap").write_bytes(b"nothing")
    assert server.sh(cron_line()).stderr.startswith("specmap: error: tonight.mcap: ")
    assert not (server.place / "before").exists()


def test_the_examples_use_the_command_line_alone() -> None:
    text = "\n".join(script for script, _ in (*github_steps(), *gitlab_steps()))
    words = {line.split()[0] for line in text.splitlines() if line.strip()}
    assert words == {"specmap", "if", "else", "fi"}

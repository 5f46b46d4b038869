"""`specmap batch` as a user runs it: workers of this machine, a good log and bad ones."""

import json
import os
import signal
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.cli.conftest import Run, spawn

pytest.importorskip("distributed")

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture
def logs(tiny_log: Path, tmp_path: Path) -> Path:
    """A good log, an empty one, and one that is no recording."""
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "good.mcap").symlink_to(tiny_log)
    (folder / "empty.bag").touch()
    (folder / "none.mcap").write_text("no recording", encoding="utf-8")
    return folder


def test_a_batch_and_the_same_again(logs: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "maps"
    command = ["batch", logs, "-o", out, "--step", "build"]
    said = run(*command, "--workers", "2", "--json", "--quiet")
    assert said.code == 5
    assert said.err == ""
    events = [json.loads(line) for line in said.out.splitlines()]
    ended = {one["job"]: one["event"] for one in events if one["job"] is not None}
    assert ended == {"good": "done", "empty": "failed", "none": "failed"}
    assert (out / "good" / "map" / "topology.json").is_file()
    tests = ElementTree.fromstring((out / "junit.xml").read_bytes())
    failed = {one.get("name") for one in tests.iter("testcase") if one.find("failure") is not None}
    assert failed == {"empty", "none"}
    before = (out / "good" / "job.json").stat().st_mtime_ns
    again = run(*command, "--workers", "1")
    assert again.code == 5
    assert f"{out}: 1 of 3 jobs done, 2 failed" in again.out
    assert f"{out}: 3 of the results were there already" in again.out
    assert "empty: log: " in again.err
    assert (out / "good" / "job.json").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--workers", "2", "--scheduler", "tcp://x:1"], "--workers and --scheduler do not go"),
        (["--set", "grid.nonsense=1"], "grid.nonsense"),
        (["--step", "check"], "check needs a map: put build before it"),
    ],
)
def test_wrong_usage(options: list[str], said: str, logs: Path, tmp_path: Path, run: Run) -> None:
    run("batch", logs, "-o", tmp_path / "maps", *options).fails(2, said)
    assert not (tmp_path / "maps").exists()


def test_a_missing_recording_is_an_input_s_error(tmp_path: Path, run: Run) -> None:
    """As of every other command; in a file of jobs, with the place that names it."""
    (tmp_path / "empty").mkdir()
    (tmp_path / "jobs.toml").write_text('logs = "none/*.mcap"\n', encoding="utf-8")
    for place, told in (
        ("gone", "gone: no such file or directory"),
        ("empty", "empty: no recording there"),
        ("jobs.toml", "jobs.toml: logs: "),
    ):
        run("batch", tmp_path / place, "-o", tmp_path / "maps").fails(3, told)
    assert not (tmp_path / "maps").exists()


def _is_gone(group: int) -> bool:
    """Whether all processes of a group end, soon after the first one."""
    until = time.monotonic() + 30.0
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_ctrl_c_ends_workers_and_steps(logs: Path, tmp_path: Path) -> None:
    """The whole group is sent the signal, as a terminal does."""
    process = spawn(
        *("batch", logs, "-o", tmp_path / "maps", "--workers", "1", "--json"),
        start_new_session=True,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["event"] == "started":
            break
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error == "specmap: error: interrupted by SIGINT; nothing half-written is left\n"
    assert _is_gone(process.pid)
    assert (tmp_path / "maps" / "summary.csv").is_file()

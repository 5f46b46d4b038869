"""Progress: bars on a terminal, lines now and then where there is none."""

import os
import pty
import re
from contextlib import suppress
from pathlib import Path

import pytest
from rich.progress import ProgressColumn

from specmap_cli.cli.entry import ConsoleProgress, bars
from specmap_cli.core.progress import Level
from tests.cli.conftest import QUICK, Run, spawn

LONG = "[bold]log[/]:cat:.mcap " + "long " * 40 + "/end"


def watched(*arguments: str | Path) -> tuple[str, str]:
    """What a command says on stdout, and on stderr that is a terminal."""
    terminal, stderr = pty.openpty()
    process = spawn(*arguments, stderr=stderr)
    os.close(stderr)
    said = b""
    with suppress(OSError):  # the other end has been closed
        while piece := os.read(terminal, 4096):
            said += piece
    os.close(terminal)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    return out, said.decode()


def test_a_terminal_shows_steps_and_time_left(tiny_log: Path, tmp_path: Path) -> None:
    out, shown = watched("build", tiny_log, "-o", tmp_path / "map", *QUICK)
    assert "mapping" in shown
    assert "/61 " in shown
    assert re.search(r"[\d-]:[\d-]{2}:[\d-]{2}", shown)  # dashes until a rate is known
    assert "mapping" not in out
    assert ": 1 submap" in out


def test_a_bar_tells_the_rate_once_it_is_known() -> None:
    seconds = iter([0.0, 1.0, 2.0])
    shown = bars()
    shown.get_time = lambda: next(seconds, 3.0)
    number, rate = shown.add_task("mapping", total=4_000), shown.columns[2]
    assert isinstance(rate, ProgressColumn)
    assert str(rate(shown.tasks[0])) == "0/4,000 "
    for _ in range(2):
        shown.advance(number, 1_000)
    assert str(rate(shown.tasks[0])) == "2,000/4,000 1,000/s"


def test_a_quiet_command_leaves_a_terminal_alone(tiny_log: Path, tmp_path: Path) -> None:
    _, shown = watched("convert", tiny_log, "-o", tmp_path / "copy.mcap", "--quiet")
    assert shown == ""


@pytest.mark.parametrize(
    ("message", "shown"),
    [(LONG, LONG), ("one\ntwo\x1b[2J", "one two\\x1b[2J"), ("three\r\nfour", "three four")],
    ids=["as it is", "an escape", "lines"],
)
def test_notes_and_warnings_stay_on_their_lines(
    message: str, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with ConsoleProgress() as progress:
        progress.start("working", None)
        progress.note(message)
        progress.warn(message)
        progress.advance()
    assert capsys.readouterr().err == f"specmap: {shown}\nspecmap: warning: {shown}\n"


@pytest.mark.parametrize(
    ("level", "shown"),
    [(Level.ERROR, ""), (Level.WARNING, "W"), (Level.INFO, "NW"), (Level.DEBUG, "NWD")],
)
def test_a_level_shows_what_those_before_it_show(
    level: Level, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with ConsoleProgress(level) as progress:
        progress.start("working", 2)
        progress.note("a note")
        progress.warn("a warning")
        progress.advance(2)
    lines = {"N": "a note", "W": "warning: a warning", "D": "debug: working: 2 steps in 0.0 s"}
    out, err = capsys.readouterr()
    assert out == ""
    assert re.sub(r"[\d.]+ s$", "0.0 s", err, flags=re.MULTILINE) == "".join(
        f"specmap: {lines[key]}\n" for key in shown
    )


def test_where_no_terminal_is_a_line_tells_now_and_then_where_the_work_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = ConsoleProgress()  # what its thread does is done here, and no thread begins
    for stage, done, total in (("mapping", 1_204, 2_000), ("layout", 0, None)):
        progress.start(stage, total)
        progress.advance(done)
        waits = iter([False, True])
        monkeypatch.setattr(progress._over, "wait", lambda _, waits=waits: next(waits))
        progress._tell()
    told = "specmap: mapping: 1,204 of 2,000, 0 s\nspecmap: layout: 0 s\n"
    assert capsys.readouterr().err == told
    with ConsoleProgress() as telling:
        assert telling._teller is not None
        assert telling._teller.is_alive()
    assert not telling._teller.is_alive()
    assert ConsoleProgress(Level.WARNING)._teller is None


def test_a_file_gets_notes_alone_and_every_stage_with_its_time_when_asked(
    tiny_log: Path, tmp_path: Path, run: Run
) -> None:
    said = run("build", tiny_log, "-o", tmp_path / "map", "--log-level", "debug", *QUICK)
    note, *stages = said.err.splitlines()
    told = "scans from /scan (LaserScan, 61), odometry from /odom, base frame base_link"
    assert note == f"specmap: {told}"
    found = [re.fullmatch(r"specmap: debug: (.*): .*\d\.\d s", line) for line in stages]
    assert [stage and stage[1] for stage in found] == [
        *("mapping", "layout", "segmentation", "grids", "training")
    ]

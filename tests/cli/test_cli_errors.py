"""Errors: one line on stderr; with `--json` an object on stdout, too. A bug keeps its traceback."""

import errno
import io
import json
import math
import os
import shlex
import signal
import sys
import tempfile
import unicodedata
from pathlib import Path
from typing import Any, cast
from unittest.mock import Mock

import cv2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.cli import main
from specmap_cli.cli.entry import ConsoleProgress
from specmap_cli.core.errors import CODES
from specmap_cli.core.text import one_line
from specmap_cli.logs import inspection
from specmap_cli.pipelines import build
from tests.cli.conftest import Outcome, Run, standing_log, validate


def as_json(said: Outcome) -> dict[str, object]:
    """The error on stdout, which must be all there is."""
    found = json.loads(said.out)
    assert found.keys() == {"schema_version", "error"}
    error: dict[str, object] = found["error"]
    assert CODES[str(error["code"])][0] in {error["exit_code"], 130}
    return error


@pytest.mark.parametrize(
    ("line", "code", "where", "told", "hint"),
    [
        (
            "biuld",
            *("usage", None, "No such command 'biuld'. Did you mean 'build'?; see"),
            "see `specmap --help`",
        ),
        ("localize x", "usage", "--map", "Missing option", "see `specmap localize --help`"),
        ("info x --frob", "usage", "--frob", "No such option", "see `specmap info --help`"),
        (
            "build x --resolution 1",
            *("usage", "--resolution", "No such option: --resolution"),
            "a setting is given as --set grid.resolution_m=VALUE; see `specmap build --help`",
        ),
        (
            "build x --sed 1",
            "usage",
            "--sed",
            "No such option: --sed",
            "see `specmap build --help`",
        ),
        ("config --set seed=-1", "setting", "seed", "seed: must be", "run `specmap config`"),
        ("config --set seed", "setting", "--set seed", "--set seed:", "expected KEY=VALUE"),
        ("info", "usage", "LOG", "Missing argument", "see `specmap info --help`"),
        ("build x --seed x", "usage", "--seed", "Invalid value", "see `specmap b"),
        ("evaluate", "usage", None, "say what to evaluate, and one thing only", None),
        (
            "evaluate --trajectory a.tum --out c.png",
            *("usage", None, "--confusion (--out) is of --protocol: leave it out here"),
            "leave it out here",
        ),
        ("info none.mcap", "log-missing", "none.mcap", "none.mcap: no such file", None),
        ("info 'a b.mcap'", "log-missing", "a b.mcap", "a b.mcap: no such file", None),
        ("segment none.yaml", "map-unusable", "none.yaml", "none.yaml: cannot read", None),
        (
            "localize x --map none",
            *("map-missing", "none", "none: no such map directory"),
            "make one with `specmap build`",
        ),
        (
            "batch x -o y --step chek",
            *("usage", "--step", "Invalid value for '--step': 'chek' is not one"),
            "see `specmap batch --help`",
        ),
    ],
)
@pytest.mark.parametrize("quiet", [(), ("-q",)], ids=["loud", "quiet"])
def test_an_error_is_json_too(
    line: str,
    code: str,
    where: str | None,
    told: str,
    hint: str | None,
    quiet: tuple[str, ...],
    run: Run,
) -> None:
    said = run(*shlex.split(line), "--json", *quiet)
    error = as_json(said)
    assert (error["code"], error["where"], error["exit_code"]) == (code, where, said.code)
    assert str(error["hint"]).startswith(str(hint))
    assert error["message"] == said.line
    assert said.line.startswith(told)
    assert said.err.count("\n") == 1


def test_a_map_given_as_a_log_is_told_as_the_option_that_it_is(tmp_path: Path, run: Run) -> None:
    (tmp_path / "topology.json").touch()
    told = f"Missing option '--map' / '-m'; a map is given as --map {tmp_path}; see `specmap loc"
    run("localize", "x.mcap", tmp_path).fails(2, told)


def test_outputs_and_logs_have_codes_of_their_own(tmp_path: Path, plan: Path, run: Run) -> None:
    log = standing_log(tmp_path / "log.mcap", 3.0)
    two = standing_log(tmp_path / "two.mcap", 3.0, topics=("/front", "/rear"))
    blind = standing_log(tmp_path / "blind.mcap", math.nan)
    (tmp_path / "empty.mcap").touch()
    for code, *line in (
        ("output-exists", "convert", log, two),
        ("output-unwritable", "convert", log, tmp_path / "none" / "log.mcap"),
        ("choice-needed", "build", two, "-o", tmp_path / "map"),
        ("log-damaged", "info", tmp_path / "empty.mcap"),
        ("setting", "check", tmp_path, "--set", "registration.method='x'", "--rules", log),
        ("too-large", "segment", plan, "--set", "limits.picture_max_mpixel=0.001"),
        ("no-result", "build", blind, "-o", tmp_path / "map"),
    ):
        said = run(*line, "--json")
        error = as_json(said)
        assert (error["code"], error["exit_code"]) == (code, said.code), line
    assert (error["where"], error["hint"]) == (str(blind), "look at them with `specmap info`")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_is_json_too(
    number: int, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ConsoleProgress, "note", lambda *_: os.kill(os.getpid(), number))
    said = run("build", standing_log(tmp_path / "log.mcap", 3.0), "-o", tmp_path / "map", "--json")
    assert said.code == 128 + number
    error = as_json(said)
    assert (error["code"], error["exit_code"]) == ("interrupted", 128 + number)
    assert error["message"] == said.line
    assert said.line.startswith(f"interrupted by {signal.Signals(number).name}")


def test_a_bug_is_json_and_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(inspection, "summarize", Mock(side_effect=RuntimeError("no\nidea")))
    log = standing_log(tmp_path / "log.mcap", 3.0)
    with pytest.raises(RuntimeError, match="no\nidea"):
        main(["info", str(log)])
    assert capsys.readouterr().out == ""
    with pytest.raises(RuntimeError, match="no\nidea"):
        main(["info", str(log), "--json"])
    found = json.loads(capsys.readouterr().out)
    validate(found, "error")
    assert found["error"] == {
        "code": "bug",
        "message": "a bug: RuntimeError: no idea",
        "where": None,
        "hint": None,
        "exit_code": 1,
    }


def test_another_error_of_the_system_is_a_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "build_map", Mock(side_effect=system(errno.EBADF)))
    with pytest.raises(OSError, match="Bad file descriptor"):
        main(["build", "log.mcap", "-o", "map"])


def test_a_short_write_to_an_unbuffered_stdout_is_no_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with PYTHONUNBUFFERED=1: print would take a part for the whole."""

    class Slow(io.RawIOBase):
        got = b""

        def writable(self) -> bool:
            return True

        def write(self, data: Any) -> int:
            Slow.got += bytes(data[:7])
            return min(7, len(data))

    # the buffer of a text stream is a raw one then
    stream = io.TextIOWrapper(cast("io.BufferedWriter", Slow()), "utf-8", write_through=True)
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(["schema"]) == 0
    assert len(Slow.got) > 70
    assert Slow.got.endswith(b"\n")


def system(number: int, name: str | None = None) -> OSError:
    """An error as the system raises it."""
    return OSError(number, os.strerror(number), name)


def opencv_error() -> cv2.error:
    """Want of memory as OpenCV raises it."""
    error = cv2.error("Insufficient memory (Failed to allocate 4000000000 bytes)")
    error.code = cv2.Error.StsNoMem
    return error


SMALLER = "a shorter log or a coarser grid (--set grid.resolution_m) needs less"
ANOTHER = "set TMPDIR to another directory"
TEMPORARY = f"{tempfile.gettempdir()}/tmpx/map"
NO_PLACE = "No usable temporary directory found in ['/tmp']"
UNWRITTEN = "cannot be written: "
FULL = f"{UNWRITTEN}No space left on device; free some space, or"
QUOTA = f"{UNWRITTEN}Disk quota exceeded; your quota is used up: remove some files"
FEWER = "give fewer files at once, or raise the limit with `ulimit"
TOO_MANY = "Too many open files in system; this machine has too many of them open: end other"
END = "Cannot allocate memory; end other programs, or give less at once"


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (MemoryError("too large"), 3, f"not enough memory: too large; {SMALLER}"),
        (MemoryError(), 3, "not enough memory; a shorter log or"),
        (opencv_error(), 3, "not enough memory: "),
        (system(errno.ENOSPC, "a/b"), 2, f"a/b: {FULL} write elsewhere"),
        (system(errno.ENOSPC, TEMPORARY), 2, f"{TEMPORARY}: {FULL} {ANOTHER}"),
        (FileNotFoundError(2, NO_PLACE), 2, f"{NO_PLACE}: free some space there, or {ANOTHER}"),
        (system(errno.EROFS), 2, f"the output: {UNWRITTEN}Read-only file system; write elsewhere"),
        (system(errno.EDQUOT, "a/b"), 2, f"a/b: {QUOTA}"),
        (system(errno.ENOENT), 2, "the current directory was removed: change to another one"),
        (system(errno.EMFILE, "a/b"), 2, f"a/b: Too many open files; {FEWER}"),
        (system(errno.ENFILE), 2, TOO_MANY),
        (system(errno.ENOMEM), 2, END),
    ],
)
def test_what_the_machine_lacks_is_no_bug(
    error: Exception,
    code: int,
    told: str,
    tmp_path: Path,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(build, "build_map", Mock(side_effect=error))
    # the pipe or file under stdout is not this test's to discard
    monkeypatch.setattr("specmap_cli.cli.entry.discard_stdout", lambda: None)
    line = ("build", "log.mcap", "-o", tmp_path / "map")
    run(*line).fails(code, told)
    assert as_json(run(*line, "--json"))["code"] == {2: "machine", 3: "memory"}[code]


def test_a_file_called_json_asks_for_none(run: Run) -> None:
    run("info", "--", "--json").fails(3, "--json: no such file or directory")


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("a\nb\r\x1b[2J\x07\u2028c.mcap", r"a b \x1b[2J\x07 c.mcap"),
        (os.fsdecode(b"\xff.mcap"), r"\udcff.mcap"),
    ],
    ids=["control characters", "no unicode"],
)
def test_a_name_cannot_break_the_line(name: str, shown: str, run: Run) -> None:
    said = run("info", name, "--json")
    assert said.code == 3
    assert said.err.count("\n") == 1
    assert said.line.startswith(f"{shown}: no such file")
    assert as_json(said)["message"] == said.line


@given(st.text())
def test_one_line_is_one_line_and_obeys_nobody(text: str) -> None:
    line = one_line(text)
    assert len(line.splitlines()) <= 1
    assert not {unicodedata.category(character) for character in line} & {"Cc", "Cs"}
    assert one_line(line) == line


@given(st.lists(st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1)))
def test_one_line_leaves_words_alone(words: list[str]) -> None:
    assert one_line("\n\t".join(words)) == " ".join(words)

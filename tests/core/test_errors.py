"""The error tree, as its docstring draws it."""

from __future__ import annotations

import errno
import inspect
import os
import pickle
import re
from pathlib import Path

import pytest

from specmap_cli.core import errors
from specmap_cli.core.errors import is_of_the_machine, is_of_the_place, reason

ROOT = Path(__file__).parents[2]


def tree() -> dict[str, type[errors.SpecmapError]]:
    return {
        name: kind
        for name, kind in inspect.getmembers(errors, inspect.isclass)
        if issubclass(kind, errors.SpecmapError)
    }


def test_every_error_is_drawn_and_has_an_honest_exit_code() -> None:
    assert errors.__doc__ is not None
    drawn = re.findall(r"(\w+Error)\b(?: +(\d))?", errors.__doc__)
    codes = {name: int(code) for name, code in drawn if code}
    assert {name for name, _ in drawn} >= set(tree())
    for name, code in codes.items():
        assert tree()[name].exit_code == code
    for name, kind in tree().items():
        assert kind.exit_code in {1, 2, 3, 4}, name


@pytest.mark.parametrize("kind", [errors.LogError, errors.MapError])
def test_what_cannot_be_read_is_an_input_error(kind: type[errors.SpecmapError]) -> None:
    assert issubclass(kind, errors.InputError)
    assert kind("log.mcap: empty").exit_code == 3


def test_the_code_of_a_kind_of_error_has_its_exit_code() -> None:
    for kind in tree().values():
        assert errors.CODES[kind.code][0] == kind.exit_code
    assert kind("x", code=errors.MEMORY).code == "memory"


def test_every_code_is_documented() -> None:
    text = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z-]+)` \| (\d+) \| (.*) \|$", text, re.MULTILINE)
    assert rows == [(code, str(exit_), words) for code, (exit_, words) in errors.CODES.items()]


def test_every_code_is_given_somewhere() -> None:
    package = (ROOT / "specmap_cli").rglob("*.py")
    text = "\n".join(path.read_text("utf-8") for path in package if path.name != "errors.py")
    of_classes = {kind.code for kind in tree().values()}
    names = {code: name for name, code in vars(errors).items() if isinstance(code, str)}
    for code in errors.CODES.keys() - of_classes:
        assert re.search(rf"\b{names[code]}\b", text), code


@pytest.mark.parametrize(
    ("message", "where", "hint"),
    [
        ("a.mcap: no such file or directory", "a.mcap", None),
        ("my log.mcap: the file is empty", "my log.mcap", None),
        ("/a b/c: is a directory: name the file to write", "/a b/c", "name the file to write"),
        ("--set seed: expected KEY=VALUE", "--set seed", "expected KEY=VALUE"),
        ("a/map: not empty: use --overwrite, or another", "a/map", "use --overwrite, or another"),
        ("a.png: No space left on device; free some space", "a.png", "free some space"),
        ("no free space in the map: check the resolution", None, "check the resolution"),
        ("unknown preset 'x': choose from default, paper", None, "choose from default, paper"),
        ("the process that worked ahead was killed", None, None),
        ("", None, None),
    ],
)
def test_the_parts_of_a_message(message: str, where: str | None, hint: str | None) -> None:
    error = errors.SpecmapError(message)
    assert (error.where, error.hint) == (where, hint)
    given = errors.UsageError(message, where="here", hint="do")
    assert (str(given), given.where, given.hint) == (message, "here", "do")


def test_an_error_keeps_its_code_on_the_way_to_another_process() -> None:
    gone = errors.LogError("gone", code=errors.LOG_MISSING, where="a.mcap", hint="copy it")
    error = pickle.loads(pickle.dumps(gone))
    assert (str(error), error.code) == ("gone", "log-missing")
    assert (error.where, error.hint) == ("a.mcap", "copy it")


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.ENOSPC, "No space left on device; free some space, or go"),
        (errno.EDQUOT, "Disk quota exceeded; your quota is used up: remove some files, or go"),
        (errno.EROFS, "Read-only file system; go"),
        (errno.EFBIG, "File too large; see `ulimit -f`, or go"),
        (errno.EIO, "Input/output error; the disk fails: check it, or go"),
        (errno.EMFILE, "Too many open files; give fewer files at once, or raise the limit with"),
        (errno.ENFILE, "Too many open files in system; this machine has too many of them open: "),
        (errno.ENOMEM, "Cannot allocate memory; end other programs, or give less at once"),
        (errno.EACCES, "Permission denied; go"),
    ],
)
def test_each_has_its_own_advice(number: int, told: str) -> None:
    assert reason(OSError(number, os.strerror(number)), "go").startswith(told)


def test_without_advice_only_what_helps_anywhere_is_said() -> None:
    assert reason(OSError(errno.EIO, os.strerror(errno.EIO))) == "Input/output error"
    assert "ulimit -n" in reason(OSError(errno.EMFILE, os.strerror(errno.EMFILE)))
    assert reason(OSError("no number")) == "no number"


def test_an_error_of_our_own_keeps_its_words() -> None:
    error = OSError(errno.EFBIG, "larger than 5 MB")
    assert not is_of_the_place(error)
    assert not is_of_the_machine(error)
    assert reason(error, "build the map again") == "larger than 5 MB; build the map again"

"""The error tree, as its docstring draws it; and findings, from which a verdict follows."""

from __future__ import annotations

import errno
import inspect
import itertools
import os
import pickle
import re
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.core import errors, findings
from specmap_cli.core.config import load_config
from specmap_cli.core.errors import is_of_the_machine, is_of_the_place, reason
from specmap_cli.core.findings import Finding, Quality, Severity, Where, summary

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
        assert errors.CODES[kind.code][0] == kind.exit_code, name
        assert kind("x", code=errors.MEMORY).code == "memory"
    for kind in (errors.LogError, errors.MapError):
        assert issubclass(kind, errors.InputError)


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
    ("error", "line"),
    [
        (errors.LogError("is empty", where=Path("a b.mcap")), "a b.mcap: is empty"),
        (
            errors.UsageError("is a directory", "name a file", where="a"),
            "a: is a directory: name a file",
        ),
        (errors.UsageError("is there", "go on", mark=";", where="a"), "a: is there; go on"),
        (errors.UsageError(hint="expected KEY=VALUE", where="a"), "a: expected KEY=VALUE"),
        (errors.LogError("no such file b,", "name one", where="a"), "a: no such file b,: name one"),
        (errors.NoResultError("no space", "check the scale"), "no space: check the scale"),
        (errors.SpecmapError(), ""),
    ],
)
def test_the_line_is_made_of_the_parts(error: errors.SpecmapError, line: str) -> None:
    assert str(error) == line
    assert error.where in (None, "a b.mcap", "a")


def test_an_error_is_told_of_a_larger_place() -> None:
    small = errors.UsageError("is 3", "see b", mark=";", where="a", code=errors.SETTING)
    error = small.within("jobs.toml")
    assert (str(error), error.where, error.code) == (
        "jobs.toml: a: is 3; see b",
        "jobs.toml",
        "setting",
    )
    with pytest.raises(errors.UsageError) as caught:
        load_config(overrides={"seed": -1})
    assert caught.value.where == "seed"  # which stands in the line once
    assert str(caught.value.within("jobs.toml")) == f"jobs.toml: {caught.value}"


def test_an_error_of_the_system_says_what_helps() -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    error = errors.UsageError.of_system(full, "cannot be written", "go", where="out")
    assert str(error) == ("out: cannot be written: No space left on device; free some space, or go")
    assert (error.where, error.hint) == ("out", "free some space, or go")


def test_an_error_keeps_its_parts_on_the_way_to_another_process() -> None:
    gone = errors.LogError("gone", "copy it", code=errors.LOG_MISSING, where="a.mcap")
    error = pickle.loads(pickle.dumps(gone))
    assert (str(error), error.code) == ("a.mcap: gone: copy it", "log-missing")
    assert (error.where, error.hint) == ("a.mcap", "copy it")


@pytest.mark.parametrize(
    ("number", "hint"),
    [
        (errno.ENOSPC, "free some space, or go"),
        (errno.EDQUOT, "your quota is used up: remove some files, or go"),
        (errno.EROFS, "go"),
        (errno.EFBIG, "see `ulimit -f`, or go"),
        (errno.EIO, "the disk fails: check it, or go"),
        (errno.EMFILE, "give fewer files at once, or raise the limit with `ulimit -n`"),
        (errno.ENFILE, "this machine has too many of them open: end other programs"),
        (errno.ENOMEM, "end other programs, or give less at once"),
        (errno.EACCES, "go"),
    ],
)
def test_each_has_its_own_advice(number: int, hint: str) -> None:
    assert reason(OSError(number, os.strerror(number)), "go") == (os.strerror(number), hint)


def test_without_advice_only_what_helps_anywhere_is_said_and_our_own_words_are_kept() -> None:
    assert reason(OSError(errno.EIO, os.strerror(errno.EIO))) == ("Input/output error", "")
    assert "ulimit -n" in reason(OSError(errno.EMFILE, os.strerror(errno.EMFILE)))[1]
    assert reason(OSError("no number")) == ("no number", "")
    error = OSError(errno.EFBIG, "larger than 5 MB")
    assert not is_of_the_place(error)
    assert not is_of_the_machine(error)
    assert reason(error, "build the map again") == ("larger than 5 MB", "build the map again")


def finding(severity: Severity, code: str = "code", message: str = "said") -> Finding:
    return Finding(code=code, severity=severity, message=message)


@pytest.mark.parametrize(
    ("severities", "verdict"),
    [
        ((), "good"),
        (("note",), "good"),
        (("note", "doubtful"), "doubtful"),
        (("poor", "doubtful", "note"), "poor"),
    ],
)
def test_the_gravest_finding_decides(severities: tuple[Severity, ...], verdict: str) -> None:
    for order in itertools.permutations(severities):
        quality = Quality.of(finding(severity) for severity in order)
        assert quality.verdict == verdict
        assert all(one.severity == verdict for one in quality.worst)
        assert bool(quality.worst) is (verdict != "good")


def test_verdicts_are_ordered() -> None:
    for (i, a), (j, b) in itertools.product(enumerate(findings.VERDICTS), repeat=2):
        assert findings.at_least_as_bad(a, b) is (i >= j)


def test_a_finding_for_a_machine_says_where_it_is() -> None:
    said: dict[str, Any] = {"code": "walls-disagree", "severity": "poor", "message": "walls"}
    said |= {"advice": "look", "value": 0.3, "limit": 0.1}
    where = {"stamp": 1.5, "x": 1.0, "y": 2.0}
    full = Finding(**said, where=Where(1_500_000_000, 1.0, 2.0))
    assert full.as_dict() == said | {"where": where}
    assert finding("note").as_dict()["where"] is None
    assert findings.UNDOUBTED.as_dict() == {"verdict": "good", "findings": []}


def test_many_findings_of_a_kind_are_one_line_and_advice_follows() -> None:
    lines = summary(
        [
            finding("note", "a", "a first"),
            finding("doubtful", "b", "b first"),
            finding("poor", "a", "a worst"),
            finding("poor", "a", "a later"),
        ]
    )
    assert lines == ["a worst (and 2 more like it)", "b first"]
    told = Finding(code="a", severity="poor", message="it is dark", advice="make light")
    assert summary([told]) == ["it is dark: make light"]
    assert summary([]) == []


def test_notes_about_the_result_are_no_warnings() -> None:
    quality = Quality.of((finding("doubtful", "a"), finding("note", "b"), finding("note", "input")))
    assert [one.code for one in quality.warnings] == ["a", "input"]
    assert [one.code for one in quality.notes] == ["b"]

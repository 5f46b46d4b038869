"""The error tree as its docstring draws it, findings and their verdict; files, plugins, threads."""

import errno
import inspect
import itertools
import os
import pickle
import re
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.core import errors, findings
from specmap_cli.core.config import load_config
from specmap_cli.core.errors import UsageError, is_of_the_machine, is_of_the_place, reason
from specmap_cli.core.files import is_nobody_s, lock, read_bytes, write_text, write_together
from specmap_cli.core.findings import Finding, Quality, Severity, Where, summary
from specmap_cli.core.plugins import with_plugins
from tests.plugins import install

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
        (UsageError("is a directory", "name a file", where="a"), "a: is a directory: name a file"),
        (UsageError("is there", "go on", mark=";", where="a"), "a: is there; go on"),
        (UsageError(hint="expected KEY=VALUE", where="a"), "a: expected KEY=VALUE"),
        (errors.LogError("no such file b,", "name one", where="a"), "a: no such file b,: name one"),
        (errors.NoResultError("no space", "check the scale"), "no space: check the scale"),
        (errors.SpecmapError(), ""),
    ],
)
def test_the_line_is_made_of_the_parts(error: errors.SpecmapError, line: str) -> None:
    assert str(error) == line
    assert error.where in (None, "a b.mcap", "a")


def test_an_error_is_told_of_a_larger_place() -> None:
    small = UsageError("is 3", "see b", mark=";", where="a", code=errors.SETTING)
    error = small.within("jobs.toml")
    assert str(error) == "jobs.toml: a: is 3; see b"
    assert (error.where, error.code) == ("jobs.toml", "setting")
    with pytest.raises(UsageError) as caught:
        load_config(overrides={"seed": -1})
    assert caught.value.where == "seed"  # which stands in the line once
    assert str(caught.value.within("jobs.toml")) == f"jobs.toml: {caught.value}"


def test_an_error_of_the_system_says_what_helps() -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    error = UsageError.of_system(full, "cannot be written", "go", where="out")
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


GROUP = "specmap.test"


def test_plugins_come_last_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert with_plugins(GROUP, {"m": 13}) == {"m": 13}, "there is none"
    install(tmp_path, monkeypatch, GROUP, {"z": "Z", "b": "B"}, "Z, B = 26, 2")
    assert list(with_plugins(GROUP, {"m": 13}).items()) == [("m", 13), ("b", 2), ("z", 26)]


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("taken", "New = 1", r"^package stranger_\d+: offers 'taken' in specmap\.test"),
        ("new", "1 / 0", "ZeroDivisionError.*mend or remove the package"),
        ("new", "", "AttributeError.*mend or remove the package"),
        ("new", "import no_such", "no_such.*mend or remove the package"),
    ],
)
def test_a_plugin_that_cannot_be_taken_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: str, words: str
) -> None:
    install(tmp_path, monkeypatch, GROUP, {name: "New"}, code)
    with pytest.raises(UsageError, match=words) as caught:
        with_plugins(GROUP, {"taken": 0})
    assert "\n" not in str(caught.value)


PROGRAM = """
import numpy, threadpoolctl
from specmap_cli.core.process import one_blas_thread

def threads():
    pools = threadpoolctl.threadpool_info()
    return {pool["filepath"]: pool["num_threads"] for pool in pools if pool["user_api"] == "blas"}

@one_blas_thread()
def work():
    import scipy.linalg
    with one_blas_thread():
        inner = threads()
    assert inner == threads(), "an inner call gave the threads back"
    return inner

threadpoolctl.ThreadpoolController().limit(limits=3)
before, during, after = threads(), work(), threads()
assert before and set(before.values()) == {3}, before
assert len(during) > len(before) and set(during.values()) == {1}, during
assert after == dict.fromkeys(during, 3), after
"""

UNDER_WAY = """
import threadpoolctl
import specmap_cli
from specmap_cli.core.progress import Silent

class Looking(Silent):
    seen = set()
    def advance(self, steps=1):
        self.seen.update(pool["num_threads"] for pool in threadpoolctl.threadpool_info()
                         if pool["user_api"] == "blas")

looking = Looking()
threadpoolctl.ThreadpoolController().limit(limits=3)
little = {"recognition": {"rounds": 4}, "localization": {"augmentation": 20}}
config = specmap_cli.load_config(overrides=little)
specmap_cli.build_map("tiny.mcap", "map", config, progress=looking)
assert looking.seen == {1}, looking.seen
"""


MISSING = """
import sys
sys.modules["threadpoolctl"] = None
from specmap_cli.cli import main
sys.exit(main(["--version"]))
"""


@pytest.mark.parametrize(
    "program",
    [PROGRAM, UNDER_WAY, MISSING],
    ids=["given back, also of what is loaded", "while a map is built", "a package is missing"],
)
def test_threads_in_a_program(program: str, tiny_log: Path, tmp_path: Path) -> None:
    """The last one tells the versions all the same."""
    (tmp_path / "tiny.mcap").symlink_to(tiny_log)
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    unset = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=tmp_path, env=unset, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_file_is_replaced_whole_or_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.json"
    path.write_text("a longer text than the new one")
    write_text(path, "für\n")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(UsageError, match="No space left"):
        write_text(path, "new")
    assert path.read_bytes() == "für\n".encode()
    assert os.listdir(tmp_path) == ["run.json"]


def test_two_files_appear_together_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full when the second one is written."""
    calls: list[int] = []

    def full(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UsageError, match=r"b\.md: cannot be written: No space left"):
        write_together({tmp_path / "a.xml": b"a", tmp_path / "b.md": b"b"})
    assert os.listdir(tmp_path) == []


def test_a_file_is_read_up_to_its_bound_and_not_beyond(tmp_path: Path) -> None:
    """And no more memory is taken than it needs."""
    path = tmp_path / "labels.csv"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5e-6) == b"12345"
    with pytest.raises(OSError, match=r"larger than 4e-06 MB"):
        read_bytes(path, 4e-6)
    with pytest.raises(OSError, match=r"larger than 4e-06 MB; if it is meant, raise limits\.x"):
        read_bytes(path, 4e-6, "limits.x")
    tracemalloc.start()
    assert read_bytes(path, 1000.0) == b"12345"
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1_000_000


def test_what_may_never_end_or_has_no_name_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match=r"not a regular file|Is a directory"):
            read_bytes(path, 100)
    with pytest.raises(OSError, match="no name that a file can have"):
        read_bytes(tmp_path / "map\0.png", 1.0)


def test_what_a_killed_run_had_begun_is_removed_and_nothing_else(tmp_path: Path) -> None:
    kept = ["labels.csv.partial-12", ".labels.csv.partial-x1", ".other.csv.partial-12"]
    for name in [*kept, ".labels.csv.partial-12", ".labels.csv.partial-13"]:
        (tmp_path / name).write_text("half")
    with (tmp_path / ".labels.csv.partial-13").open() as living:
        assert lock(living.fileno())
        write_text(tmp_path / "labels.csv", "whole")
        kept.append(".labels.csv.partial-13")
        assert sorted(os.listdir(tmp_path)) == sorted(["labels.csv", *kept])
    assert is_nobody_s(tmp_path / ".labels.csv.partial-13")
    assert not is_nobody_s(tmp_path / "missing")

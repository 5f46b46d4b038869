"""What a library user needs: seven names, loaded late, with the example that the page shows."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import specmap_cli
from specmap_cli.core.arguments import instance_of, path_of, paths_of
from specmap_cli.core.settings import Config
from tests.conftest import SAMPLE_LOGS

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "library.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_every_public_name_is_there_and_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in specmap_cli.__all__:
        assert getattr(specmap_cli, name).__name__ == name
        assert getattr(specmap_cli, name).__doc__
        assert name in dir(specmap_cli)
        assert f"`{name}" in text
    with pytest.raises(AttributeError, match="no_such_name"):
        specmap_cli.no_such_name  # noqa: B018


@pytest.mark.parametrize(
    ("more", "shown", "said"),
    [
        ("", "'numpy' in sys.modules", "False"),
        # what is slow to load waits until registration runs
        (".pipelines.build", "{'scipy.sparse', 'specmap_cli.layout'} & {*sys.modules}", "set()"),
        # what other systems lack
        ("; sys.modules['fcntl'] = None; import specmap_cli.pipelines.worker", "1", "1"),
    ],
)
def test_importing_needs_nothing_heavy_or_lacking(more: str, shown: str, said: str) -> None:
    code = f"import sys, specmap_cli{more}; print({shown})"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.stdout == f"{said}\n", found.stderr


def test_the_examples_of_the_page_run(
    tiny_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("log.mcap", "other.mcap"):
        shutil.copy(tiny_log, tmp_path / name)
    shutil.copy(SAMPLE_LOGS / "office.png", tmp_path / "plan.png")
    monkeypatch.chdir(tmp_path)
    assert len(EXAMPLES) == 4
    for example in EXAMPLES:
        exec(compile(example, str(PAGE), "exec"), {})
    shown = capsys.readouterr().out
    assert re.search(r"^\d submaps$", shown, flags=re.MULTILINE)
    assert re.search(r"^0 submap 0 \d+\.\d m2 \d visits$", shown, flags=re.MULTILINE)
    assert re.search(r"^1700000\d+ \d Pose2\(x=", shown, flags=re.MULTILINE)
    assert "/scan sensor_msgs/msg/LaserScan" in shown
    assert re.search(r"^\d+ rooms$", shown, flags=re.MULTILINE)


@pytest.mark.parametrize(
    "call",
    [
        lambda: specmap_cli.build_map(3, "out"),  # type: ignore[arg-type]
        lambda: specmap_cli.build_map("log.mcap", 3),  # type: ignore[arg-type]
        lambda: specmap_cli.build_map("log.mcap", "out", {"seed": 1}),  # type: ignore[arg-type]
        lambda: specmap_cli.build_map([], "out", Config(), explain=3),  # type: ignore[arg-type]
        lambda: specmap_cli.localize_log("log.mcap", 3),  # type: ignore[arg-type]
        lambda: specmap_cli.localize_log("log.mcap", "out", 3),  # type: ignore[arg-type]
        lambda: specmap_cli.segment_map(3, "out"),  # type: ignore[arg-type]
        lambda: specmap_cli.segment_map("m.yaml", "out", "paper"),  # type: ignore[arg-type]
        lambda: specmap_cli.read_map(None),  # type: ignore[arg-type]
        lambda: specmap_cli.load_config(3),  # type: ignore[arg-type]
    ],
)
def test_wrong_types_are_refused_before_the_work(
    call: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert callable(call)
    with pytest.raises(TypeError, match=r"expected .*, found "):
        call()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", ["a/b", Path("a/b")])
def test_a_path_may_be_text(value: str | Path) -> None:
    assert path_of(value, "out") == Path("a/b")
    assert paths_of(value, "logs") == [Path("a/b")]
    assert paths_of([value, "c"], "logs") == [Path("a/b"), Path("c")]
    assert paths_of((), "logs") == []
    assert instance_of(value, type(value), "path") is value


@pytest.mark.parametrize("value", [None, 3, b"bytes", {"a": 1}, {"a"}, object(), [0] * 1000])
def test_what_is_no_path_is_named_and_cut_in_the_message(value: Any) -> None:
    with pytest.raises(TypeError, match=r"^out: expected a path \(str or Path\), found ") as told:
        path_of(value, "out")
    assert len(str(told.value)) < 120
    with pytest.raises(TypeError, match=r"^logs: expected a path"):
        paths_of(value, "logs")
    with pytest.raises(TypeError, match=r"^count: expected str, found "):
        instance_of(value, str, "count")

"""What the command line says of itself, and what it answers to a wrong line."""

import platform
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from specmap_cli import __version__
from specmap_cli.core.process import STANDS_ON
from tests.cli.conftest import ROOT, Run, ran
from tests.test_architecture import HEAVY

COMMANDS = ("info", "build", "localize", "segment", "evaluate", "simulate", "convert", "config")


def test_version_names_what_it_needs_or_lacks(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    said = run("--version")
    assert (said.code, said.err) == (0, "")
    first, second, *libraries = said.out.splitlines()
    assert first == f"specmap {__version__}"
    assert second == f"python {platform.python_version()}"
    assert libraries == [f"{name} {metadata.version(name)}" for name in STANDS_ON]
    assert f"numpy {np.__version__}" in libraries

    def version(name: str) -> str:
        if name == "kiss-icp":
            raise metadata.PackageNotFoundError(name)
        return "1.2.3"

    monkeypatch.setattr(metadata, "version", version)
    said = run("--version")
    assert said.code == 0
    assert "kiss-icp not installed\nlz4 1.2.3\n" in said.out


def test_the_help_lists_every_command_with_a_whole_sentence(run: Run) -> None:
    """Without a command it goes to stderr."""
    asked, wrong = run("--help"), run()
    assert (asked.code, asked.err) == (0, "")
    assert (wrong.code, wrong.out) == (2, "")
    for name in COMMANDS:
        for text in (asked.out, wrong.err):
            line = next(line for line in text.splitlines() if line.startswith(f"  {name} "))
            assert line.endswith(".")
            assert not line.endswith("...")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_has_an_example_and_the_exit_codes(name: str, run: Run) -> None:
    said = run(name, "--help")
    assert (said.code, said.err) == (0, "")
    assert f"specmap {name}" in said.out.split("Arguments:")[0].split("Usage:")[1][20:]
    for code in ("0 done", "1 a bug", "2 wrong usage", "3 an input", "4 no result", "130 and 143"):
        assert code in " ".join(said.out.split())
    assert "\b" not in said.out


@pytest.mark.parametrize("arguments", [["--help"], ["build", "--help"], ["frobnicate"]])
def test_help_and_usage_errors_load_nothing_heavy(arguments: list[str]) -> None:
    assert (HEAVY & loaded_by(*arguments)) <= (set() if arguments == ["--help"] else {"pydantic"})


def test_localize_waits_for_nothing_that_it_does_not_need(tiny_log: Path, tiny_map: Path) -> None:
    loaded = loaded_by("localize", str(tiny_log), "--map", str(tiny_map), "--metric")
    assert {"numpy", "kiss_icp"} <= loaded
    idle = {"networkx", "scipy", "rich", "pydantic_settings", "asyncio", "xml", "PIL"}
    assert loaded & (idle | {"concurrent", "html"}) == set()


def test_garbage_is_looked_for_as_usual_once_all_is_loaded() -> None:
    code = (
        "import gc, sys; usual = gc.get_threshold(); from specmap_cli.cli import main;"
        "sys.argv = ['specmap', 'schema']; main(); assert gc.get_threshold() != usual;"
        "gc.collect(0); assert gc.get_threshold() == usual and not gc.callbacks"
    )
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, cwd=ROOT)


def loaded_by(*arguments: str) -> set[str]:
    """The packages that a process has loaded after a command."""
    code = (
        "import sys; from specmap_cli.cli import main; main(sys.argv[1:]);"
        "print(*sorted({m.split('.')[0] for m in sys.modules}), file=sys.stderr)"
    )
    found = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    return set(found.stderr.splitlines()[-1].split())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completion(shell: str) -> None:
    words = {"COMP_WORDS": "specmap lo", "COMP_CWORD": "1"}
    words |= {"_TYPER_COMPLETE_ARGS": "specmap lo", "_SPECMAP_COMPLETE": f"complete_{shell}"}
    if shell == "fish":
        words["_TYPER_COMPLETE_FISH_ACTION"] = "get-args"
    found = ran(env=words)
    assert "localize" in found.out
    assert "build" not in found.out


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("grid", "--set grid: expected KEY=VALUE, such as grid.resolution_m=0.1"),
        ("=3", "--set =3: expected KEY=VALUE"),
        ("grid..x=3", "--set grid..x=3: expected KEY=VALUE"),
        ("preset=paper", "--set preset=paper: choose a preset with --preset paper"),
        ("grid.resolution_m=9", "grid.resolution_m: must be 1 or less"),
        ("grid.resolutoin_m=1", "grid.resolutoin_m: no such setting, did you mean grid.reso"),
        ("grid=1", "grid: is a section: expected one of its keys, found 1"),
        ("seed=-1", "seed: must be 0 or more, found -1"),
        ("segmentation.labels=far", "segmentation.labels: must be 'flood' or 'nearest'"),
        pytest.param("grid.resolution_m=" + "9" * 5000, "grid.resolution_m", id="a long number"),
        pytest.param("grid.resolution_m=" + "[" * 5000, "grid.resolution_m", id="a deep list"),
    ],
)
def test_a_wrong_setting_is_named_and_not_blamed_on_the_file(
    setting: str, told: str, tmp_path: Path, run: Run
) -> None:
    path = tmp_path / "specmap.toml"
    path.write_text("seed = 3\n[grid]\nresolution_m = 0.2\n", encoding="utf-8")
    said = run("config", "--config", path, "--set", setting)
    said.fails(2, told)
    assert path.name not in said.error


def test_a_number_out_of_bounds_is_told_in_our_words(run: Run) -> None:
    said = run("evaluate", "log.mcap", "--share", "5")
    said.fails(2, "--share")
    assert "Input should" not in said.error
    tour = run("simulate", ROOT / "sample_logs" / "office.yaml", "-o", "tour.mcap", "--fov", "720")
    tour.fails(2, "--fov: must be 360 or less, found 720.0")


def test_the_printed_settings_can_be_given_back(tmp_path: Path, run: Run) -> None:
    """And a value in the place of a section gives way."""
    preset = ("--preset", "paper", "--set", "seed=3")
    printed = run("config", *preset, "--set", "grid=1", "--set", "grid.resolution_m=0.1").out
    assert tomllib.loads(printed)["grid"]["resolution_m"] == 0.1
    path = tmp_path / "specmap.toml"
    path.write_text(printed, encoding="utf-8")
    assert run("config", "--config", path).out == printed


def test_a_retired_setting_is_told_once_and_has_no_effect(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "specmap.toml"
    path.write_text("[relaxation]\nnode_m = 0.3\n", encoding="utf-8")
    said = run("config", "--config", path, "--set", "relaxation.node_m=0.5")
    assert said.code == 0
    assert "node_m" not in said.out
    fixed = "relaxation.node_m was retired: its value is now fixed at 0.3; 0.5 has no effect"
    assert said.err == f"specmap: warning: {fixed}\n"
    assert run("config", "--config", path, "--quiet").err == ""

"""What commands write: complete or not at all, never over an input, the same bytes every time."""

import filecmp
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK, Run, leftovers, ran
from tests.cli.test_cli_schemas import LINES


def test_two_builds_are_byte_identical(tiny_log: Path, tiny_map: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    line = ("build", tiny_log, "-o", again, "--quiet", *QUICK)
    assert ran(*line, env={"PYTHONHASHSEED": "7"}).code == 0
    names = [path.relative_to(tiny_map) for path in sorted(tiny_map.rglob("*")) if path.is_file()]
    assert names == [path.relative_to(again) for path in sorted(again.rglob("*")) if path.is_file()]
    compared = [str(name) for name in names if name != Path("run.json")]
    assert len(compared) >= 8
    assert filecmp.cmpfiles(tiny_map, again, compared, shallow=False) == (compared, [], [])
    first, second = (json.loads((each / "run.json").read_text()) for each in (tiny_map, again))
    assert first.pop("seconds").keys() == second.pop("seconds").keys()
    for measured in ("wall_s", "memory_mb"):
        assert first.pop(measured) > 0
        assert second.pop(measured) > 0
    assert first == second


def test_localize_is_repeatable(tiny_log: Path, tiny_map: Path, tmp_path: Path, run: Run) -> None:
    written = []
    for name in ("first", "second"):
        csv, plot = tmp_path / f"{name}.csv", tmp_path / f"{name}.png"
        said = run("localize", tiny_log, "--map", tiny_map, "-o", csv, "--plot", plot, "--metric")
        assert said.code == 0
        written.append((said.out, csv.read_bytes(), plot.read_bytes()))
    assert written[0] == written[1]
    assert written[0][1].count(b"\n") == 62  # a header, and a line a scan


@pytest.mark.parametrize(
    "name", ["info", "build", "localize", "segment", "simulate", "convert", "config"]
)
def test_what_exists_is_replaced_only_when_told_and_what_is_printed_is_the_result(
    name: str, words: Callable[[str], list[str]], tmp_path: Path, run: Run
) -> None:
    """Quiet, nothing is said but that; else stderr has notes alone."""
    line = [name, *words(LINES[name][0])]
    quiet = run(*line, "--quiet")
    assert (quiet.code, quiet.err) == (0, "")
    assert quiet.out
    if "{out}" in LINES[name][0]:
        before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        run(*line).fails(2, "--overwrite")
        assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        line.append("--overwrite")
    said = run(*line, "--json")
    assert isinstance(said.result, dict)
    assert all(text.startswith("specmap: ") for text in said.err.splitlines())
    assert leftovers(tmp_path) == []


def test_labels_and_picture_are_replaced_only_when_told(
    tiny_log: Path, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    line = ("localize", tiny_log, "--map", tiny_map)
    path = tmp_path / "there"
    for option in ("-o", "--out", "--output", "--plot"):
        path.write_text("mine", encoding="utf-8")
        told = "there: exists already: choose another name or say --overwrite"
        run(*line, option, path).fails(2, told)
        assert path.read_text(encoding="utf-8") == "mine"
        assert run(*line, option, path, "--overwrite").code == 0
    run(*line, "-o", path, "--plot", path, "--overwrite").fails(2, "given for two outputs")
    run(*line, "--plot", tmp_path / "there.pdf").fails(2, "there.pdf: what is drawn is a PNG")


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ("none/x.csv", "there is no directory"),
        ("file/x.csv", "there is no directory"),
        (".", "is a directory: name the file to write"),
    ],
)
@pytest.mark.parametrize("option", ["-o", "--plot"])
def test_an_output_without_a_place_is_told_before_the_work(
    option: str, place: str, told: str, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    run("localize", "never-opened.mcap", "--map", tiny_map, option, tmp_path / place).fails(2, told)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_maps_below_a_file_or_in_a_foreign_folder(tiny_log: Path, tmp_path: Path, run: Run) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for out, options, told in (
        (tmp_path / "file" / "a" / "map", (), "Not a directory"),
        (tmp_path / "file", ("--overwrite",), "is a file"),
        (tmp_path, ("--overwrite",), "is not empty and holds no map"),
    ):
        run("build", tiny_log, "-o", out, *options).fails(2, told)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_inputs_are_never_replaced(plan: Path, own_map: Path, tiny_log: Path, run: Run) -> None:
    """Nor is a file of a recording that is a directory."""
    log, picture, bag = own_map / "log.mcap", own_map / "map.png", own_map.parent / "bag"
    log.write_bytes(tiny_log.read_bytes())
    bag.mkdir()
    (bag / "bag_0.mcap").write_bytes(tiny_log.read_bytes())
    (bag / "metadata.yaml").write_text("mine", encoding="utf-8")
    for line in (
        ("convert", bag, "-o", bag / "bag_0.mcap"),
        ("build", log, "-o", own_map),
        ("convert", log, log),
        ("convert", log, "-o", log),
        ("localize", log, "--map", own_map, "-o", log),
        ("localize", log, "--map", own_map, "--plot", log),
        ("segment", own_map / "map.yaml", "-o", own_map),
        ("simulate", own_map / "map.yaml", "-o", own_map / "map.yaml"),
        ("simulate", plan, "-o", plan),
        ("evaluate", log, "--protocol", "holdout", "--confusion", log),
        ("report", own_map, "-o", own_map / "run.json"),
        ("check", own_map, "--junit", own_map / "run.json"),
        ("export", own_map, "--format", "geojson", "-o", own_map / "topology.json"),
        ("segment", own_map / "map.yaml", "-o", own_map / "rooms", "--explain", picture),
        ("simulate", own_map / "map.yaml", "-o", picture),
    ):
        run(*line, "--overwrite").fails(2, "would replace the input")
    assert log.read_bytes() == (bag / "bag_0.mcap").read_bytes() == tiny_log.read_bytes()


@pytest.mark.parametrize(
    "line",
    [
        ("report", "nothere", "-o", "there"),
        ("export", "nothere", "--format", "csv", "-o", "there"),
        ("localize", "log.mcap", "--map", "nothere", "-o", "there"),
        ("check", "nothere", "--junit", "there"),
    ],
)
def test_a_map_that_is_not_there_is_told_before_an_output_that_is(
    line: tuple[str, ...], tmp_path: Path, run: Run
) -> None:
    (tmp_path / "there").write_text("mine", encoding="utf-8")
    places = [tmp_path / word if word in ("nothere", "there") else word for word in line]
    run(*places).fails(3, "nothere: no such map directory")


@pytest.mark.parametrize("command", ["compare", "history"])
def test_a_directory_in_the_way_is_told_before_the_work(
    command: str, tiny_map: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name in (("compare", "compare_maps"), ("history", "history_of")):
        monkeypatch.setattr(f"specmap_cli.pipelines.{module}.{name}", pytest.fail)
    (tmp_path / "mine").write_text("mine", encoding="utf-8")
    line = (command, tiny_map, tiny_map, "-o", tmp_path, "--overwrite")
    run(*line).fails(2, "is not empty and holds no earlier result")
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_picture_inside_the_output_is_refused_whether_that_is_there_or_not(
    plan: Path, tmp_path: Path, run: Run
) -> None:
    line = ("segment", plan, "-o", tmp_path / "rooms", "--explain", tmp_path / "rooms" / "x.png")
    run(*line).fails(2, "which is written anew: choose another place")
    (tmp_path / "rooms").mkdir()
    run(*line).fails(2, "which is written anew: choose another place")


def test_the_true_poses_are_not_replaced_either(plan: Path, tmp_path: Path, run: Run) -> None:
    (tmp_path / "tour.tum").write_text("mine", encoding="utf-8")
    line = ("simulate", plan, "-o", tmp_path / "tour.mcap", "--max-duration", "1")
    run(*line).fails(2, "tour.tum: exists already")
    assert [path.name for path in tmp_path.iterdir()] == ["tour.tum"]


@pytest.mark.parametrize("unbuffered", ["1", ""])
@pytest.mark.parametrize("line", [["--help"], ["config"], ["info"]])
def test_readers_may_leave_early(line: list[str], unbuffered: str, tiny_log: Path) -> None:
    arguments = [*line, str(tiny_log)] if line[0] == "info" else line
    reading, writing = os.pipe()
    os.close(reading)
    said = ran(*arguments, stdout=writing, env={"PYTHONUNBUFFERED": unbuffered})
    os.close(writing)
    assert (said.code, said.err) == (0, "")


def test_stdout_that_is_full_is_one_line() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        said = ran("config", stdout=full)
    said.fails(2, "the output: cannot be written: No space left")
    assert said.err.count("\n") == 1


def test_a_picture_of_every_test(tiny_log: Path, tmp_path: Path, run: Run) -> None:
    line = ("build", tiny_log, "-o", tmp_path / "map", "--explain", tmp_path / "tests", *QUICK)
    assert run(*line).code == 0
    pictures = sorted(path.name for path in (tmp_path / "tests").iterdir())
    assert pictures == [f"test_{number:04}.png" for number in range(1, len(pictures) + 1)]
    assert len(pictures) > 1
    (tmp_path / "tests" / "test_9999.png").write_bytes(b"of an earlier run")
    run(*line[:3], tmp_path / "map2", *line[4:]).fails(2, "holds pictures of an earlier run")
    assert run(*line, "--overwrite").code == 0
    assert sorted(path.name for path in (tmp_path / "tests").iterdir()) == pictures
    line = ("build", tiny_log, "-o", tmp_path / "map3", "--explain", tiny_log / "tests", *QUICK)
    run(*line).fails(2, "cannot write pictures there")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map", "tests"]

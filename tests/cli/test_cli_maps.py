"""Maps that are none, damaged, edited by hand, or of another laser: a clear outcome each."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.grids.gridmap import GridMap
from tests.cli.conftest import Run
from tests.flats import record_tour

Edit = Callable[[Path], Any]


def test_a_map_with_one_submap(tiny_log: Path, tiny_map: Path, run: Run) -> None:
    said = run("localize", tiny_log, "--map", tiny_map, "--json")
    assert said.code == 0
    labels = json.loads(said.out)
    assert labels["scans"] == 61
    assert set(labels["raw"]) | set(labels["filtered"]) <= {"0", "unknown"}
    assert labels["filtered"]["0"] > 30


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda _: None, "no such map directory: make one with `specmap build`"),
        (lambda path: path.mkdir(), "is empty: no topology.json in it"),
        (lambda path: path.write_text("map"), "is a file: expected a directory written by"),
    ],
    ids=["missing", "empty", "file"],
)
def test_what_is_no_map(make: Edit, told: str, tiny_log: Path, tmp_path: Path, run: Run) -> None:
    make(tmp_path / "no_map")
    said = run("localize", tiny_log, "--map", tmp_path / "no_map")
    assert said.code == 3
    assert told in said.error


def test_a_foreign_directory(tiny_log: Path, run: Run) -> None:
    said = run("localize", tiny_log, "--map", tiny_log.parent)
    assert said.code == 3
    assert "is not a map: no topology.json in it" in said.error


def test_a_divided_floor_plan_is_no_map(
    plan: Path, tiny_log: Path, tmp_path: Path, run: Run
) -> None:
    assert run("segment", plan, "-o", tmp_path / "rooms").code == 0
    needs = "`specmap segment` makes maps without; here one is needed that `specmap build` made"
    for line, missing in (
        (("localize", tiny_log, "--map", tmp_path / "rooms"), "run.json"),
        (("update", tmp_path / "rooms", tiny_log, "-o", tmp_path / "new"), "run.json"),
        (("build", tiny_log, "--like", tmp_path / "rooms", "-o", tmp_path / "new"), "map.yaml"),
    ):
        said = run(*line)
        assert said.code == 3
        assert f"rooms: has no {missing}: {needs}" in said.error


def test_what_a_division_looked_at_is_drawn(plan: Path, tmp_path: Path, run: Run) -> None:
    picture = tmp_path / "nodes.png"
    line = ("segment", plan, "-o", tmp_path / "rooms", "--explain", picture)
    assert run(*line).code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    said = run(*line)
    assert (said.code, "nodes.png: exists already" in said.error) == (2, True)
    assert run(*line, "--overwrite").code == 0


def replace_by_directory(file: Path) -> None:
    """A directory in the place of a file."""
    file.unlink()
    file.mkdir()


DAMAGES: dict[str, Callable[[Path], Any]] = {
    "gone": lambda file: file.unlink(),
    "empty": lambda file: file.write_text(""),
    "cut": lambda file: file.write_text(file.read_text(encoding="utf-8")[:150]),
    "list": lambda file: file.write_text("[]"),
    "null": lambda file: file.write_text("null"),
    "nothing": lambda file: file.write_text("{}"),
    "binary": lambda file: file.write_bytes(b"\xff\x00\xfe"),
    "deep": lambda file: file.write_text("[" * 100_000),
    "directory": replace_by_directory,
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["topology.json", "classifiers.json", "run.json"])
def test_a_damaged_file_is_named(
    name: str, damage: str, own_map: Path, tiny_log: Path, tmp_path: Path, run: Run
) -> None:
    DAMAGES[damage](own_map / name)
    said = run("localize", tiny_log, "--map", own_map, "-o", tmp_path / "labels.csv")
    assert said.code == 3
    assert name in said.error
    assert str(own_map) in said.error
    assert not (tmp_path / "labels.csv").exists()


def edited(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change a JSON file in place."""
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


def first(data: dict[str, Any]) -> dict[str, Any]:
    """The raw classifier of submap 0."""
    found: dict[str, Any] = data["raw"]["classifiers"]["0"]
    return found


@pytest.mark.parametrize(
    "change",
    [
        lambda data: first(data).update(kind="oracle"),
        lambda data: first(data).update(rounds="many"),
        lambda data: first(data).update(rounds=[17]),
        lambda data: first(data).update(rounds=[{}]),
        lambda data: first(data)["rounds"][0].update(votes=["yes", "no"]),
        lambda data: first(data)["rounds"][0].clear(),
        lambda data: data["raw"].update(feature_set="astrology"),
        lambda data: data["raw"].update(classifiers={}),
        lambda data: data["raw"]["classifiers"].update(kitchen=first(data)),
        lambda data: data["raw"]["classifiers"].update({"7": first(data)}),
        lambda data: data.update(sensor={"beams": "some"}),
        lambda data: data.update(schema_version=99),
    ],
    ids=range(12),
)
def test_classifiers_edited_into_nonsense(
    change: Callable[[dict[str, Any]], Any], own_map: Path, tiny_log: Path, run: Run
) -> None:
    edited(own_map / "classifiers.json", change)
    said = run("localize", tiny_log, "--map", own_map)
    assert said.code == 3
    assert f"{own_map / 'classifiers.json'}: " in said.error
    assert "build the map again" in said.error


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("topology.json", lambda data: data.update(nodes=[], edges=[]), "build the map again"),
        ("topology.json", lambda data: data["graph"].update(schema_version=99), "is 99"),
        ("topology.json", lambda data: data["nodes"][0].update(id="x"), "nodes.0.id"),
        (
            "run.json",
            lambda data: data["config"]["grid"].update(footprint_m=-1),
            "grid.footprint_m",
        ),
        ("run.json", lambda data: data.pop("config"), "config: "),
    ],
    ids=range(5),
)
def test_a_map_edited_into_nonsense(
    name: str,
    change: Callable[[dict[str, Any]], Any],
    told: str,
    own_map: Path,
    tiny_log: Path,
    run: Run,
) -> None:
    edited(own_map / name, change)
    said = run("localize", tiny_log, "--map", own_map, "--metric")
    assert said.code == 3
    assert told in said.error


def test_settings_of_another_version_are_named(own_map: Path, tiny_log: Path, run: Run) -> None:
    edited(own_map / "run.json", lambda data: data["config"]["grid"].update(x=1))
    said = run("localize", tiny_log, "--map", own_map)
    assert said.code == 0
    assert "built by another version; its settings left out: grid.x" in said.err


def test_a_missing_grid_is_named_when_it_is_needed(own_map: Path, tiny_log: Path, run: Run) -> None:
    (own_map / "submaps" / "000.png").unlink()
    said = run("localize", tiny_log, "--map", own_map, "--metric", "--quiet")
    assert said.code == 3
    assert "submaps/000.png: cannot read the image" in said.error


def test_a_laser_that_sees_less_is_refused(
    flat: GridMap, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    log = record_tour(flat, tmp_path / "other.mcap", max_duration_s=1, field_of_view_deg=180)
    said = run("localize", log, "--map", tiny_map)
    assert said.code == 3
    assert "180 degrees" in said.error
    assert "270 degrees" in said.error


def test_a_laser_that_sees_more_is_cut_to_the_maps_and_told(
    flat: GridMap, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    log = record_tour(
        flat, tmp_path / "other.mcap", max_duration_s=1, field_of_view_deg=360, beams=361
    )
    said = run("localize", log, "--map", tiny_map)
    assert said.code == 0
    assert "specmap: warning: " in said.err
    assert "laser" in said.err


def test_finished_maps_that_are_none(plan: Path, tmp_path: Path, run: Run) -> None:
    out = ("-o", tmp_path / "rooms")
    for line, code, told in (
        (("none.yaml",), 3, "none.yaml: cannot read the map: No such file"),
        ((plan.with_suffix(".png"),), 3, "a picture has no scale: give metres a pixel with --reso"),
        ((plan.with_suffix(".png"), "--resolution", "-1"), 3, "resolution is -1"),
        ((Path(__file__), "--resolution", "0.05"), 3, "not an image that can be read"),
    ):
        said = run("segment", *line, *out)
        assert (said.code, told in said.error) == (code, True)
    assert list(tmp_path.iterdir()) == []

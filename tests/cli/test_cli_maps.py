"""Maps that are none, damaged, edited by hand, or of another laser: a clear outcome each.

A map that was damaged is taken for a merge as far as it is whole, or refused in one line.
"""

import json
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli.grids.gridmap import OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.map_server import write_grid
from tests.cli.conftest import QUICK, Outcome, Run
from tests.flats import Mapped, forget_digests, record_tour

Damage = Callable[[Path], object]
Change = Callable[[dict[str, Any]], Any]


def test_a_map_with_one_submap(tiny_log: Path, tiny_map: Path, run: Run) -> None:
    labels = run("localize", tiny_log, "--map", tiny_map, "--json").result
    assert labels["scans"] == 61
    assert set(labels["raw"]) | set(labels["filtered"]) <= {"0", "unknown"}
    assert labels["filtered"]["0"] > 30


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda _: None, "no such map directory: make one with `specmap build`"),
        (lambda path: path.mkdir(), "is empty: no topology.json in it"),
        (lambda path: path.write_text("map"), "is a file: expected a directory written by"),
        (lambda path: (path / "foreign").mkdir(parents=True), "is not a map: no topology.json in"),
    ],
    ids=["missing", "empty", "file", "foreign"],
)
def test_no_map(
    make: Damage, told: str, tiny_log: Path, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    place, out = tmp_path / "no_map", tmp_path / "out"
    make(place)
    for line in (
        ("localize", tiny_log, "--map", place, "-o", out),
        ("report", place, "-o", out),
        ("compare", tiny_map, place, "-o", out),
        ("export", place, "-f", "graphml", "-o", out),
    ):
        run(*line).fails(3, told)
        assert not out.exists()


def test_a_divided_plan_is_no_map(plan: Path, tiny_log: Path, tmp_path: Path, run: Run) -> None:
    assert run("segment", plan, "-o", tmp_path / "rooms").code == 0
    needs = "`specmap segment` makes maps without; here one is needed that `specmap build` made"
    for line, missing in (
        (("localize", tiny_log, "--map", tmp_path / "rooms"), "run.json"),
        (("update", tmp_path / "rooms", tiny_log, "-o", tmp_path / "new"), "run.json"),
        (("build", tiny_log, "--like", tmp_path / "rooms", "-o", tmp_path / "new"), "run.json"),
    ):
        run(*line).fails(3, f"rooms: has no {missing}: {needs}")


def test_what_a_division_looked_at_is_drawn(plan: Path, tmp_path: Path, run: Run) -> None:
    picture = tmp_path / "nodes.png"
    line = ("segment", plan, "-o", tmp_path / "rooms", "--explain", picture)
    assert run(*line).code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    run(*line).fails(2, "nodes.png: exists already")
    assert run(*line, "--overwrite").code == 0


DAMAGES: dict[str, Damage] = {
    "gone": lambda file: file.unlink(),
    "empty": lambda file: file.write_text(""),
    "cut": lambda file: file.write_text(file.read_text(encoding="utf-8")[:150]),
    "binary": lambda file: file.write_bytes(b"\xff\x00\xfe"),
    "directory": lambda file: file.rename(file.with_suffix(".old")).with_suffix(".json").mkdir(),
    **{word[:4]: partial(Path.write_text, data=word) for word in ("[]", "null", "{}", "[" * 9**5)},
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["topology.json", "classifiers.json", "run.json"])
def test_a_damaged_file_is_named(
    name: str, damage: str, own_map: Path, tiny_log: Path, tmp_path: Path, run: Run
) -> None:
    DAMAGES[damage](own_map / name)
    said = run("localize", tiny_log, "--map", own_map, "-o", tmp_path / "labels.csv")
    said.fails(3, name, str(own_map))
    assert not (tmp_path / "labels.csv").exists()


def edited(path: Path, change: Change) -> None:
    """Change a JSON file in place."""
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "told", "change"),
    [
        (
            "classifiers.json",
            "build the map again",
            lambda data: data["raw"]["classifiers"]["0"].update(kind="oracle"),
        ),
        ("topology.json", "build the map again", lambda data: data.update(nodes=[], edges=[])),
        ("topology.json", "is 99", lambda data: data["graph"].update(schema_version=99)),
        (
            "run.json",
            "grid.footprint_m: must be ",
            lambda data: data["config"]["grid"].update(footprint_m=-1),
        ),
        ("run.json", "config: ", lambda data: data.pop("config")),
    ],
)
def test_a_map_edited_into_nonsense(
    name: str, told: str, change: Change, own_map: Path, tiny_log: Path, run: Run
) -> None:
    edited(own_map / name, change)
    run("localize", tiny_log, "--map", own_map, "--metric").fails(3, str(own_map / name), told)


def test_settings_of_another_version_are_named(own_map: Path, tiny_log: Path, run: Run) -> None:
    edited(own_map / "run.json", lambda data: data["config"]["grid"].update(x=1))
    said = run("localize", tiny_log, "--map", own_map)
    assert said.code == 0
    assert "built by another version; its settings left out: grid.x" in said.err


def test_a_missing_grid_is_named_when_it_is_needed(own_map: Path, tiny_log: Path, run: Run) -> None:
    (own_map / "submaps" / "000.png").unlink()
    said = run("localize", tiny_log, "--map", own_map, "--metric", "--quiet")
    said.fails(3, "submaps/000.png: cannot read the image")


def test_a_laser_of_another_view_is_refused_or_cut_to_the_map_s_and_told(
    flat: GridMap, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    def of(view_deg: int, beams: int) -> Outcome:
        path = tmp_path / f"{view_deg}.mcap"
        view = {"field_of_view_deg": view_deg, "beams": beams}
        tour = record_tour(flat, path, max_duration_s=1, **view)
        return run("localize", tour, "--map", tiny_map)

    of(180, 91).fails(3, "180.mcap: the laser", "180 degrees", "270 degrees")
    said = of(360, 361)
    assert said.code == 0
    assert "specmap: warning: " in said.err
    assert "laser" in said.err


def test_finished_maps_that_are_none(plan: Path, tmp_path: Path, run: Run) -> None:
    picture = plan.with_suffix(".png")
    for line, told in (
        (("none.yaml",), "none.yaml: cannot read the map: No such file"),
        ((picture,), "a picture has no scale: give metres a pixel with --reso"),
        ((plan.parent,), "is a directory: name the .yaml or the picture in it"),
        ((Path(__file__),), "not an image that can be read"),
        ((tmp_path / "none.png",), "none.png: cannot read the image: No such file"),
        ((picture, "--resolution", "-1"), "resolution is -1"),
        ((Path(__file__), "--resolution", "0.05"), "not an image that can be read"),
    ):
        run("segment", *line, "-o", tmp_path / "rooms").fails(3, told)
    assert list(tmp_path.iterdir()) == []


def test_a_scale_that_is_not_the_file_s_is_told(plan: Path, tmp_path: Path, run: Run) -> None:
    """A building of four times the area went out without a word."""
    line = ("segment", plan, "-o", tmp_path / "rooms", "--overwrite")
    assert run(*line, "--resolution", "0.05").err == ""
    told = run(*line, "--resolution", "0.06").err
    assert told == f"specmap: {plan}: 0.06 m a pixel, as you say; the file says 0.05\n"


def test_results_say_where_to_look_and_what_may_be_swapped(
    first_tour: Mapped, second_tour: Mapped, tmp_path: Path, run: Run
) -> None:
    old, new = first_tour.map, second_tour.map  # the first ends earlier
    for one, other, swapped in ((old, new, ""), (new, old, "are they swapped?")):
        said = run("compare", one, other, "-o", tmp_path / "changes", "--overwrite")
        assert said.out.endswith(f"look at {tmp_path / 'changes' / 'compare.png'}\n")
        assert said.err.strip().endswith(swapped)
        assert ("swapped" in said.err) == bool(swapped)
    said = run("history", old, "none", "-o", tmp_path / "week")
    reason = "left out: none: no such map directory: make one with `specmap build`"
    page = tmp_path / "week" / "history.html"
    assert said.out.splitlines()[-2:] == [reason, f"look at {page}"]
    said = run("history", "none")
    said.fails(3, "none: no such map directory")
    assert said.err.count("no such map") == 1
    said = run("history", "none", "nothing")
    assert said.code == 3
    assert [said.err.count(f"{name}: no such map") for name in ("none", "nothing")] == [1, 1]


def test_a_map_without_scans_whose_length_was_guessed_is_compared_as_it_is(
    second_tour: Mapped, first_tour: Mapped, tmp_path: Path, run: Run
) -> None:
    new = tmp_path / "new"
    shutil.copytree(second_tour.map, new)
    path = new / "topology.json"
    document = json.loads(path.read_text())
    guessed = {
        "code": "unmeasured-way",
        "severity": "doubtful",
        "message": "its length was guessed",
        "advice": "",
        "value": 0.3,
        "limit": 0.3,
        "where": {"stamp": document["graph"]["logs"][0]["start"], "x": 0.0, "y": 0.0},
    }
    document["graph"]["quality"] = {"verdict": "doubtful", "findings": [guessed]}
    path.write_text(json.dumps(document))
    forget_digests(new)
    line = ("compare", first_tour.map, new, "-o", tmp_path / "changes", "--overwrite", "--json")
    for has_scans in (True, False):
        if not has_scans:
            (new / "keyframes.mcap").unlink()
        said = run(*line)
        assert said.code == 0, said.err
        assert said.result["alignment"]["longer_m"] == 0.0


def test_a_map_of_nav2_loses_its_unknown_and_is_told(
    flat: GridMap, tmp_path: Path, run: Run
) -> None:
    """Round the flat, in a wall, is as much unknown, that would be rooms if it were free."""
    cells = np.pad(flat.cells, ((100, 20), (20, 100)), constant_values=UNKNOWN)
    cells = np.pad(cells, 2, constant_values=OCCUPIED)
    write_grid(tmp_path / "m", GridMap(cells, flat.resolution))
    path, out = tmp_path / "m.yaml", tmp_path / "rooms"
    line = ("segment", path, "-o", out, "--overwrite", "--json")
    plain = run(*line)
    assert plain.err == ""
    path.write_text(path.read_text().replace("0.196", "0.25"))
    told = run(*line)
    assert told.err.startswith(f"specmap: {path}: the grey 205 is read as unknown")
    assert told.err.endswith("write `mode: scale`\n")
    assert told.result == plain.result
    assert run(*line, "--quiet").err == ""
    path.write_text(path.read_text().replace("trinary", "scale"))
    free = run(*line)
    assert free.err == ""
    assert free.result["area_m2"] > 2.0 * plain.result["area_m2"]
    tour = ("simulate", path, "-o", tmp_path / "tour.mcap", "--max-duration", "1", "--overwrite")
    assert "205" not in run(*tour).err
    path.write_text(path.read_text().replace("scale", "trinary"))
    assert f"{path}: the grey 205" in run(*tour).err


def replaced(pattern: str, new: str) -> Damage:
    """The first match of a pattern."""

    def damage(file: Path) -> None:
        text = file.read_text(encoding="utf-8")
        assert re.search(pattern, text)
        file.write_text(re.sub(pattern, new, text, count=1), encoding="utf-8")

    return damage


GRAPH, WAY, RUN = "trajectory.g2o", "trajectory.tum", "run.json"
STRANGERS = r"its vertices are not among the \d+ keyframes of labels\.csv"
ANOTHER_WAY = r"is not the way through the keyframes of labels\.csv"
FAR = r"line \d+ is '.* far .*': expected t x y z qx qy qz qw"


@pytest.mark.parametrize(
    ("name", "damage", "complaint"),
    [
        (GRAPH, DAMAGES["gone"], "cannot be read: .*; build the map again"),
        (GRAPH, DAMAGES["binary"], "not UTF-8 text: build the map again"),
        (
            GRAPH,
            replaced(r"(EDGE_SE2 \d+ \d+) \S+", r"\1 nan"),
            r"g2o, line \d+: 'EDGE_SE2 .*' is no EDGE_SE2",
        ),
        (GRAPH, replaced(r"VERTEX_SE2 \d+", "VERTEX_SE2 99999"), STRANGERS),
        (GRAPH, replaced(r"VERTEX_SE2 \d+", f"VERTEX_SE2 -{10**20}"), STRANGERS),  # in no 64 bits
        (GRAPH, DAMAGES["empty"], None),  # nothing but the way from keyframe to keyframe
        (WAY, DAMAGES["gone"], "cannot be read: "),
        (WAY, DAMAGES["binary"], "not UTF-8 text: build the map again"),
        (WAY, DAMAGES["empty"], ".*: build the map again"),
        (WAY, replaced(r"(?m)^(\d+\.\d+) \S+", r"\1 far"), FAR),
        (WAY, replaced(r"(?m)^\d+\.\d+ .*\n", ""), ANOTHER_WAY),
        (RUN, replaced(r'"counts": \{', '"counts": {"a": null, "scans": "many", '), None),
        (RUN, replaced(r'"counts": \{[^}]*\}', '"counts": [1, 2]'), None),
        ("edits.toml", lambda f: f.write_text("changes = 3"), "changes: must be tables such as"),
    ],
)
def test_a_damaged_map_is_merged_as_far_as_it_is_whole_or_refused(
    name: str,
    damage: Damage,
    complaint: str | None,
    own_map: Path,
    tiny_map: Path,
    tmp_path: Path,
    run: Run,
) -> None:
    forget_digests(own_map)
    damage(own_map / name)
    found = run("merge", tiny_map, own_map, "-o", tmp_path / "out", "--quiet", *QUICK)
    assert found.code == 3
    told = f"{re.escape(name)}: {complaint}" if complaint else r"holds tiny\.mcap, and so does"
    assert re.search(told, found.error)
    assert not (tmp_path / "out").exists()

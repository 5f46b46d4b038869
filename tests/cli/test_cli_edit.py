"""`specmap edit`: what its options mean, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.maps.store import read_map
from tests.cli.conftest import Run


def test_several_options_at_once(own_map: Path, run: Run) -> None:
    said = run(
        "edit", own_map, "--rename", "0", "Ann's lab", "--kind", "0", "hall",
        "--set-property", "0", "floor=2", "--set-property", "0", "to=west wing",
        "--set-property", "0", "heated=true", "--json",
    )  # fmt: skip
    told = said.result
    node = read_map(own_map).record.nodes[0]
    assert (node.name, node.kind) == ("Ann's lab", "hall")
    assert node.properties == {"floor": 2, "to": "west wing", "heated": True}
    assert told["submaps"][0] == {"id": 0, "name": "Ann's lab"}
    assert (told["remade"], told["unapplied"], told["out"]) == (False, [], str(own_map))
    assert run("edit", own_map, "--set-property", "0", "to=", "-q").code == 0
    slow = run("edit", own_map, "--set-property", "0", "speed_limit=slow")
    assert "speed_limit is 'slow', no number above 0: not exported" in slow.err
    assert run("edit", own_map, "--set-property", "0", "speed_limit=").err == ""
    assert read_map(own_map).record.nodes[0].properties == {"floor": 2, "heated": True}


def test_another_directory_may_be_written(own_map: Path, tmp_path: Path, run: Run) -> None:
    before = (own_map / "topology.json").read_bytes()
    line = ("edit", own_map, "--rename", "0", "Lab", "-o", tmp_path / "new")
    assert run(*line).code == 0
    assert (own_map / "topology.json").read_bytes() == before
    assert read_map(tmp_path / "new").names == {0: "Lab"}
    assert "use --overwrite to replace it" in run(*line).error
    assert run(*line, "--overwrite").code == 0
    assert run("edit", own_map, "--rename", "0", "Lab", "-o", own_map).code == 0
    assert read_map(own_map).names == {0: "Lab"}
    assert "is inside the map" in run("edit", own_map, "-o", own_map / "new").error
    assert "would replace the input" in run("edit", own_map, "-o", tmp_path).error


def test_localize_tells_the_names(own_map: Path, tiny_log: Path, tmp_path: Path, run: Run) -> None:
    assert run("edit", own_map, "--rename", "0", 'the "lab", west').code == 0
    assert run("localize", tiny_log, "--map", own_map, "-o", tmp_path / "labels.csv").code == 0
    assert ',0,"the ""lab"", west",' in (tmp_path / "labels.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--rename", "0"], "--rename 0: expected --rename ID NAME"),
        (["--rename", "0", "--kind", "0", "hall"], "--rename 0: expected --rename ID NAME"),
        (["--rename", "x", "y"], "--rename x: expected the id of a submap, such as 3"),
        (["--rename", "9", "y"], "there is no submap 9 to name, describe or forget: choose from 0"),
        (["--rename", "0", " y"], "must be one line of printable characters"),
        (["--kind", "0", "cellar"], "must be 'room', 'corridor' or 'hall'"),
        (["--set-property", "0", "floor"], "expected KEY=VALUE, such as floor=2"),
        (["--set-property", "0", "a=[1]"], "must be a string, true, false, or a number"),
        (["--merge", "0", "0"], "merge: must be two different submaps"),
        (["--merge", "0", "9"], "cannot merge 9 into 0: there is no submap 9"),
        (["--split", "0", "1,2,3"], "--split 1,2,3: expected X1,Y1,X2,Y2 in metres"),
        (["--split", "0", "1,2,1,2"], "line: must be two places 0.1 m apart or more"),
        (["--split", "0", "-90,0,-90,9"], "the line does not cross submap 0"),
        (["--split", "0", "nan,0,1,9"], "line: must be a place in metres"),
        (["--forbid-door", "0", "9"], "there is no link between 0 and 9"),
        (["--at", "1,2"], "--at: give it once for each --forbid-door, or not at all"),
        (["--forbid-door", "0", "9", "--at", "1"], "--at 1: expected X,Y in metres"),
        (["--undo", "3"], "--undo 3: there is no such change: edits.toml has 0 changes"),
    ],
)
def test_what_cannot_be_is_one_line_and_changes_nothing(
    options: list[str], complaint: str, own_map: Path, run: Run
) -> None:
    before = (own_map / "topology.json").read_bytes()
    run("edit", own_map, *options, "-q").fails(2, complaint)
    assert (own_map / "topology.json").read_bytes() == before
    assert not (own_map / "edits.toml").exists()


def test_a_broken_file_is_one_line(own_map: Path, run: Run) -> None:
    (own_map / "edits.toml").write_text('[submaps.0]\nname = "Lab\n', encoding="utf-8")
    run("edit", own_map).fails(3, "edits.toml: not valid TOML: Illegal character '\\n' (at line 2,")

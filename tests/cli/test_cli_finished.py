"""Commands on a finished map: check, edit, export and report, as a person and a CI run them."""

import json
from pathlib import Path
from xml.etree import ElementTree

import networkx as nx
import pytest

from specmap_cli.core.process import peak_memory_mb
from specmap_cli.maps.store import read_map
from tests.cli.conftest import QUICK, Run
from tests.turning import turn


def test_a_good_map_keeps_the_rules(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    """And a golden one is another map's measure."""
    told = run("check", tiny_map, "--against", tiny_map, "--json").result
    figures = told["figures"]
    assert told["passed"]
    assert figures["scans"] == 61
    assert figures["memory_mb"] > 10
    assert figures["scans_per_s"] > 0
    assert (figures["golden.same_share"], figures["golden.gone"]) == (1, 0)
    rules = {one["rule"] for one in told["rules"]}
    assert {"golden.aligned", "golden.area_share", "golden.closed", "golden.off_m"} <= rules
    assert run("check", tiny_map, "--against", tmp_path).code == 3


def test_a_broken_rule_is_exit_code_5(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text("[least]\nsubmaps = 40\n")
    junit, markdown = tmp_path / "check.xml", tmp_path / "check.md"
    line = ("check", tiny_map, "--rules", rules, "--junit", junit, "--markdown", markdown)
    said = run(*line)
    assert said.code == 5
    assert said.out.splitlines()[-1].endswith(": submaps")
    assert ElementTree.parse(junit).getroot()[0].get("failures") == "1"
    assert "**broken** | submaps | 1 |" in markdown.read_text()
    assert run(*line).error == f"{junit}: exists already: choose another name or say --overwrite"
    assert run(*line, "--overwrite").code == 5


@pytest.mark.parametrize(
    ("doubtful", "failing", "code"),
    [(False, "doubtful", 0), (True, "poor", 0), (True, "doubtful", 5)],
)
def test_a_build_can_fail_on_its_verdict(
    run: Run, tiny_log: Path, tmp_path: Path, doubtful: bool, failing: str, code: int
) -> None:
    out = tmp_path / "map"
    if doubtful:
        turn("quality", odometry_share=0.0001)  # it has to agree to a tenth of a millimetre a metre
    outcome = run("build", tiny_log, "-o", out, *QUICK, "--fail-on", failing, "--json")
    assert outcome.code == code
    told = json.loads(outcome.out)["quality"]
    assert told["verdict"] == ("doubtful" if doubtful else "good")
    stored = read_map(out).record.graph.quality
    assert stored is not None
    assert stored.as_dict() == told  # the map is there in any case


def test_doubts_come_first_and_are_warned_of(run: Run, tiny_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "map"
    turn("quality", odometry_share=0.0001)
    run("build", tiny_log, "--fail-on", "good", "-o", out).fails(2, "'doubtful', 'poor'")
    outcome = run("build", tiny_log, "-o", out, *QUICK)
    assert outcome.code == 0, "nobody asked it to fail"
    first = outcome.out.splitlines()[0]
    assert first.startswith(f"{out}: this map is doubtful: odometry and the map disagree by ")
    warned = first.removeprefix(f"{out}: this map is doubtful: ")
    assert f"specmap: warning: {warned}" in outcome.err.splitlines()
    assert warned in read_map(out).run["warnings"]
    assert "quality: good" not in outcome.out
    quiet = run("build", tiny_log, "-o", out, *QUICK, "--overwrite", "-q")
    assert (quiet.out.splitlines()[0], quiet.err) == (first, "")


def test_memory_is_that_of_this_process() -> None:
    before = peak_memory_mb()
    held = bytearray(150_000_000)
    after = peak_memory_mb()
    assert before is not None
    assert after is not None
    assert len(held) / 1e6 * 0.5 < after < 100_000


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


def test_a_map_becomes_a_graph_and_what_a_killed_run_left_is_removed(house: Path, run: Run) -> None:
    target, left = house.parent / "house.graphml", house.parent / ".house.graphml.partial-12"
    left.write_text("<graphml")
    said = run("export", house, "--format", "graphml", "-o", target)
    assert said.out == f"{target}: GraphML: the graph, for yEd, Gephi and networkx\n"
    assert len(nx.read_graphml(target)) == 3
    assert not left.exists()
    told = f"an earlier run was killed: removed {left.name}, which it had begun to write"
    assert said.err == f"specmap: {target}: {told}\n"
    found = run("export", house, "-f", "graphml", "-o", target, "--overwrite", "--json").result
    paths, counts = {"map": str(house), "out": str(target)}, {"submaps": 3, "edges": 2}
    assert found == {"schema_version": 1, "format": "graphml", "warnings": [], **paths, **counts}


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--format", "svg", "-o", "x.svg"], 2, "unknown format 'svg': choose from "),
        (["--format", "graphml"], 2, "Missing option '--out'"),
        (["--format", "graphml", "-o", "house/topology.json"], 2, "exists already"),
        (["--format", "graphml", "-o", "gone/x.graphml"], 2, "there is no directory"),
        (["--format", "nav2", "-o", "x.geojson"], 3, "house: nothing to plan a route with: "),
    ],
)
def test_what_cannot_be_exported_is_one_line(
    arguments: list[str],
    code: int,
    words: str,
    house: Path,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(house.parent)
    before = sorted(house.parent.rglob("*"))
    said = run("export", "house", *arguments)
    said.fails(code, words)
    assert said.err.count("\n") == 1
    assert sorted(house.parent.rglob("*")) == before


def test_warnings_are_told_and_stand_in_the_result(house: Path, run: Run) -> None:
    topology = house / "topology.json"
    record = json.loads(topology.read_text())
    for node in record["nodes"][:2]:
        node["anchor"], node["anchor_clearance_m"] = node["centroid"], 0.5
    ends = [node["anchor"] for node in record["nodes"][:2]]
    record["edges"][0] |= {"path": ends, "length_m": 4.5, "clearance_m": 0.4}
    record["graph"]["robot_radius_m"] = 0.2
    topology.write_text(json.dumps(record))
    shown = run("export", house, "-f", "nav2", "-o", house.parent / "house.geojson", "--json")
    result = json.loads(shown.out)
    assert result["warnings"] == [
        "no place to stand in submap 2: left out",
        "2 parts that no way joins, no route leads from one to another: submaps 0, 1; 2",
    ]
    for warning in result["warnings"]:
        assert f"specmap: warning: {warning}" in shown.err.splitlines()
    assert "specmap: left out: 1 link (0-2) without a way wide enough" in shown.err.splitlines()


def test_a_map_becomes_a_page(run: Run, own_map: Path) -> None:
    """Also in its own directory, where the page is a person's own."""
    target = own_map / "tiny.html"
    outcome = run("report", own_map, "-o", target)
    assert outcome.code == 0
    assert outcome.out.startswith(f"{target}: 0.")
    assert target.read_text(encoding="utf-8").startswith("<!doctype html>")
    run("report", own_map, "-o", target).fails(2, "--overwrite")
    again = run("report", own_map, "-o", target, "--overwrite", "--compare", own_map, "--json")
    paths = {"map": str(own_map), "compare": str(own_map), "out": str(target)}
    numbers = {"schema_version": 1, "submaps": 1, "bytes": target.stat().st_size}
    assert again.result == paths | numbers

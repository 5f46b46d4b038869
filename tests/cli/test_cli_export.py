"""`specmap export` and `specmap report` as a person runs them."""

from __future__ import annotations

import json
from pathlib import Path

import networkx as nx
import pytest

from tests.cli.conftest import Run


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


def test_a_map_of_schema_1_is_exported_with_a_word(house: Path, run: Run) -> None:
    old = Path(__file__).parents[1] / "maps" / "topology_1.json"
    (house / "topology.json").write_bytes(old.read_bytes())
    target = house.parent / "house.graphml"
    said = run("export", house, "--format", "graphml", "-o", target)
    assert len(nx.read_graphml(target)) == 3
    (line,) = said.err.splitlines()
    assert line.startswith(f"specmap: {house}: a map of an earlier version (schema 1)")


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

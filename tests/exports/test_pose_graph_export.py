"""The pose graph, read and solved by GTSAM; what a map without one says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.errors import MapError
from specmap_cli.exports.table import export_map
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult
from tests.exports.conftest import POSE_GRAPH, written
from tests.exports.consumers import consumer

DOCS = Path(__file__).parents[2] / "docs"


def with_graph(directory: Path, result: MapResult, text: str) -> Map:
    return written(directory, replace(result, pose_graph=text))


def test_fixed_vertices_stand_last_one_a_part(lived_in: MapResult, tmp_path: Path) -> None:
    lines = POSE_GRAPH.splitlines(keepends=True)
    earlier = "".join([*lines[:3], lines[-1], *lines[3:-1]])  # as earlier versions wrote it
    for number, text in enumerate((POSE_GRAPH, earlier)):
        stored = with_graph(tmp_path / str(number), lived_in, text)
        assert export_map(stored, "pose-graph", tmp_path / f"{number}.g2o") == []
        assert (tmp_path / f"{number}.g2o").read_text() == POSE_GRAPH
    text = "VERTEX_SE2 7 5 5 0\nVERTEX_SE2 8 6 5 0\nEDGE_SE2 7 8 1 0 0 1 0 0 1 0 1\n" + POSE_GRAPH
    stored = with_graph(tmp_path / "map", lived_in, text)
    (warning,) = export_map(stored, "pose-graph", tmp_path / "x.g2o")
    assert warning.startswith("the pose graph is in 2 parts that no edge joins")
    assert (tmp_path / "x.g2o").read_text().endswith("FIX 0\nFIX 7\n")


def test_gtsam_reads_every_vertex_and_every_edge_and_solves_it(home: Map, tmp_path: Path) -> None:
    """Three springs: each takes a third of the 0.3 m, give or take what the angles take."""
    gtsam = consumer("gtsam")
    out = tmp_path / "home.g2o"
    export_map(home, "pose-graph", out)
    for path in (home.path / "trajectory.g2o", out):
        graph, values = gtsam.readG2o(str(path), False)
        assert (graph.size(), values.size()) == (3, 3)
    last = graph.at(2)
    assert last.measured().x() == 2.3
    assert np.allclose(last.noiseModel().information(), [[100, 1, 2], [1, 90, 3], [2, 3, 1000]])
    graph.addPriorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6))
    solved = gtsam.GaussNewtonOptimizer(graph, values).optimize()
    found = [solved.atPose2(number).x() for number in range(3)]
    assert found == pytest.approx([0.0, 1.1, 2.2], abs=1e-3)
    apart = max(abs(values.atPose2(number).x() - found[number]) for number in range(3))
    assert apart > 0.05  # the poses of the file are no solution of its edges, and docs say so
    told = " ".join(DOCS.joinpath("export.md").read_text(encoding="utf-8").split())
    assert "GTSAM's solution is off them" in told
    assert "by half a metre at one end" in told  # what the benchmark found; no bound of millimetres


def test_a_map_without_one_is_refused_in_a_line(
    stored: Map, rooms: Map, lived_in: MapResult, tmp_path: Path
) -> None:
    lone = "EDGE_SE2 0 9 1 0 0 1 0 0 1 0 1\n"
    built = "a pose graph needs one that `specmap build` made of a recording"
    again = "build the map again"
    bad = with_graph(tmp_path / "bad", lived_in, "VERTEX_SE2 0 0\n")
    for case, found, hint in (
        (stored, "has no vertices", again),
        (rooms, "has no trajectory.g2o: `specmap segment` makes maps without", built),
        (with_graph(tmp_path / "1", lived_in, POSE_GRAPH + lone), "there is no vertex 9", again),
        (bad, "g2o, line 1: 'VERTEX_SE2 0 0' is no VERTEX_SE2", again),
    ):
        with pytest.raises(MapError) as told:
            export_map(case, "pose-graph", tmp_path / "x.g2o")
        assert (told.value.found, told.value.hint) == (found, hint)
    assert not (tmp_path / "x.g2o").exists()

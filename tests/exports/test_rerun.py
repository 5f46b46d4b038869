"""The recording for Rerun, read back by its SDK; and what is said where that is missing."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.exports.table import export_map
from specmap_cli.maps.store import Map
from tests.exports.consumers import consumer

Rows = dict[str, list[dict[str, Any]]]


def rows(stored: Map, out: Path) -> Rows:
    consumer("rerun")
    chunks = consumer("rerun.chunk")
    assert export_map(stored, "rerun", out) == []
    found: Rows = defaultdict(list)
    for chunk in chunks.RrdReader(str(out)).stream():
        found[chunk.entity_path.removeprefix("/")] += chunk.to_record_batch().to_pylist()
    return found


def test_graph_submaps_poses_and_scans_are_the_map_s(home: Map, tmp_path: Path) -> None:
    found = rows(home, tmp_path / "home.rrd")
    record = home.record
    links = [entity for entity in found if entity.startswith("graph/links/")]
    assert len(links) == len(record.edges)
    assert len([entity for entity in found if entity.startswith("graph/doors/")]) == 2
    for edge in record.edges:
        (row,) = found[f"graph/links/{edge.source}-{edge.target}"]
        if edge.corners:
            ((strip,),) = (row["LineStrips3D:strips"],)
            line = np.array(strip)[:, :2]
            assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(edge.length_m, 1e-5)
            assert float(row["length_m"][0]) == edge.length_m
    for node in record.nodes:
        (row,) = found[f"submaps/{node.id}"]
        assert row["Points3D:labels"] == [node.name]
        assert row["kind"] == [node.kind]
        assert tuple(row["Points3D:positions"][0][:2]) == pytest.approx(node.anchor)
    assert {"map", "regions", "trajectory"} <= found.keys()
    poses = sorted(found["robot"], key=lambda row: row["time"])
    places = [row["Transform3D:translation"][0][:2] for row in poses]
    assert np.allclose(places, home.labels.poses[:, :2], atol=1e-5)
    points = [len(row["Points3D:positions"]) for row in found["robot/scan"]]
    assert points == [17] * 30  # of 19, two without return


def test_without_the_sdk_the_line_says_what_to_install(
    home: Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(UsageError, match=r"pip install 'specmap-cli\[rerun\]'"):
        export_map(home, "rerun", tmp_path / "home.rrd")
    assert not (tmp_path / "home.rrd").exists()

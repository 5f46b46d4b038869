"""Maps to export: the small house as it is, with ways and scans, and a flat divided into rooms."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.store import Map, read_map
from specmap_cli.maps.writing import MapResult, write_map, write_scans
from specmap_cli.pipelines.segment import segment_map
from specmap_cli.topology.topological_map import Door, Edge
from tests.casting import keyframe

BEARINGS = np.linspace(-np.pi / 2, np.pi / 2, 19)
POSE_GRAPH = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2 0 0
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 1000
EDGE_SE2 1 2 1 0 0 100 0 0 100 0 1000
EDGE_SE2 0 2 2.3 0 0 100 1 2 90 3 1000
FIX 0
"""


def written(out: Path, result: MapResult, scans: KeyframeStore | None = None) -> Map:
    out.mkdir()
    if scans is not None:
        write_scans(out, scans, result.labels)
    write_map(out, result)
    return read_map(out)


def with_submaps(out: Path, result: MapResult, *changes: dict[str, Any]) -> Map:
    old = result.topology
    submaps = dict(old.submaps)
    for id_, fields in enumerate(changes):
        submaps[id_] = replace(submaps[id_], **fields)
    return written(out, replace(result, topology=replace(old, submaps=submaps)))


def lengths_agree(graph: nx.DiGraph, stored: Map, names: Mapping[int, Any], weight: str) -> None:
    ways = [edge for edge in stored.record.edges if edge.corners]
    assert len(ways) >= 2
    for way in ways:
        for start, end in ((way.source, way.target), (way.target, way.source)):
            found = nx.shortest_path_length(graph, names[start], names[end], weight=weight)
            assert found == pytest.approx(way.length_m, abs=1e-5)


@pytest.fixture
def stored(tmp_path: Path, result: MapResult) -> Map:
    """The house: no doors, no ways, no scans."""
    return written(tmp_path / "house", result)


@pytest.fixture
def lived_in(result: MapResult) -> MapResult:
    """The house with an anchor in each submap, two ways, a link too narrow and a forbidden one."""
    door = Door(id=0, x=-3.0, y=1.25, width_m=0.9, theta=np.pi / 2, between=(0, 1))
    doors = (door, replace(door, id=1, x=3.0, width_m=0.8, between=(0, 2)))
    ways = {
        (0, 1): (np.array([[0.0, 0.5], [-3.0, 1.0], [-3.0, 3.5]]), 0.4),
        (0, 2): (np.array([[0.0, 0.5], [3.0, 1.25], [3.0, 3.0]]), 0.3),
    }
    old = result.topology
    edges = dict(old.edges)
    for (pair, (path, clearance)), through in zip(ways.items(), doors, strict=True):
        length_m = float(np.hypot(*np.diff(path, axis=0).T).sum())
        way = replace(edges[pair], path=path, length_m=length_m, clearance_m=clearance)
        edges[pair] = replace(way, doors=(through.id,), width_m=through.width_m)
    edges[1, 2] = Edge(source=1, target=2, kind="seen", clearance_m=0.1)
    anchors = {0: (0.0, 0.5), 1: (-3.0, 3.5), 2: (3.0, 3.0)}
    submaps = {
        id_: replace(submap, anchor=anchors[id_], anchor_clearance_m=0.8)
        for id_, submap in old.submaps.items()
    }
    topology = replace(old, submaps=submaps, edges=edges, doors=doors, robot_radius_m=0.2)
    return replace(result, topology=topology, pose_graph=POSE_GRAPH)


@pytest.fixture
def home(tmp_path: Path, lived_in: MapResult) -> Map:
    """The house as it is lived in, and its scans.

    They are of half a circle and grow, with one beam that is lost and one without return.
    """
    labels, mounted = lived_in.labels, Pose2(0.2, 0.0, 0.0)
    with KeyframeStore() as scans:
        for row, stamp_ns in enumerate(labels.stamps_ns.tolist()):
            ranges = np.linspace(1.0, 2.0 + 0.01 * row, len(BEARINGS))
            ranges[[0, 1]] = np.nan, np.inf
            scan = PlanarScan(stamp_ns, BEARINGS, ranges, 8.0, full_circle=False)
            scans.append(keyframe(scan, Pose2(*labels.poses[row].tolist()), mounted, row))
        return written(tmp_path / "home", lived_in, scans)


@pytest.fixture(scope="session")
def rooms(plan: Path, tmp_path_factory: pytest.TempPathFactory) -> Map:
    """The flat divided into rooms, its doors and ways found; not to be changed."""
    return read_map(segment_map(plan, tmp_path_factory.mktemp("rooms") / "out").out)

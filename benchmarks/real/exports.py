"""All formats of maps, loaded by the programs that they are for: are the figures those of the map?

A line a map and format: nodes, edges and metres of ways as the consumer has them and as the map has
them, and the bytes of the file. A format whose consumer is not installed is left out.
"""

from __future__ import annotations

import csv
import io
import json
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from mcap.reader import make_reader

from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.exports.routes import routes
from specmap_cli.exports.table import export_map
from specmap_cli.layout.pose_graph import read_g2o
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.edit import edit_map
from specmap_cli.pipelines.edits import RequestedEdits
from specmap_cli.topology.navigation import is_way
from specmap_cli.topology.regions import NOBODY, borders_of
from tests.exports import costmap_filters, layout, open_rmf
from tests.exports.route_server import load

_CLOSE_M = 1e-3  # of all ways together: each corner is rounded to a micrometre


@dataclass(frozen=True, slots=True)
class Counts:
    """What a consumer found in a file."""

    nodes: int
    edges: int
    length_m: float

    def agrees_with(self, other: Counts) -> bool:
        """Whether two counted the same."""
        same = (self.nodes, self.edges) == (other.nodes, other.edges)
        return same and abs(self.length_m - other.length_m) <= _CLOSE_M

    def __str__(self) -> str:
        return f"{self.nodes:6,} nodes {self.edges:7,} edges {self.length_m:10.3f} m"


Compare = Callable[[Map, Path], tuple[Counts, Counts]]


def of_graph(stored: Map) -> Counts:
    """All submaps, all links, the metres of the ways."""
    edges = stored.record.edges
    length = sum(edge.length_m or 0.0 for edge in edges)
    return Counts(len(stored.record.nodes), len(edges), length)


def of_routes(stored: Map, *, bends: bool) -> Counts:
    """The stops of the ways, and twice the metres: there and back."""
    ways = [edge for edge in stored.record.edges if is_way(edge)]
    found = routes(stored.record)
    stops = [stop for stop in found.waypoints if bends or stop.kind != "bend"]
    legs = len(found.legs) - (len(found.waypoints) - len(stops))
    return Counts(len(stops), 2 * legs, 2 * sum(way.length_m or 0.0 for way in ways))


def nav2(stored: Map, path: Path) -> tuple[Counts, Counts]:
    graph = load(path)
    length = sum(cost for _, _, cost in graph.edges(data="cost"))
    found = Counts(len(graph), graph.number_of_edges(), length)
    return found, of_routes(stored, bends=True)


def tmap2(stored: Map, path: Path) -> tuple[Counts, Counts]:
    import yaml

    nodes = [entry["node"] for entry in yaml.safe_load(path.read_text())["nodes"]]
    edges = [edge for node in nodes for edge in node["edges"]]
    length = sum(edge["properties"]["length_m"] for edge in edges)
    return Counts(len(nodes), len(edges), length), of_routes(stored, bends=False)


def geojson(stored: Map, path: Path) -> tuple[Counts, Counts]:
    from shapely.geometry import shape

    features = json.loads(path.read_text())["features"]
    outlines = [one for one in features if one["properties"]["kind"] == "submap"]
    if not all(shape(one["geometry"]).is_valid for one in outlines):
        print(f"{path}: an outline crosses itself", file=sys.stderr)
    links = [one for one in features if "source" in one["properties"]]
    ways = [shape(one["geometry"]) for one in links if one["properties"]["passable"]]
    found = Counts(len(outlines), len(links), sum(way.length for way in ways))
    owning = sum(bool(node.polygon) for node in stored.record.nodes)
    expected = of_graph(stored)
    return found, Counts(owning, expected.edges, expected.length_m)


def graphml(stored: Map, path: Path) -> tuple[Counts, Counts]:
    graph = nx.read_graphml(path)
    length = sum(metres or 0.0 for _, _, metres in graph.edges(data="length_m"))
    return Counts(len(graph), graph.number_of_edges(), length), of_graph(stored)


def tables(stored: Map, path: Path) -> tuple[Counts, Counts]:
    with zipfile.ZipFile(path) as archive:
        nodes, edges = (
            list(csv.DictReader(io.StringIO(archive.read(name).decode())))
            for name in ("nodes.csv", "edges.csv")
        )
    length = sum(float(edge["length_m"] or 0.0) for edge in edges)
    return Counts(len(nodes), len(edges), length), of_graph(stored)


def pose_graph(stored: Map, path: Path) -> tuple[Counts, Counts]:
    """Metres are those that all edges measure."""
    import gtsam

    graph, values = gtsam.readG2o(str(path), False)
    motions = [graph.at(number).measured() for number in range(graph.size())]
    length = sum(float(np.hypot(pose.x(), pose.y())) for pose in motions)
    graph.addPriorPose2(0, values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6))
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    poses, links = read_g2o((stored.path / "trajectory.g2o").read_text())
    places = [solved.atPose2(number).translation() for number in poses]
    apart = np.hypot(*(np.array(places) - np.array([*poses.values()])[:, :2]).T)
    print(f"{stored.path.name:20} GTSAM moves poses by up to {1e3 * apart.max():.1f} mm")
    measured = sum(float(np.hypot(*link.source_from_target[:2])) for link in links)
    found = Counts(values.size(), graph.size() - 1, length)  # less the prior
    return found, Counts(len(poses), len(links), measured)


def foxglove(stored: Map, path: Path) -> tuple[Counts, Counts]:
    from mcap_protobuf.decoder import DecoderFactory

    entities: list[Any] = []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, scene in reader.iter_decoded_messages(topics=["/submaps", "/graph"]):
            entities += scene.entities
    links = [entity for entity in entities if entity.id.startswith("link")]
    passable = {f"link {edge.source}-{edge.target}" for edge in stored.record.edges if edge.corners}
    lines = [link.lines[0].points for link in links if link.id in passable]
    length = sum(np.hypot(b.x - a.x, b.y - a.y) for line in lines for a, b in pairwise(line))
    submaps = sum(entity.id.startswith("submap") for entity in entities)
    return Counts(submaps, len(links), float(length)), of_graph(stored)


def rmf(stored: Map, path: Path) -> tuple[Counts, Counts]:
    """What a fleet adapter makes of the nav graph; the generator makes as many of the building."""
    building, nav_graph = open_rmf.parts(path)
    graph, made = open_rmf.graph_of(nav_graph), open_rmf.graph_of(open_rmf.generated(building))
    length = sum(metres for _, _, metres in graph.edges(data="length_m"))
    if graph.number_of_edges() != made.number_of_edges():
        print(f"{path}: the building makes another nav graph", file=sys.stderr)
    straight = sum(one.kind == "door" and one.straight for one in routes(stored.record).waypoints)
    expected = of_routes(stored, bends=True)
    stops, lanes = expected.nodes - straight, expected.edges - 2 * straight
    return Counts(len(graph), graph.number_of_edges(), length), Counts(
        stops, lanes, expected.length_m
    )


def lif(stored: Map, path: Path) -> tuple[Counts, Counts]:
    graph = layout.load(path)
    length = sum(metres for _, _, metres in graph.edges(data="length_m"))
    found = Counts(len(graph), graph.number_of_edges(), length)
    return found, of_routes(stored, bends=True)


def masks(stored: Map, path: Path) -> tuple[Counts, Counts]:
    """Nodes are cells with a limit, edges pairs of submaps that touch; metres are a second's."""
    found, owner = costmap_filters.load(path), stored.regions.owner
    left = {border.pair for border in borders_of(np.where(found.shut, NOBODY, owner))}
    limits = {node.id: node.properties.get("speed_limit") for node in stored.record.nodes}
    limited = {id_: float(limit) for id_, limit in limits.items() if limit is not None}
    shut = {(edge.source, edge.target) for edge in stored.record.edges if edge.forbidden}
    touching = {border.pair for border in borders_of(owner)} - shut
    cells = int(np.isin(owner, list(limited)).sum())
    slowest = min(limited.values(), default=0.0)
    fastest = float(found.limits.max())
    return Counts(int((found.limits > 0.0).sum()), len(left), fastest), Counts(
        cells, len(touching), slowest
    )


FORMATS: dict[str, Compare] = {
    "nav2": nav2,
    "nav2-masks": masks,
    "tmap2": tmap2,
    "rmf": rmf,
    "lif": lif,
    "geojson": geojson,
    "graphml": graphml,
    "csv": tables,
    "pose-graph": pose_graph,
    "foxglove": foxglove,
}


ROWS = (Row("equal", "files whose nodes, edges and lengths are those of the map", 1.0, 1.0),)


def measure(bench: Bench) -> Figures:
    """Every format of the maps of two real recordings, a person's word in each."""
    with bench.scratch("exports") as folder:
        maps = [edited(bench.recorded(name), folder) for name in ("fr079", "mit_csail")]
        same = [
            equal
            for map_ in maps
            for name in FORMATS
            if (equal := compare(read_map(map_), name, folder)) is not None
        ]
    return {"equal": Figure(sum(same) / len(same), note=f"{sum(same)} of {len(same)}")}


def edited(map_: Path, folder: Path) -> Path:
    """A copy with a speed limit in a submap, and with a link that is forbidden."""
    first = read_map(map_).record.edges[0]
    said = RequestedEdits(
        properties={first.source: {"speed_limit": 0.5}},
        changes=({"forbid": [first.source, first.target]},),
    )
    out = folder / map_.name
    edit_map(map_, said, out)
    return out


def compare(stored: Map, name: str, folder: Path) -> bool | None:
    """Whether a format of a map holds its figures; None where its consumer is not installed."""
    path, label = folder / name, f"{stored.path.name:20} {name:10}"
    try:
        export_map(stored, name, path)
        found, expected = FORMATS[name](stored, path)
    except ImportError as error:
        print(f"{label} not read: {error}")
        return None
    same = found.agrees_with(expected)
    words = "equal" if same else f"DIFFERENT: {expected}"
    print(f"{label} {found} {path.stat().st_size:12,} bytes  {words}", flush=True)
    path.unlink()
    return same

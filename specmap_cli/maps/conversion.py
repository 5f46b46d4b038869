"""Topological maps as the records of topology.json, and back: submaps and edges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from specmap_cli.core.findings import Quality
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.text import nanoseconds, rounded, seconds
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.edit_conversion import borders_of, said_of
from specmap_cli.maps.graph_conversion import (
    break_of,
    closure_of,
    graph_record,
    stay_of,
)
from specmap_cli.maps.schema import (
    EdgeRecord,
    NodeRecord,
    TopologyRecord,
    VisitRecord,
)
from specmap_cli.maps.schema_values import point, transform
from specmap_cli.maps.way_conversion import (
    door_of,
    path_of,
    traversal_of,
    traversal_record,
    way_fields,
    written,
)
from specmap_cli.topology.kinds import kind_of
from specmap_cli.topology.outlines import Outline
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import (
    Edge,
    LogInfo,
    Submap,
    TopologicalMap,
    Visit,
    default_name,
)


def image_stem(submap: int) -> str:
    """Where the grid of a submap is kept in the map directory, without the suffix."""
    return f"submaps/{submap:03d}"


def to_record(
    topology: TopologicalMap,
    regions: Regions,
    logs: Sequence[LogInfo],
    frame: str = "map",
    quality: Quality | None = None,
) -> TopologyRecord:
    """The contents of topology.json: submaps and edges by id, closures in the order considered."""
    return TopologyRecord(
        directed=False,
        multigraph=False,
        graph=graph_record(topology, logs, frame, quality),
        nodes=[
            _node_record(topology.submaps[id_], regions.outline(id_))
            for id_ in sorted(topology.submaps)
        ],
        edges=[
            _edge_record(topology.edges[pair], topology, regions) for pair in sorted(topology.edges)
        ],
    )


def from_record(
    record: TopologyRecord,
    grid_of: Callable[[NodeRecord], GridMap],
    keyframes_of: Callable[[int], Iterable[int]],
) -> TopologicalMap:
    """The map of a topology.json; grids and keyframe numbers come from the files beside it."""
    return TopologicalMap(
        submaps={
            node.id: _submap(node, grid_of(node), keyframes_of(node.id) if node.scans else ())
            for node in record.nodes
        },
        edges={(edge.source, edge.target): _edge(edge) for edge in record.edges},
        closures=tuple(closure_of(closure) for closure in record.graph.closures),
        stays=tuple(stay_of(stay) for stay in record.graph.stays),
        breaks=tuple(break_of(each) for each in record.graph.breaks),
        next_id=record.graph.next_id,
        doors=tuple(door_of(door) for door in record.graph.doors),
        robot_radius_m=record.graph.robot_radius_m,
        said=said_of(record.graph.edits),
        borders=borders_of(record.graph.edits),
    )


def _node_record(submap: Submap, shape: Outline) -> NodeRecord:
    x, y, theta = transform(submap.map_from_submap)
    return NodeRecord(
        id=submap.id,
        name=submap.name or default_name(submap.id),
        kind=submap.kind or kind_of(shape.polygon),
        properties=dict(submap.properties),
        x=x,
        y=y,
        theta=theta,
        centroid=None if shape.centroid is None else point(shape.centroid),
        anchor=None if submap.anchor is None else point(submap.anchor),
        anchor_clearance_m=written(submap.anchor_clearance_m),
        polygon=[point(corner) for corner in shape.polygon],
        area_m2=rounded(shape.area_m2) or 0.0,
        scans=len(submap.keyframes),
        visits=[
            VisitRecord(start=seconds(visit.start_ns), end=seconds(visit.end_ns))
            for visit in submap.visits
        ],
        image=image_stem(submap.id) + ".png",
    )


def _edge_record(edge: Edge, topology: TopologicalMap, regions: Regions) -> EdgeRecord:
    crossing = edge.crossing
    ends = []
    for id_ in (edge.source, edge.target):
        centroid = regions.outline(id_).centroid
        ends.append(topology.submaps[id_].map_from_submap[:2] if centroid is None else centroid)
    stops = [ends[0], *([] if crossing is None else [crossing]), ends[1]]
    way = sum(math.dist(a, b) for a, b in itertools.pairwise(stops))
    return EdgeRecord(
        source=edge.source,
        target=edge.target,
        kind=edge.kind,
        traversals=[traversal_record(traversal) for traversal in edge.traversals],
        x=None if crossing is None else rounded(crossing[0]),
        y=None if crossing is None else rounded(crossing[1]),
        distance_m=rounded(way) or 0.0,
        width_m=written(edge.width_m),
        transform=transform(edge.source_from_target),
        **way_fields(edge),
        forbidden=edge.forbidden,
    )


def _submap(node: NodeRecord, grid: GridMap, keyframes: Iterable[int]) -> Submap:
    frame = Pose2(node.x, node.y, node.theta)
    polygon = np.array(node.polygon, dtype=np.float64).reshape(-1, 2)
    return Submap(
        id=node.id,
        map_from_submap=frame,
        keyframes=tuple(keyframes),
        visits=tuple(Visit(nanoseconds(v.start), nanoseconds(v.end)) for v in node.visits),
        grid=grid,
        polygon=frame.inverse().apply(polygon),
        name=node.name,
        kind=node.kind,
        properties=node.properties,
        anchor=node.anchor,
        anchor_clearance_m=node.anchor_clearance_m,
    )


def _edge(edge: EdgeRecord) -> Edge:
    place = None if edge.x is None or edge.y is None else (edge.x, edge.y)
    return Edge(
        source=edge.source,
        target=edge.target,
        kind=edge.kind,
        traversals=tuple(traversal_of(traversal) for traversal in edge.traversals),
        source_from_target=Pose2(*edge.transform),
        doorway=None if edge.traversals and not edge.doors else place,
        width_m=edge.width_m,
        doors=tuple(edge.doors),
        path=path_of(edge.path),
        length_m=edge.length_m,
        clearance_m=edge.clearance_m,
        forbidden=edge.forbidden,
    )

"""The contents of topology.json: node-link JSON that networkx reads as it is, read and checked.

Lengths are metres, angles radians, stamps seconds; everything is in the frame named by
`graph.frame` unless it says otherwise.

A map of schema 1 is read as one of schema 2, and so is one of the first versions of schema 2, which
had no doors, ways or edits: what it lacks is null or empty. Its document is changed before anything
is checked: a part of another shape than expected is left as it is, for the check to refuse.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationError

from specmap_cli.core.errors import MapError
from specmap_cli.core.findings import Quality
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.json_values import (
    Amount,
    Count,
    InnerPath,
    Number,
    Point,
    PropertyValue,
    Record,
    Span,
    Unchanging,
    part_of,
    point,
    transform,
)
from specmap_cli.core.records import Closure
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import first_finding, to_json
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.text_files import map_json
from specmap_cli.topology.regions import Outline, Regions, kind_of
from specmap_cli.topology.topological_map import (
    BorderEdit,
    Break,
    Door,
    Edge,
    LogInfo,
    Said,
    Seen,
    Split,
    Stay,
    Submap,
    SubmapKind,
    TopologicalMap,
    Visit,
    default_name,
)

SCHEMA_VERSION = 2


class EditsRecord(Record):
    """Which of a person's edits the map shows."""

    submaps: tuple[Said, ...] = Field(description="names, kinds and properties, by id")
    borders: tuple[BorderEdit, ...] = Field(
        description="merges and splits, in the order in which they were made"
    )


class GraphRecord(Record):
    """What holds for the whole map."""

    schema_version: Literal[2] = Field(description="the version of this format")
    frame: str = Field(description="the frame of all coordinates that have no other")
    next_id: Count = Field(description="smallest id that no node has ever had")
    logs: tuple[LogInfo, ...] = Field(
        min_length=1, description="what the map was made of, in the order of the keyframes"
    )
    stays: tuple[Stay, ...] = Field(description="by number")
    breaks: tuple[Break, ...] = Field(description="where tracking restarted, in order")
    closures: tuple[Closure, ...] = Field(
        description="all pairs of stays that were compared, in the order of the comparisons"
    )
    doors: tuple[Door, ...] = Field(description="every door between two submaps, by id")
    seen: tuple[Seen, ...] = Field(
        default=(),
        description="every piece of what was only seen, of a square metre or more, the largest "
        "first; maps of earlier versions do not tell it",
    )
    robot_radius_m: Amount | None = Field(
        description="what the paths of edges keep off walls and off what nobody saw, metres; null "
        "where nobody looked for paths"
    )
    edits: EditsRecord = Field(description="what of edits.toml the map shows")
    quality: Quality | None = Field(description="null where the map was not judged")
    files: Annotated[dict[str, str], AfterValidator(Unchanging)] = Field(
        default_factory=Unchanging,
        description="SHA-256 of the files that belong to it, by name; maps of earlier versions do "
        "not tell it",
    )


class NodeRecord(Record):
    """One submap."""

    id: Count = Field(description="never given again, and never changed once given")
    name: str = Field(description="for people; they may change it")
    kind: SubmapKind | None = Field(
        description="what it is by its shape, or by a person's word; null where it has no area, or "
        "nobody looked"
    )
    properties: Annotated[dict[str, PropertyValue], AfterValidator(Unchanging)] = Field(
        description="whatever a person wants to note"
    )
    x: Number = Field(description="of its frame, in which the grid of `image` is drawn, metres")
    y: Number = Field(description="of its frame, metres")
    theta: Number = Field(description="of its frame, radians, counter-clockwise")
    centroid: Point | None = Field(
        description="free cell of the submap nearest to the mean of its cells; null without a cell"
    )
    anchor: Point | None = Field(
        description="a place in it where a robot can stand: near its middle, with clearance; null "
        "without a cell"
    )
    anchor_clearance_m: Amount | None = Field(
        description="from the anchor to the nearest thing that is not free, metres"
    )
    polygon: tuple[Point, ...] = Field(
        description="border of its largest connected part, counter-clockwise, not closed"
    )
    area_m2: Amount = Field(description="area of its free cells, square metres")
    scans: Count = Field(description="number of its keyframes")
    visits: tuple[Visit, ...] = Field(description="when the robot was in it, in order")
    image: InnerPath = Field(description="picture of its grid in this directory; a YAML beside it")

    @classmethod
    def of(cls, submap: Submap, shape: Outline) -> Self:
        """A submap of a map in which it owns the region of that shape."""
        x, y, theta = transform(submap.map_from_submap)
        polygon = [point(corner) for corner in shape.polygon]
        return cls(
            id=submap.id,
            name=submap.name or default_name(submap.id),
            kind=submap.kind or kind_of(np.array(polygon)),  # as it is read again
            properties=dict(submap.properties),
            x=x,
            y=y,
            theta=theta,
            centroid=None if shape.centroid is None else point(shape.centroid),
            anchor=None if submap.anchor is None else point(submap.anchor),
            anchor_clearance_m=submap.anchor_clearance_m,
            polygon=polygon,
            area_m2=shape.area_m2,
            scans=len(submap.keyframes),
            visits=submap.visits,
            image=f"submaps/{submap.id:03d}.png",
        )

    @property
    def frame(self) -> Pose2:
        """The pose of its frame in the map."""
        return Pose2(self.x, self.y, self.theta)


class TopologyRecord(Record):
    """The whole file."""

    directed: Literal[False] = Field(description="for networkx")
    multigraph: Literal[False] = Field(description="for networkx")
    graph: GraphRecord = Field(description="what holds for the whole map")
    nodes: tuple[NodeRecord, ...] = Field(description="the submaps, by id")
    edges: tuple[Edge, ...] = Field(description="the links, by source and target")

    @property
    def area_m2(self) -> float:
        """Area of the map: that of its submaps."""
        return sum(node.area_m2 for node in self.nodes)

    @property
    def seen_m2(self) -> float:
        """Area of what was only seen."""
        return sum(piece.area_m2 for piece in self.graph.seen)

    @classmethod
    def of(
        cls,
        topology: TopologicalMap,
        regions: Regions,
        logs: Sequence[LogInfo],
        frame: str = "map",
        quality: Quality | None = None,
    ) -> Self:
        """The file of a map with these regions, made of `logs`; `frame` is that of coordinates.

        Closures name the submaps that their stays are in by now.
        """
        submap_of = {stay.number: stay.submap for stay in topology.stays}
        nodes = tuple(
            NodeRecord.of(submap, regions.outline(id_))
            for id_, submap in sorted(topology.submaps.items())
        )
        return cls(
            directed=False,
            multigraph=False,
            graph=GraphRecord(
                schema_version=SCHEMA_VERSION,
                frame=frame,
                next_id=max(topology.next_id, 1 + max(topology.submaps, default=-1)),
                logs=tuple(logs),
                stays=topology.stays,
                breaks=topology.breaks,
                closures=tuple(
                    replace(
                        closure,
                        new_submap=submap_of.get(closure.new),
                        old_submap=submap_of.get(closure.old),
                    )
                    for closure in topology.closures
                ),
                doors=topology.doors,
                seen=regions.seen,
                robot_radius_m=topology.robot_radius_m,
                edits=EditsRecord(submaps=topology.said, borders=topology.borders),
                quality=quality,
            ),
            nodes=nodes,
            edges=placed(topology, nodes),
        )

    def topology(
        self, grid_of: Callable[[NodeRecord], GridMap], keyframes_of: Callable[[int], Iterable[int]]
    ) -> TopologicalMap:
        """The map; grids and keyframe numbers come from the files beside this one."""
        graph, submaps = self.graph, {}
        for node in self.nodes:
            polygon = np.array(node.polygon, dtype=np.float64).reshape(-1, 2)
            submaps[node.id] = Submap(
                id=node.id,
                map_from_submap=node.frame,
                keyframes=tuple(keyframes_of(node.id)) if node.scans else (),
                visits=node.visits,
                grid=grid_of(node),
                polygon=node.frame.inverse().apply(polygon),
                name=node.name,
                kind=node.kind,
                properties=node.properties,
                anchor=node.anchor,
                anchor_clearance_m=node.anchor_clearance_m,
            )
        return TopologicalMap(
            submaps=submaps,
            edges={(edge.source, edge.target): edge for edge in self.edges},
            closures=graph.closures,
            stays=graph.stays,
            breaks=graph.breaks,
            next_id=graph.next_id,
            doors=graph.doors,
            robot_radius_m=graph.robot_radius_m,
            said=graph.edits.submaps,
            borders=graph.edits.borders,
        )

    def text(self) -> str:
        """The file as it is written: the same text for the same map."""
        return to_json(self.model_dump(by_alias=True))


def placed(topology: TopologicalMap, nodes: Iterable[NodeRecord]) -> tuple[Edge, ...]:
    """The edges, each with its crossing, and how far it is over that from centroid to centroid."""
    middles = {node.id: node.centroid or (node.x, node.y) for node in nodes}
    edges = []
    for (source, target), edge in sorted(topology.edges.items()):
        crossing = edge.crossing
        places = [middles[source], *([] if crossing is None else [crossing]), middles[target]]
        x, y = crossing or (None, None)
        distance_m = sum(math.dist(a, b) for a, b in itertools.pairwise(places))
        edges.append(replace(edge, x=x, y=y, distance_m=distance_m))
    return tuple(edges)


SCHEMA = ModelSchema(TopologyRecord, "topology", SCHEMA_VERSION, "specmap topology.json")


def read_topology(path: Path, limits: LimitsConfig) -> tuple[TopologyRecord, str]:
    """The record in a topology.json, and what is to be said of it: what an old one lacks.

    Raises MapError when it cannot be read, is of an unknown version, or contradicts itself.
    """
    document = map_json(path, limits)
    graph = part_of(document, "graph")
    version, note = graph.get("schema_version"), ""
    if version == 1:
        document, note = upgraded(document), f"{path.parent}: {MISSING}"
    elif version == SCHEMA_VERSION and graph.keys().isdisjoint(_NOT_AT_FIRST):
        document, note = upgraded(document), f"{path.parent}: {WITHOUT_DOORS}"
    elif version != SCHEMA_VERSION:
        raise MapError.damaged(
            f"graph.schema_version is {version!r}: this version reads 1 and {SCHEMA_VERSION}", path
        )
    try:
        record = TopologyRecord.model_validate(document)
    except ValidationError as error:
        raise MapError.damaged(first_finding(error), path) from None
    for fault in _faults(record):
        raise MapError.damaged(fault, path)
    return record, note


def _faults(record: TopologyRecord) -> Iterator[str]:
    """What does not fit together in a record."""
    graph, ids = record.graph, {node.id for node in record.nodes}
    if len(ids) != len(record.nodes):
        yield "nodes: an id occurs twice"
    if graph.next_id <= max(ids, default=-1):
        yield f"graph.next_id: {graph.next_id} is the id of a node or smaller"
    named: dict[str, list[tuple[int | None, ...]]] = {
        "edges": [(edge.source, edge.target) for edge in record.edges],
        "graph.doors": [door.between for door in graph.doors],
        "graph.stays": [(stay.submap,) for stay in graph.stays],
        "graph.closures": [(one.new_submap, one.old_submap) for one in graph.closures],
        "graph.edits.submaps": [(said.id,) for said in graph.edits.submaps],
    }
    for where, all_ in named.items():
        for number, some in enumerate(all_):
            for id_ in some:
                if id_ is not None and id_ not in ids:
                    yield f"{where}.{number}: submap {id_} is not among the nodes"
    doors = {door.id for door in graph.doors}
    if len(doors) != len(graph.doors):
        yield "graph.doors: an id occurs twice"
    for number, edge in enumerate(record.edges):
        for door in edge.doors:
            if door not in doors:
                yield f"edges.{number}: door {door} is not among graph.doors"
    # stays and merges whose keyframes do not fit, closures of no stays, lines without a length
    stays = graph.stays
    numbers = {stay.number for stay in stays}
    if len(numbers) != len(stays):
        yield "graph.stays: a number occurs twice"
    for place, stay in enumerate(stays):
        if not _are_ascending(stay.runs):
            yield f"graph.stays.{place}: its keyframes are out of order"
        if not any(first <= stay.origin <= last for first, last in stay.runs):
            yield f"graph.stays.{place}: its origin is none of its keyframes"
    for place, closure in enumerate(graph.closures if stays else ()):
        if not {closure.new, closure.old} <= numbers:
            yield f"graph.closures.{place}: its stays are not among graph.stays"
    for place, border in enumerate(graph.edits.borders):
        where = f"graph.edits.borders.{place}"
        if isinstance(border, Split):
            if any(line is not None and line[0] == line[1] for line in (border.line, border.fence)):
                yield f"{where}: a line without a length"
        elif not _are_ascending(border.runs):
            yield f"{where}: its keyframes are out of order"
        elif any(last >= border.known for _, last in border.runs):
            yield f"{where}: more keyframes than the map had"


def _are_ascending(runs: Sequence[Span]) -> bool:
    """Whether the numbers in runs [first, last] rise."""
    ends = [-1, *(last for _, last in runs)]
    return all(before < first <= last for before, (first, last) in zip(ends, runs, strict=False))


MISSING = (
    "a map of an earlier version (schema 1): it keeps no keyframes, stays, kinds of submaps, doors "
    "or ways, and cannot be updated, merged or divided anew; build it again to have these"
)

WITHOUT_DOORS = (
    "a map of an earlier version: it keeps no doors or ways; update it, or build it again to have "
    "these"
)
_NOT_AT_FIRST = {"doors", "robot_radius_m", "edits"}  # of the graph, in any version since


def upgraded(document: dict[str, Any]) -> dict[str, Any]:
    """A document of schema 1, or of the first versions of schema 2, as one of schema 2."""
    graph, nodes = document["graph"], document.get("nodes")
    stays = graph.get("stays", [])
    objects = [node for node in nodes if isinstance(node, dict)] if isinstance(nodes, list) else []
    ids = [node["id"] for node in objects if isinstance(node.get("id"), int)]
    return {
        **document,
        "graph": {
            "quality": None,  # the first maps were not judged
            "next_id": 1 + max(ids, default=-1),
            "logs": _each([graph.get("log")], keyframes=None),
            "breaks": [],
            "doors": [],
            "robot_radius_m": None,
            "edits": {"submaps": [], "borders": []},
            **{key: value for key, value in graph.items() if key != "log"},
            "schema_version": SCHEMA_VERSION,
            "stays": list(map(_with_origin, stays)) if isinstance(stays, list) else stays,
            "closures": _each(graph.get("closures"), new_submap=None, old_submap=None),
        },
        "nodes": _each(nodes, kind=None, properties={}, anchor=None, anchor_clearance_m=None),
        "edges": _each(
            document.get("edges"),
            doors=[],
            path=None,
            length_m=None,
            clearance_m=None,
            forbidden=False,
        ),
    }


def _with_origin(stay: Any) -> Any:
    """A stay of a version that did not tell its frame: it was that of the first keyframe."""
    match stay:
        case {"keyframes": [[first, _], *_]}:
            return {"origin": first, **stay}
    return stay


def _each(values: Any, **lacking: Any) -> Any:
    """A list whose objects have what they were `lacking`."""
    if not isinstance(values, list):
        return values
    return [{**lacking, **value} if isinstance(value, dict) else value for value in values]

"""The contents of topology.json: node-link JSON that networkx reads as it is.

These models are the format. `topology.schema.json` beside this file is the same as JSON Schema, for
other tools. After a change of the models, `python -m specmap_cli.maps.schema` prints the new one.
Lengths are metres, angles radians, stamps seconds; everything is in the frame named by
`graph.frame` unless it says otherwise.
"""

from __future__ import annotations

import sys
from typing import Literal

from pydantic import Field

from specmap_cli.core.schemas import ModelSchema
from specmap_cli.maps.schema_graph import SCHEMA_VERSION, GraphRecord, TraversalRecord
from specmap_cli.maps.schema_values import (
    Amount,
    Count,
    InnerPath,
    Number,
    Point,
    PropertyValue,
    Record,
    Stamp,
    Transform,
)
from specmap_cli.topology.topological_map import EdgeKind, SubmapKind


class VisitRecord(Record):
    """One visit of the robot to a submap."""

    start: Stamp = Field(description="stamp of its first keyframe, seconds")
    end: Stamp = Field(description="stamp of its last keyframe, seconds")


class NodeRecord(Record):
    """One submap."""

    id: Count = Field(description="never given again, and never changed once given")
    name: str = Field(description="for people; they may change it")
    kind: SubmapKind | None = Field(
        description="what it is by its shape, or by a person's word; null where it has no area, or "
        "nobody looked"
    )
    properties: dict[str, PropertyValue] = Field(description="whatever a person wants to note")
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
    polygon: list[Point] = Field(
        description="border of its largest connected part, counter-clockwise, not closed"
    )
    area_m2: Amount = Field(description="area of its free cells, square metres")
    scans: Count = Field(description="number of its keyframes")
    visits: list[VisitRecord] = Field(description="when the robot was in it, in order")
    image: InnerPath = Field(description="picture of its grid in this directory; a YAML beside it")


class EdgeRecord(Record):
    """An undirected link between two submaps."""

    source: Count = Field(description="id of a node, smaller than `target`")
    target: Count = Field(description="id of a node")
    kind: EdgeKind = Field(description="how the two are known to be joined")
    traversals: list[TraversalRecord] = Field(description="each crossing, in order")
    doors: list[Count] = Field(
        description="ids of the doors that `path` goes through, in order; none: it crosses an open "
        "border. Without a path: of all doors between the two"
    )
    path: list[Point] | None = Field(
        description="from the anchor of `source` to that of `target`, inside the two submaps, "
        "through free cells that the robot can pass; null where it is too wide for every way"
    )
    length_m: Amount | None = Field(description="along the path, metres; null without one")
    clearance_m: Amount | None = Field(
        description="the least on the path; without one that of the widest way, smaller than "
        "graph.robot_radius_m; null where no free cells join the two"
    )
    x: Number | None = Field(
        description="of the first door on the path; in the open the mean of the traversals; null "
        "without them"
    )
    y: Number | None = Field(description="as x")
    distance_m: Amount = Field(description="from centroid to centroid, through the crossing")
    width_m: Amount | None = Field(description="of the first door on the path; null in the open")
    transform: Transform = Field(
        description="[x, y, theta] of the frame of `target` in the frame of `source`"
    )
    forbidden: bool = Field(description="whether a person said that robots must not go there")


class TopologyRecord(Record):
    """The whole file."""

    directed: Literal[False] = Field(description="for networkx")
    multigraph: Literal[False] = Field(description="for networkx")
    graph: GraphRecord = Field(description="what holds for the whole map")
    nodes: list[NodeRecord] = Field(description="the submaps, by id")
    edges: list[EdgeRecord] = Field(description="the links, by source and target")


SCHEMA = ModelSchema(TopologyRecord, "topology", SCHEMA_VERSION, "specmap topology.json")

if __name__ == "__main__":
    sys.stdout.write(SCHEMA.text())

"""A reader of layouts by the rules of LIF 1.0.0 (VDMA, March 2024), in our words.

Fields are those of its definition, as the schema of LIF_Schema (b1007b7) has them. Beyond a schema:
ids are unique, edges lead between nodes, stations have a node, and no list of vehicles is empty.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import jsonschema
import networkx as nx

TEXT, NUMBER = {"type": "string"}, {"type": "number"}


def _object(required: str, **optional: Any) -> dict[str, Any]:
    """An object that must have some texts, and may have others; nothing else."""
    fields = dict.fromkeys(required.split(), TEXT) | optional
    must = [*required.split(), *(name for name in optional if name not in _MAY_BE_LEFT_OUT)]
    return {"type": "object", "required": must, "properties": fields, "additionalProperties": False}


def _some(items: Any, least: int = 1) -> dict[str, Any]:
    return {"type": "array", "items": items, "minItems": least}


_MAY_BE_LEFT_OUT = {"maxSpeed", "nodeName", "mapId"}
_PLACE = _object("", x=NUMBER, y=NUMBER)
_ON_A_NODE = _object("vehicleTypeId")
_ON_AN_EDGE = _object("vehicleTypeId", rotationAllowed={"type": "boolean"}, maxSpeed=NUMBER)
_STAMP = {"type": "string", "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d\dZ$"}
_NODE = _object(
    "nodeId",
    nodeName=TEXT,
    mapId=TEXT,
    nodePosition=_PLACE,
    vehicleTypeNodeProperties=_some(_ON_A_NODE),
)
_EDGE = _object("edgeId startNodeId endNodeId", vehicleTypeEdgeProperties=_some(_ON_AN_EDGE))
_STATION = _object(
    "stationId stationName stationDescription",
    interactionNodeIds=_some(TEXT),
    stationPosition=_PLACE,
)
_LAYOUT = _object(
    "layoutId layoutVersion", nodes=_some(_NODE), edges=_some(_EDGE), stations=_some(_STATION, 0)
)
RULES = _object(
    "",
    metaInformation=_object("projectIdentification creator lifVersion", exportTimestamp=_STAMP),
    layouts=_some(_LAYOUT),
)


def load(path: Path) -> nx.DiGraph:
    """The nodes and edges of a layout, its `stations` by their nodes; edges have `length_m`."""
    found = json.loads(path.read_text(encoding="utf-8"))
    jsonschema.validate(found, RULES)
    (layout,) = found["layouts"]
    stations = {one["interactionNodeIds"][0]: one for one in layout["stations"]}
    graph = nx.DiGraph(stations=stations)
    for node in layout["nodes"]:
        assert node["nodeId"] not in graph
        place = node["nodePosition"]
        graph.add_node(node["nodeId"], at=(place["x"], place["y"]), name=node["nodeName"])
    ids = set[str]()
    for edge in layout["edges"]:
        start, end = edge["startNodeId"], edge["endNodeId"]
        assert start in graph
        assert end in graph
        assert edge["edgeId"] not in ids
        ids.add(edge["edgeId"])
        length = math.dist(graph.nodes[start]["at"], graph.nodes[end]["at"])
        (vehicle,) = edge["vehicleTypeEdgeProperties"]
        graph.add_edge(start, end, length_m=length, max_speed=vehicle.get("maxSpeed"))
    assert stations.keys() <= set(graph)
    return graph

"""Submaps and graph as scenes of Foxglove: lines, points and names that tell of themselves.

A click on one of them shows what the map knows of it. Colours are those of overview.png.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from specmap_cli.core.json_values import Point
from specmap_cli.drawing.palette import darker
from specmap_cli.exports.fields import (
    DOOR,
    LINK,
    SUBMAP,
    Fields,
    centre_of,
    fields_of,
    known,
    link_line,
    noted_fields,
)
from specmap_cli.exports.foxglove_schemas import LINE_LOOP, LINE_STRIP
from specmap_cli.exports.layers import WAY, Rgb, door_colour, link_colour
from specmap_cli.maps.schema import NodeRecord, TopologyRecord
from specmap_cli.topology.topological_map import Door, Edge

_LINE_PX, _NO_WAY_PX, _OUTLINE_PX, _TEXT_PX = 3.0, 1.0, 2.0, 14.0
_ANCHOR_M = 0.25
# Heights at which things lie above the map, metres: each is seen on those below.
_OUTLINE_Z, _WAY_Z, _ANCHOR_Z, _TEXT_Z = 0.02, 0.04, 0.06, 0.5


def submap_scene(record: TopologyRecord, stamp: Fields, fills: Mapping[int, Rgb]) -> dict[str, Any]:
    """The outline and the name of each submap."""
    frame = record.graph.frame
    return {
        "entities": [
            {
                **_entity(f"submap {node.id}", frame, stamp, _told(node)),
                "lines": [_outline(node, fills[node.id])] if node.polygon else [],
                "texts": [_name(node, fills[node.id])],
            }
            for node in record.nodes
        ]
    }


def graph_scene(record: TopologyRecord, stamp: Fields) -> dict[str, Any]:
    """Anchors, ways and doors; a link without a way leads straight over its crossing, thin."""
    frame = record.graph.frame
    nodes = {node.id: node for node in record.nodes}
    return {
        "entities": [
            *_anchors(record, frame, stamp),
            *(
                {
                    **_entity(_link_id(edge), frame, stamp, fields_of(edge, LINK)),
                    "lines": [_way(edge, nodes)],
                }
                for edge in record.edges
            ),
            *(
                {
                    **_entity(f"door {door.id}", frame, stamp, fields_of(door, DOOR)),
                    "lines": [_door(door)],
                }
                for door in record.graph.doors
            ),
        ]
    }


def _anchors(record: TopologyRecord, frame: str, stamp: Fields) -> Iterator[dict[str, Any]]:
    size = {"x": _ANCHOR_M, "y": _ANCHOR_M, "z": 0.01}
    for node in record.nodes:
        if node.anchor is not None:
            pose = _at(node.anchor, _ANCHOR_Z)
            sphere = {"pose": pose, "size": size, "color": _colour(WAY)}
            told = {"clearance_m": node.anchor_clearance_m}
            yield {**_entity(f"anchor {node.id}", frame, stamp, told), "spheres": [sphere]}


def _told(node: NodeRecord) -> Fields:
    return {"id": node.id, **fields_of(node, SUBMAP), **noted_fields(node)}


def _link_id(edge: Edge) -> str:
    return f"link {edge.source}-{edge.target}"


def _entity(id_: str, frame: str, stamp: Fields, told: Fields) -> dict[str, Any]:
    """What all entities have; what they tell stands in their metadata."""
    pairs = [{"key": key, "value": str(value)} for key, value in known(told).items()]
    return {"timestamp": stamp, "frame_id": frame, "id": id_, "metadata": pairs}


def _outline(node: NodeRecord, fill: Rgb) -> dict[str, Any]:
    return _line(node.polygon, darker(fill), _OUTLINE_PX, _OUTLINE_Z, LINE_LOOP)


def _name(node: NodeRecord, fill: Rgb) -> dict[str, Any]:
    return {
        "pose": _at(node.anchor or centre_of(node), _TEXT_Z),
        "billboard": True,
        "font_size": _TEXT_PX,
        "scale_invariant": True,
        "color": _colour(darker(fill)),
        "text": node.name,
    }


def _way(edge: Edge, nodes: Mapping[int, NodeRecord]) -> dict[str, Any]:
    width_px = _LINE_PX if edge.corners else _NO_WAY_PX
    return _line(link_line(edge, nodes), link_colour(edge), width_px, _WAY_Z)


def _door(door: Door) -> dict[str, Any]:
    return _line(door.sides, door_colour(door), 2.0 * _LINE_PX, _WAY_Z)


def _line(
    points: Sequence[Point], colour: Rgb, thickness_px: float, z: float, kind: int = LINE_STRIP
) -> dict[str, Any]:
    """A line as wide on the screen at any distance."""
    return {
        "type": kind,
        "pose": _at((0.0, 0.0), 0.0),
        "thickness": thickness_px,
        "scale_invariant": True,
        "points": [{"x": x, "y": y, "z": z} for x, y in points],
        "color": _colour(colour),
    }


def _at(place: Point, z: float) -> dict[str, Any]:
    x, y = place
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}


def _colour(rgb: Rgb) -> dict[str, float]:
    red, green, blue = (channel / 255.0 for channel in rgb)
    return {"r": red, "g": green, "b": blue, "a": 1.0}

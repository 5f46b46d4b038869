"""Graphs for fleets of robots: for Open-RMF, and in the Layout Interchange Format of VDA 5050.

Both take straight lines from point to point, so points stand at anchors, in doors, and wherever a
way bends. Open-RMF opens a door for each lane that crosses its line: where a way goes straight
through a door one lane crosses it, and no robot waits in between.
"""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from itertools import permutations
from typing import IO, Any

from specmap_cli import __version__
from specmap_cli.core.files import write_zip
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import counted, to_json
from specmap_cli.core.yaml import yaml_text
from specmap_cli.exports.routes import SPEED_LIMIT, Leg, Waypoint, ended, routes_of
from specmap_cli.maps.rooms import Fields, known
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import Map

_TEXT, _WHOLE, _NUMBER, _YES_NO = 1, 2, 3, 4  # how traffic_editor tells the type of a parameter
_LEVEL, _GRAPH = "L1", 0


def rmf(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """A zip of building.yaml and nav_graphs/0.yaml, for Open-RMF.

    They are for the traffic editor and for fleet adapters. Raises MapError for a map without ways.
    """
    record, name = stored.record, stored.path.resolve().name
    found = routes_of(stored, progress).without(lambda one: one.kind == "door" and one.straight)
    if record.graph.doors:
        progress.warn(
            f"{counted(len(record.graph.doors), 'door')}: Open-RMF waits at a door until "
            "something opens it; take out those that nobody shuts"
        )
    names = _names(record)
    rows = {one.id: row for row, one in enumerate(found.waypoints)}
    lanes = [(rows[leg.start], rows[leg.end], leg) for leg in found.legs]
    parts = {
        f"{name}.building.yaml": _building(name, record, found.waypoints, names, lanes),
        "nav_graphs/0.yaml": _nav_graph(name, found.waypoints, names, lanes),
    }
    write_zip(target, {path: yaml_text(part).encode() for path, part in parts.items()})


_Lanes = list[tuple[int, int, Leg]]


def _names(record: TopologyRecord) -> dict[int, str]:
    """What people call submaps, by id; Open-RMF wants each name once."""
    often = Counter(node.name for node in record.nodes)
    return {
        node.id: node.name if often[node.name] == 1 else f"{node.name} ({node.id})"
        for node in record.nodes
    }


def _options(one: Waypoint, names: dict[int, str]) -> Fields:
    """A robot may wait at an anchor only."""
    if one.submap is None:
        return {"is_passthrough_point": True}
    return {"is_holding_point": True, "name": names[one.submap]}


def _building(
    name: str,
    record: TopologyRecord,
    waypoints: tuple[Waypoint, ...],
    names: dict[int, str],
    lanes: _Lanes,
) -> Fields:
    """Vertices are those of lanes, then the ends of doors."""
    vertices: list[Any] = []
    for one in waypoints:
        told = _options(one, names)
        called = told.pop("name", "")
        vertices.append([one.x, one.y, 0.0, called, {key: [_YES_NO, told[key]] for key in told}])
    doors = []
    for door in record.graph.doors:
        told = {
            "motion_axis": [_TEXT, "start"],
            "motion_degrees": [_NUMBER, 90.0],
            "motion_direction": [_WHOLE, 1],
            "name": [_TEXT, f"Door{door.id}"],
            "type": [_TEXT, "hinged"],
        }
        doors.append([len(vertices), len(vertices) + 1, told])
        vertices += [[round(x, 6), round(y, 6), 0.0, "", {}] for x, y in door.sides]
    both_ways = {"bidirectional": [_YES_NO, True], "graph_idx": [_WHOLE, _GRAPH]}
    level = {
        "elevation": 0.0,
        "vertices": vertices,
        "lanes": [
            [start, end, both_ways | {SPEED_LIMIT: [_NUMBER, leg.speed_limit or 0.0]}]  # 0: none
            for start, end, leg in lanes
        ],
        "doors": doors,
        "measurements": [],
        "walls": [],
        "floors": [],
        "models": [],
    }
    return {
        "name": name,
        "coordinate_system": "cartesian_meters",
        "parameters": {},
        "levels": {_LEVEL: level},
        "lifts": {},
    }


def _nav_graph(
    name: str, waypoints: tuple[Waypoint, ...], names: dict[int, str], lanes: _Lanes
) -> Fields:
    """What `building_map_generator nav` makes of the building: a lane in each direction."""
    both = []
    for start, end, leg in lanes:
        told = known({SPEED_LIMIT: leg.speed_limit})
        if leg.doors:
            told["door_name"] = f"Door{leg.doors[0]}"
        both += [[start, end, told], [end, start, told]]
    vertices = [[one.x, one.y, {"name": "", **_options(one, names)}] for one in waypoints]
    level = {"vertices": vertices, "lanes": both}
    return {"building_name": name, "levels": {_LEVEL: level}, "lifts": {}}


_VEHICLES = "any"  # the type of all vehicles: their factsheets name theirs


def lif(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """JSON: a layout in the format LIF 1.0.0 of VDMA, for VDA 5050 fleets.

    Nodes are waypoints, edges the legs both ways, stations rooms. MapError for a map without ways.
    """
    record, name = stored.record, stored.path.resolve().name
    found = routes_of(stored, progress)
    called, rooms = _names(record), {node.id: node for node in record.nodes}
    ids = {one.id: one.name for one in found.waypoints}
    anchors = [(one, one.submap) for one in found.waypoints if one.submap is not None]
    layout = {
        "layoutId": name,
        "layoutVersion": "1",
        "nodes": [
            {
                "nodeId": one.name,
                "nodeName": one.name if one.submap is None else called[one.submap],
                "mapId": record.graph.frame,
                "nodePosition": {"x": one.x, "y": one.y},
                "vehicleTypeNodeProperties": [{"vehicleTypeId": _VEHICLES}],
            }
            for one in found.waypoints
        ],
        "edges": [
            {
                "edgeId": f"{start}_{end}",
                "startNodeId": start,
                "endNodeId": end,
                "vehicleTypeEdgeProperties": [
                    {"vehicleTypeId": _VEHICLES, "rotationAllowed": True}
                    | known({"maxSpeed": leg.speed_limit})
                ],
            }
            for leg in found.legs
            for start, end in permutations((ids[leg.start], ids[leg.end]))
        ],
        "stations": [
            {
                "stationId": f"Station{id_}",
                "interactionNodeIds": [one.name],
                "stationName": called[id_],
                "stationDescription": rooms[id_].kind or "submap",
                "stationPosition": {"x": one.x, "y": one.y},
            }
            for one, id_ in anchors
        ],
    }
    made = datetime.fromtimestamp(ended(record), UTC).strftime("%Y-%m-%dT%H:%M:%S.00Z")
    about = {
        "projectIdentification": name,
        "creator": f"specmap {__version__}",
        "exportTimestamp": made,
        "lifVersion": "1.0.0",
    }
    target.write(to_json({"metaInformation": about, "layouts": [layout]}).encode())

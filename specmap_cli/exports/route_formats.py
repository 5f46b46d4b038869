"""What robots are sent along: Nav2's route graph and masks, the graph of topological_navigation.

docs/export.md says what is in them. The server of Nav2 drives a straight line from node to node,
so every bend needs one; its loader takes neither null nor lists in lists. topological_navigation
leaves the way to the robot's own planner. Nav2 reads a cell of a mask as 0 to 100: to its keepout
filter 100 is a wall, to its speed filter 0 is no limit, and all else times `multiplier` is m/s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import count
from typing import IO

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.files import write_zip
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import counted, to_json
from specmap_cli.core.yaml import yaml_text
from specmap_cli.exports import routes
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.rooms import Fields, collection, feature, known
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import Map
from specmap_cli.topology.regions import borders_of, drawn


def nav2(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """GeoJSON for Nav2's route server: nodes at anchors, doors and bends.

    A point for each waypoint, two lines for each leg. Raises MapError for a map without ways.
    """
    found = routes.routes_of(stored, progress)
    nodes, edges = list(_nav2_nodes(found, stored.record)), list(_nav2_edges(found))
    progress.note(f"{counted(len(nodes), 'node')} and {counted(len(edges), 'directed edge')}")
    target.write(to_json(collection([*nodes, *edges])).encode())


def _nav2_nodes(found: routes.Routes, record: TopologyRecord) -> Iterator[Fields]:
    """Points; the `class` of an anchor is the kind of its submap."""
    submaps = {node.id: node for node in record.nodes}
    doors = {door.id: door for door in record.graph.doors}
    for waypoint in found.waypoints:
        metadata: Fields = {"class": waypoint.kind}
        if waypoint.submap is not None:
            node = submaps[waypoint.submap]
            xs, ys = zip(*node.polygon, strict=True) if node.polygon else ((), ())
            region = {"x_values": list(xs), "y_values": list(ys)}
            metadata = known(
                {
                    "class": node.kind or "submap",
                    "submap": node.id,
                    "name": node.name,
                    "area_m2": node.area_m2,
                    "clearance_m": node.anchor_clearance_m,
                    "region": region if node.polygon else None,
                    "properties": node.properties or None,
                }
            )
        elif waypoint.door is not None:
            door = doors[waypoint.door]
            metadata |= {"door": door.id, "width_m": door.width_m, "driven": door.driven}
        properties = {"id": waypoint.id, "frame": record.graph.frame, "metadata": metadata}
        yield feature("Point", [waypoint.x, waypoint.y], properties)


def _nav2_edges(found: routes.Routes) -> Iterator[Fields]:
    """Two lines a leg, whose ids begin beyond those of the nodes; the cost is the length."""
    waypoints = {waypoint.id: waypoint for waypoint in found.waypoints}
    ids = count(max(waypoints) + 1)
    for leg in found.legs:
        link, ends = leg.link, (waypoints[leg.start], waypoints[leg.end])
        metadata = known(
            {
                "class": link.kind,
                "submaps": [link.source, link.target],
                routes.SPEED_LIMIT: leg.speed_limit,
                routes.PENALTY: leg.penalty or None,
                "driven": bool(link.traversals),
                "clearance_m": link.clearance_m,
                "width_m": link.width_m,
            }
        )
        for start, end in (ends, ends[::-1]):
            properties = {
                "id": next(ids),
                "startid": start.id,
                "endid": end.id,
                "cost": leg.length_m,
                "overridable": True,
                "metadata": metadata,
            }
            yield feature("LineString", [[start.x, start.y], [end.x, end.y]], properties)


_XY_TOLERANCE_M, _YAW_TOLERANCE_RAD = 0.3, 2.0 * math.pi  # the format's own: any heading will do
_CORNERS = 8  # of the influence zone of a door
_IDENTITY = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def tmap2(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """YAML: a topological map (tmap2) for LCAS topological_navigation.

    A node for each anchor and door, an edge in each direction. MapError for a map without ways.
    """
    record, name = stored.record, stored.path.resolve().name
    found = routes.routes_of(stored, progress).without(lambda point: point.kind == "bend")
    updated = datetime.fromtimestamp(routes.ended(record), UTC).strftime("%Y-%m-%d_%H-%M-%S")
    document = {
        "meta": {"last_updated": updated},
        "metric_map": name,
        "name": name,
        "pointset": name,
        "transformation": {
            "parent": record.graph.frame,
            "child": "topo_map",
            "topo_frame_id": "topo_map",
            "rotation": _IDENTITY,
            "translation": {"x": 0.0, "y": 0.0, "z": 0.0},
        },
        "nodes": list(_tmap2_nodes(found, record, name)),
    }
    target.write(yaml_text(document).encode())


def _tmap2_nodes(found: routes.Routes, record: TopologyRecord, name: str) -> Iterator[Fields]:
    names = {one.id: one.name for one in found.waypoints}  # people's are properties
    submaps = {node.id: node for node in record.nodes}
    widths = {door.id: door.width_m for door in record.graph.doors}
    edges: dict[int, list[Fields]] = {waypoint.id: [] for waypoint in found.waypoints}
    for leg in found.legs:
        edges[leg.start].append(_tmap2_edge(names[leg.start], names[leg.end], leg))
        edges[leg.end].append(_tmap2_edge(names[leg.end], names[leg.start], leg))
    for waypoint in found.waypoints:
        if waypoint.submap is None:
            width_m = 0.0 if waypoint.door is None else widths[waypoint.door]
            told: Fields = {"width_m": width_m}
            zone = _circle(width_m / 2.0)
        else:  # the outline of the submap, seen from its node
            submap = submaps[waypoint.submap]
            told = known({"label": submap.name, "kind": submap.kind, "area_m2": submap.area_m2})
            outline = [{"x": x - waypoint.x, "y": y - waypoint.y} for x, y in submap.polygon]
            zone = outline or _circle(_XY_TOLERANCE_M)
        yield {
            "meta": {"map": name, "node": names[waypoint.id], "pointset": name},
            "node": {
                "localise_by_topic": "",
                "parent_frame": record.graph.frame,
                "pose": {
                    "position": {"x": waypoint.x, "y": waypoint.y, "z": 0.0},
                    "orientation": _IDENTITY,
                },
                "properties": {
                    "xy_goal_tolerance": _XY_TOLERANCE_M,
                    "yaw_goal_tolerance": _YAW_TOLERANCE_RAD,
                    **told,
                },
                "restrictions_planning": "True",
                "restrictions_runtime": "True",
                "verts": zone,
                "name": names[waypoint.id],
                "edges": edges[waypoint.id],
            },
        }


def _circle(radius_m: float) -> list[Fields]:
    turns = [2.0 * math.pi * corner / _CORNERS for corner in range(_CORNERS)]
    return [{"x": radius_m * math.cos(turn), "y": radius_m * math.sin(turn)} for turn in turns]


def _tmap2_edge(start: str, end: str, leg: routes.Leg) -> Fields:
    return {
        "action": "NavigateToPose",
        "action_type": "geometry_msgs/PoseStamped",
        "config": [],
        "edge_id": f"{start}_{end}",
        "fail_policy": "fail",
        "fluid_navigation": True,
        "goal": {
            "target_pose": {"header": {"frame_id": "$node.parent_frame"}, "pose": "$node.pose"}
        },
        "node": end,
        "properties": known(
            {
                "weight": leg.cost,
                "length_m": leg.length_m,
                routes.SPEED_LIMIT: leg.speed_limit,
                routes.PENALTY: leg.penalty or None,
                "clearance_m": leg.link.clearance_m,
                "driven": bool(leg.link.traversals),
            }
        ),
        "recovery_behaviours_config": "",
        "restrictions_planning": "True",
        "restrictions_runtime": "True",
    }


_KEEPOUT, _ABSOLUTE_SPEED = 0, 2  # of Nav2's filters
_FULL = 100  # the largest value of a cell


def nav2_masks(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """A zip of keepout and speed masks with their parameters, for Nav2's filters."""
    record, grid = stored.record, stored.regions.grid
    for warning in routes.misnoted(record):
        progress.warn(warning)
    limits = routes.noted(record, routes.SPEED_LIMIT)
    keepout, speed = np.zeros((2, *grid.cells.shape), dtype=np.uint8)
    # forbidden doors, and both sides of where submaps of a forbidden link touch
    shut = drawn([door.sides for door in stored.doors if door.forbidden], grid)
    apart = {(edge.source, edge.target) for edge in record.edges if edge.forbidden}
    for border in borders_of(stored.regions.owner) if apart else ():
        if border.pair in apart:
            shut[tuple(border.low.T)] = shut[tuple(border.high.T)] = True
    keepout[shut] = _FULL
    multiplier = max(limits.values(), default=float(_FULL)) / _FULL
    for id_, limit in limits.items():  # never faster than was said, if it can be
        value = math.floor(limit / multiplier + 1e-9)
        if value < 1:
            progress.warn(
                f"submap {id_}: {routes.SPEED_LIMIT} {limit:g} is written as {multiplier:g}, "
                "a hundredth of the largest one: a mask holds nothing smaller"
            )
        speed[stored.regions.owner == id_] = max(value, 1)
    progress.note(
        f"{counted(int(np.count_nonzero(keepout)), 'cell')} shut, "
        f"{counted(int(np.count_nonzero(speed)), 'cell')} with a limit"
    )
    parameters = {
        **_servers("keepout", _KEEPOUT, 1.0),
        **_servers("speed", _ABSOLUTE_SPEED, multiplier),
    }
    files = {
        **_mask("keepout", keepout, grid),
        **_mask("speed", speed, grid),
        "nav2_params.yaml": yaml_text(parameters).encode(),
    }
    write_zip(target, files)


def _mask(name: str, values: NDArray[np.uint8], grid: GridMap) -> dict[str, bytes]:
    """Values (H, W), row 0 the lowest, as a picture of Netpbm, and the file that tells of it."""
    height, width = values.shape
    image = b"P5\n%d %d\n255\n" % (width, height) + values[::-1].tobytes()
    told = {
        "image": f"{name}.pgm",
        "mode": "raw",  # the grey of a pixel is the value of its cell
        "resolution": float(grid.resolution),
        "origin": [*map(float, grid.origin), 0.0],
        "negate": 0,
        "occupied_thresh": 1.0,
        "free_thresh": 0.0,
    }
    return {f"{name}.pgm": image, f"{name}.yaml": yaml_text(told).encode()}


def _servers(name: str, kind: int, multiplier: float) -> dict[str, object]:
    """The parameters of the two servers of a mask, under the names of Nav2's own launch files."""
    mask = f"{name}_filter_mask"
    of_mask = {"yaml_filename": f"{name}.yaml", "topic_name": mask}
    info = {
        "type": kind,
        "filter_info_topic": f"{name}_costmap_filter_info",
        "mask_topic": mask,
        "base": 0.0,
        "multiplier": multiplier,
    }
    return {
        f"{name}_filter_mask_server": {"ros__parameters": of_mask},
        f"{name}_costmap_filter_info_server": {"ros__parameters": info},
    }

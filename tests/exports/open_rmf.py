"""Readers of Open-RMF's two files that keep to its rules, in our words, and are as strict.

`generated` is what building_map_generator makes of a building (rmf_traffic_editor, level.py of
0074e3d, building.py of 0a84edd): it reads vertices, lanes and doors, and names a door on each lane
that meets its line. `graph_of` reads a nav graph as fleet adapters do (rmf_ros2, parse_graph.cpp of
02f9d6a): names are there once, lanes lead between vertices of their level.
"""

import math
import zipfile
from pathlib import Path
from typing import Any

import networkx as nx
import yaml

_TYPES = {1: str, 2: int, 3: float, 4: bool}


def parts(path: Path) -> tuple[Any, Any]:
    with zipfile.ZipFile(path) as archive:
        (building,) = (name for name in archive.namelist() if name.endswith(".building.yaml"))
        texts = (archive.read(name) for name in (building, "nav_graphs/0.yaml"))
        first, second = (yaml.safe_load(text) for text in texts)
    return first, second


def graph_of(found: Any) -> nx.DiGraph:
    """The waypoints and lanes of a nav graph; its lanes as long as they are straight."""
    assert isinstance(found["building_name"], str)
    assert isinstance(found["lifts"], dict), "without it the adapter warns"
    graph, names = nx.DiGraph(), set[str]()
    (level,) = found["levels"].values()
    for number, (x, y, options) in enumerate(level["vertices"]):
        assert not (options["name"] and options["name"] in names), "a name comes twice"
        names.add(options["name"])
        graph.add_node(number, at=(float(x), float(y)), **options)
    for start, end, options in level["lanes"]:
        assert start in graph
        assert end in graph
        assert options.keys() <= {"door_name", "speed_limit"}
        assert options.get("speed_limit", 1.0) > 0.0
        length = math.dist(graph.nodes[start]["at"], graph.nodes[end]["at"])
        graph.add_edge(start, end, length_m=length, **options)
    return graph


def generated(building: Any) -> Any:
    """The nav graph of a building in metres, whose vertices are in the order of its lanes."""
    assert building["coordinate_system"] == "cartesian_meters", "else y would point down"
    graph: dict[str, Any] = {"building_name": building["name"], "levels": {}, "lifts": {}}
    for name, level in building["levels"].items():
        rows: dict[int, int] = {}
        vertices, lanes = level["vertices"], []
        for start, end, typed in level["lanes"]:
            told = _values(typed)
            assert told["graph_idx"] == 0
            ends = [rows.setdefault(one, len(rows)) for one in (start, end)]
            options: dict[str, Any] = {}
            for a, b, door in level["doors"]:
                if _meet(*(vertices[row][:2] for row in (start, end, a, b))):
                    options["door_name"] = _values(door)["name"]
            if told["speed_limit"] > 0.0:
                options["speed_limit"] = told["speed_limit"]
            lanes += [[*ends, options]] + [[*ends[::-1], options]] * bool(told["bidirectional"])
        kept = [vertices[row] for row in rows]
        made = [[x, y, {"name": called, **_values(typed)}] for x, y, _, called, typed in kept]
        graph["levels"][name] = {"vertices": made, "lanes": lanes}
    return graph


def _values(typed: dict[str, list[Any]]) -> dict[str, Any]:
    """Parameters come as a number for their type and a value of it."""
    for kind, value in typed.values():
        assert type(value) is _TYPES[kind]
    return {key: value for key, (_, value) in typed.items()}


def _meet(a: Any, b: Any, c: Any, d: Any) -> bool:
    """Whether two lines meet; nearly parallel ones do not."""
    (x1, y1), (x2, y2), (x3, y3), (x4, y4) = a, b, c, d
    area = (x1 - x2) * (y3 - y4) - (y1 - y2) * (x3 - x4)
    if abs(area) < 0.01:
        return False
    along = ((x1 - x3) * (y3 - y4) - (y1 - y3) * (x3 - x4)) / area
    across = ((x1 - x3) * (y1 - y2) - (y1 - y3) * (x1 - x2)) / area
    return bool(0.0 <= along <= 1.0 and 0.0 <= across <= 1.0)

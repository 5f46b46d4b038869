"""Maps of schema 1 as maps of schema 2: what they lack is null or empty.

Documents come as they were read, before anything is checked: a part of another shape than expected
is left as it is, for the check of schema 2 to refuse.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from specmap_cli.maps.schema import SCHEMA_VERSION

MISSING = (
    "a map of an earlier version (schema 1): it keeps no keyframes, stays, kinds of submaps, doors "
    "or ways, and cannot be updated, merged or divided anew; build it again to have these"
)

_NODE: dict[str, Any] = {
    "kind": None,
    "properties": {},
    "anchor": None,
    "anchor_clearance_m": None,
}
_EDGE: dict[str, Any] = {
    "doors": [],
    "path": None,
    "length_m": None,
    "clearance_m": None,
    "forbidden": False,
}


def version_of(document: Any) -> Any:
    """The schema version that a document names, None where it names none."""
    graph = document.get("graph") if isinstance(document, dict) else None
    return graph.get("schema_version") if isinstance(graph, dict) else None


def upgraded(document: dict[str, Any]) -> dict[str, Any]:
    """A document of schema 1 as one of schema 2."""
    nodes = document.get("nodes")
    return {
        **document,
        "graph": _graph(document["graph"], nodes),
        "nodes": _each(nodes, lambda node: {**_NODE, **node}),
        "edges": _each(document.get("edges"), lambda edge: {**_EDGE, **edge}),
    }


def _graph(graph: dict[str, Any], nodes: Any) -> dict[str, Any]:
    kept = {key: value for key, value in graph.items() if key != "log"}
    return {
        "quality": None,  # the first maps were not judged
        **kept,
        "schema_version": SCHEMA_VERSION,
        "next_id": 1 + max(_ids(nodes), default=-1),
        "logs": _each([graph.get("log")], lambda log: {"keyframes": None, **log}),
        "stays": [],
        "breaks": [],
        "doors": [],
        "robot_radius_m": None,
        "edits": {"submaps": [], "borders": []},
        "closures": _each(
            graph.get("closures"),
            lambda closure: {"new_submap": None, "old_submap": None, **closure},
        ),
    }


def _ids(nodes: Any) -> list[int]:
    objects = [node for node in nodes if isinstance(node, dict)] if isinstance(nodes, list) else []
    return [node["id"] for node in objects if isinstance(node.get("id"), int)]


def _each(values: Any, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """A list with its objects changed."""
    if not isinstance(values, list):
        return values
    return [change(value) if isinstance(value, dict) else value for value in values]

"""topology.json read and checked: its values by the schema, and what refers to what in it.

A map of schema 1 is read as one of schema 2, and so is one of the first versions of schema 2, which
had no doors, ways or edits: what it lacks is null or empty. Its document is changed before anything
is checked: a part of another shape than expected is left as it is, for the check to refuse.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from specmap_cli.core.errors import MapError
from specmap_cli.core.json_values import Span
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import first_finding
from specmap_cli.maps.schema import SCHEMA_VERSION, TopologyRecord
from specmap_cli.maps.text_files import map_json
from specmap_cli.topology.topological_map import Split


def read_topology(path: Path, limits: LimitsConfig) -> tuple[TopologyRecord, str]:
    """The record in a topology.json, and what is to be said of it: what an old one lacks.

    Raises MapError when it cannot be read, is of an unknown version, or contradicts itself.
    """
    document = map_json(path, limits)
    graph = document.get("graph") if isinstance(document, dict) else None
    graph = graph if isinstance(graph, dict) else {}
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
            "stays": _with_origins(graph.get("stays", [])),
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


def _with_origins(stays: Any) -> Any:
    """Stays of versions that did not tell their frame: it was that of the first keyframe."""
    made = []
    for stay in stays if isinstance(stays, list) else ():
        match stay:
            case {"keyframes": [[first, _], *_]}:
                made.append({"origin": first, **stay})
            case _:
                made.append(stay)
    return made if isinstance(stays, list) else stays


def _each(values: Any, **lacking: Any) -> Any:
    """A list whose objects have what they were `lacking`."""
    if not isinstance(values, list):
        return values
    return [{**lacking, **value} if isinstance(value, dict) else value for value in values]

"""Whether a map can guide a robot: what is refused, and what its user must be told."""

from __future__ import annotations

from collections.abc import Sequence

from specmap_cli.core.errors import MapError
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import counted
from specmap_cli.exports.routes import is_way, parts
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.topology.topological_map import Edge

_MOST = 5  # submaps, links or parts that a message names


def check_routes(stored: StoredMap, progress: Progress) -> None:
    """Tell what would mislead a robot that follows the ways of a map.

    Raises MapError for a map without any way: nothing could be planned with it.
    """
    record = stored.record
    if not any(map(is_way, record.edges)):
        raise MapError(f"nothing to plan a route with: {_why_no_way(record)}", where=stored.path)
    for warning in _warnings(record):
        progress.warn(warning)
    for note in _left_out(record):
        progress.note(note)


def _why_no_way(record: TopologyRecord) -> str:
    """Why there is nothing to drive along, and what to do."""
    if record.graph.robot_radius_m is None:
        return "nobody looked for ways when it was made: build the map again"
    if len(record.nodes) < 2:
        return (
            "it has one submap: record a drive through more rooms, or cut it with "
            "`specmap edit --split`"
        )
    if any(edge.forbidden and edge.corners for edge in record.edges):
        return "those that there are were forbidden: allow one with `specmap edit`"
    radius = record.graph.robot_radius_m
    return (
        f"all are too narrow for a robot of {radius:g} m radius: build the map again with a "
        "smaller ways.robot_radius_m, if the robot is smaller"
    )


def _warnings(record: TopologyRecord) -> list[str]:
    """What is in the file, or missing in it, and would mislead."""
    found = []
    quality = record.graph.quality
    if quality is not None and quality.verdict != "good":
        found.append(
            f"the map is judged {quality.verdict}: a robot that follows its ways may meet walls"
        )
    unanchored = [node.id for node in record.nodes if node.anchor is None]
    if unanchored:
        found.append(f"no place to stand in {_submaps(unanchored)}: left out")
    apart = parts(record)
    if len(apart) > 1:
        groups = "; ".join(_few([str(id_) for id_ in part]) for part in apart[:_MOST])
        more = f"; and {len(apart) - _MOST} more" if len(apart) > _MOST else ""
        found.append(
            f"{len(apart)} parts that no way joins, no route leads from one to another: submaps "
            f"{groups}{more}"
        )
    loose = [edge for edge in record.edges if is_way(edge) and edge.kind == "loose"]
    if loose:
        found.append(
            f"{_links(loose)} joined by a guess only, where tracking was lost: check the map "
            "before a robot drives there"
        )
    return found


def _left_out(record: TopologyRecord) -> list[str]:
    """What the file has not, for good reasons."""
    forbidden = [edge for edge in record.edges if edge.forbidden]
    narrow = [edge for edge in record.edges if not edge.corners and not edge.forbidden]
    return [
        *([f"left out: {_links(forbidden)} forbidden"] if forbidden else []),
        *([f"left out: {_links(narrow)} without a way wide enough"] if narrow else []),
    ]


def _submaps(ids: Sequence[int]) -> str:
    """`submap 7`, `submaps 7, 9`, or the first few and how many more."""
    noun = "submap" if len(ids) == 1 else "submaps"
    return f"{noun} {_few([str(id_) for id_ in ids])}"


def _links(edges: Sequence[Edge]) -> str:
    """`1 link (3-4)`."""
    names = [f"{edge.source}-{edge.target}" for edge in edges]
    return f"{counted(len(edges), 'link')} ({_few(names)})"


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(names[:_MOST]) + more

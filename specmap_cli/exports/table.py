"""The table of export formats, which other packages extend, and those of general use.

An exporter is any object with a `description` and a method `write`. A package of its own offers one
by an entry point of the group `specmap.exporters`; the entry point's name is the format's::

    class Names:
        description = "the names of the submaps, a line each"

        def write(self, stored: Map, target: IO[bytes], progress: Progress) -> None:
            for node in stored.record.nodes:
                target.write(f"{node.name}\\n".encode())

An exporter may have an `ending`, such as `.zip`: a file of another ending is refused. What would
mislead a user of the file is told by `progress.warn`; a map that cannot be written in the format at
all is a MapError.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

import networkx as nx

from specmap_cli.core.errors import InputError, MapError, UsageError
from specmap_cli.core.files import complete_file, refuse_existing, write_zip
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.plugins import with_plugins
from specmap_cli.core.progress import Progress, Remembering, Silent
from specmap_cli.core.text import csv_text, plain, to_json
from specmap_cli.exports.fleet_formats import lif, rmf
from specmap_cli.exports.foxglove import foxglove
from specmap_cli.exports.rerun import rerun
from specmap_cli.exports.route_formats import nav2, nav2_masks, tmap2
from specmap_cli.layout.pose_graph import Link, graph_text, read_g2o
from specmap_cli.maps import filenames
from specmap_cli.maps.rooms import DOOR, LINK, SUBMAP, collection, features_of, fields_of, told_of
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.maps.text_files import map_text

GROUP = "specmap.exporters"


class Exporter(Protocol):
    """Writes a finished map in one format."""

    @property
    def description(self) -> str:
        """What the file is, and for whom."""

    def write(self, stored: Map, target: IO[bytes], progress: Progress, /) -> None:
        """Write the map to an open file. Raises MapError when it is damaged, or lacks too much."""


@dataclass(slots=True)
class _Format:
    """A format of ours: what writes it, whose docstring begins with the description of the format,
    and how its files must end, if that is fixed.
    """

    write: Callable[[Map, IO[bytes], Progress], None]
    ending: str | None = None

    @property
    def description(self) -> str:
        said = (self.write.__doc__ or "").split(".\n", 1)[0].removesuffix(".")
        return said.replace("A zip", "a zip", 1)


def exporters() -> dict[str, Exporter]:
    """Every exporter by the name of its format. Raises UsageError for a broken plug-in."""
    built_in: dict[str, Exporter] = {
        "csv": _Format(csv_tables, ".zip"),
        "foxglove": _Format(foxglove),
        "geojson": _Format(geojson),
        "graphml": _Format(graphml),
        "lif": _Format(lif),
        "nav2": _Format(nav2),
        "nav2-masks": _Format(nav2_masks, ".zip"),
        "pose-graph": _Format(pose_graph),
        "rerun": _Format(rerun),
        "rmf": _Format(rmf, ".zip"),
        "tmap2": _Format(tmap2),
    }
    offered = with_plugins(GROUP, built_in)
    return {name: each() if isinstance(each, type) else each for name, each in offered.items()}


def export_map(
    map_: Map | Path | str,
    name: str,
    out: Path | str,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[str]:
    """Write a map, or that of a directory, in the format `name` to the file `out`, or nothing.

    Returns the warnings. Raises UsageError for a format that nobody offers, and for a file that
    has a wrong ending, exists (unless `overwrite`) or cannot be written; MapError for a damaged
    map, and for one that lacks what the format cannot do without.
    """
    stored, target, known = opened_map(map_, "map_"), Path(out), exporters()
    if name not in known:
        raise UsageError(f"unknown format {name!r}", f"choose from {', '.join(sorted(known))}")
    ending = getattr(known[name], "ending", None) or target.suffix
    if target.suffix not in {"", ending}:
        raise UsageError(known[name].description, f"name it {target.stem}{ending}", where=target)
    if not overwrite:
        refuse_existing(target)
    heard = Remembering(Silent() if progress is None else progress)
    with complete_file(target) as file:
        known[name].write(stored, file, heard)
    return heard.warnings


def csv_tables(stored: Map, target: IO[bytes], _: Progress) -> None:
    """A zip of nodes.csv, edges.csv and doors.csv, for spreadsheets and pandas."""
    rooms = [told_of(room) for room in stored.rooms.values()]
    noted = sorted({key for room in rooms for key in room} - {"id", *SUBMAP})
    links = [
        {"source": edge.source, "target": edge.target, **fields_of(edge, LINK)}
        for edge in stored.record.edges
    ]
    doors = [
        {"id": door.id, "source": door.between[0], "target": door.between[1]}
        | {"x": door.x, "y": door.y, **fields_of(door, DOOR)}
        for door in stored.doors
    ]
    tables = {
        "nodes.csv": (["id", *SUBMAP, *noted], rooms),
        "edges.csv": (["source", "target", *LINK], links),
        "doors.csv": (["id", "source", "target", "x", "y", *DOOR], doors),
    }
    files = {}
    for name, (columns, found) in tables.items():  # RFC 4180
        rows = ([row.get(column) for column in columns] for row in map(plain, found))
        files[name] = csv_text(columns, rows, "\r\n").encode()
    write_zip(target, files)


def graphml(stored: Map, target: IO[bytes], _: Progress) -> None:
    """GraphML: the graph, for yEd, Gephi and networkx.

    Nodes are submaps with their place, area and visits; edges the links between them.
    """
    graph = stored.to_networkx()
    for told in [*graph.nodes.values(), *graph.edges.values()]:
        for key in [key for key, value in told.items() if value is None]:
            del told[key]
    nx.write_graphml_xml(graph, target, prettyprint=True)


def geojson(stored: Map, target: IO[bytes], _: Progress) -> None:
    """GeoJSON: outlines, doors and ways in metres of the map, for QGIS.

    A polygon for each submap that owns space, a line for each link and each door (RFC 7946).
    The line of a door leads from wall to wall. A point is an anchor: where a robot can stand.
    """
    target.write(to_json(collection(features_of(stored))).encode())


def pose_graph(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """g2o: the pose graph of the layout, for GTSAM and g2o.

    Vertices are keyframes, edges are motions, closures and nearby passes. The first vertex of
    each part that edges join is fixed, so that a solver has one answer. Maps of earlier
    versions are written in an order that GTSAM reads, too. Raises MapError for a map without a
    trajectory.
    """
    poses, links = _read(stored)
    graph = nx.Graph()
    graph.add_nodes_from(poses)
    graph.add_edges_from((link.source, link.target) for link in links)
    starts = sorted(min(part) for part in nx.connected_components(graph))
    if len(starts) > 1:
        progress.warn(
            f"the pose graph is in {len(starts)} parts that no edge joins: the first vertex of "
            "each is fixed"
        )
    target.write(graph_text(poses, links, starts).encode())


def _read(stored: Map) -> tuple[dict[int, FloatArray], list[Link]]:
    path = stored.path / filenames.POSE_GRAPH
    if not path.exists():
        raise MapError(
            f"has no {path.name}: `specmap segment` makes maps without",
            "a pose graph needs one that `specmap build` made of a recording",
            mark=";",
            where=stored.path,
        )
    try:
        poses, links = read_g2o(stored.checked(map_text(path, stored.limits), path.name))
    except InputError as error:
        raise MapError.damaged(error.found, path) from None
    strangers = {end for link in links for end in (link.source, link.target)} - poses.keys()
    if strangers:
        raise MapError.damaged(f"there is no vertex {min(strangers)}", path)
    if not poses:
        alone = stored.labels.poses
        if len(alone) != 1:
            again = "build the map again, without `--no-relax`"
            raise MapError("has no vertices", again, where=path)
        poses = {0: alone[0]}  # the robot never moved
    return poses, links

"""The pose graph of the layout in g2o's format: for g2o, GTSAM, SE-Sync and other solvers."""

from __future__ import annotations

from typing import IO

import networkx as nx

from specmap_cli.core.errors import InputError, MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.progress import Progress
from specmap_cli.layout.pose_graph import Link, graph_text, read_g2o
from specmap_cli.maps import filenames
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import map_text


class PoseGraph:
    """Vertices are keyframes, edges are motions, closures and nearby passes.

    The first vertex of each part that edges join is fixed, so that a solver has one answer. Maps of
    earlier versions are written in an order that GTSAM reads, too.
    """

    description = "g2o: the pose graph of the layout, for GTSAM and g2o"

    def write(self, stored: Map, target: IO[bytes], progress: Progress) -> None:
        """Write trajectory.g2o of a map. MapError for a map without a trajectory."""
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
        raise MapError(error.found, "build the map again", where=path) from None
    strangers = {end for link in links for end in (link.source, link.target)} - poses.keys()
    if strangers:
        raise MapError(f"there is no vertex {min(strangers)}", "build the map again", where=path)
    if not poses:
        raise MapError("has no vertices", "build the map again", where=path)
    return poses, links

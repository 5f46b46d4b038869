"""A map directory with other names, kinds, properties and forbidden links; its borders stay."""

from __future__ import annotations

import shutil
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from specmap_cli.core.errors import MapError, reason
from specmap_cli.core.findings import UNDOUBTED, Quality
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.overview import render_overview, render_segmentation
from specmap_cli.grids.gridmap import UNKNOWN, GridMap
from specmap_cli.grids.map_server import read_picture, write_png
from specmap_cli.maps import filenames
from specmap_cli.maps.schema import EditsRecord, TopologyRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.maps.tum import read_trajectory
from specmap_cli.quality.verdict import quality_of
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.shapes import kind_of
from specmap_cli.topology.topological_map import TopologicalMap, default_name

_REWRITTEN = (filenames.TOPOLOGY, filenames.OVERVIEW, filenames.EDITS)


def record_with(record: TopologyRecord, topology: TopologicalMap) -> TopologyRecord:
    """The contents of topology.json with the names and the like of an edited map."""
    nodes = []
    for node in record.nodes:
        submap = topology.submaps[node.id]
        shape = np.array(node.polygon, dtype=np.float64).reshape(-1, 2)
        said = {
            "name": submap.name or default_name(node.id),
            "kind": submap.kind or kind_of(shape),
            "properties": dict(submap.properties),
        }
        nodes.append(node.model_copy(update=said))
    edges = tuple(
        replace(edge, forbidden=topology.edges[edge.source, edge.target].forbidden)
        for edge in record.edges
    )
    shown = {
        "edits": EditsRecord(submaps=topology.said, borders=topology.borders),
        "next_id": topology.next_id,
        "doors": topology.doors,
    }
    graph = record.graph.model_copy(update=shown)
    return record.model_copy(update={"graph": graph, "nodes": tuple(nodes), "edges": edges})


def write_relabelled(
    directory: Path, stored: StoredMap, topology: TopologicalMap, edits: str
) -> None:
    """Write a map into an empty directory: as it is stored, but named as `topology` says."""
    record = record_with(stored.record, topology)
    carry_over(stored.path, directory, _REWRITTEN)
    (directory / filenames.TOPOLOGY).write_text(record.text(), encoding="utf-8")
    write_png(directory / filenames.OVERVIEW, _overview(stored, topology))
    if edits:
        (directory / filenames.EDITS).write_text(edits, encoding="utf-8")


def carry_over(source: Path, target: Path, without: Collection[str]) -> None:
    """Copy what a directory holds, but for some names. Raises MapError for what cannot be read."""
    try:
        for path in sorted(source.iterdir()):
            if path.name in without:
                continue
            if path.is_dir():
                shutil.copytree(path, target / path.name)
            elif path.is_file():
                shutil.copyfile(path, target / path.name)
    except OSError as error:
        raise MapError(f"{source}: cannot be copied: {reason(error)}") from None


def quality_of_stored(stored: StoredMap) -> Quality:
    """What was thought of a map when it was made."""
    quality = stored.record.graph.quality
    return UNDOUBTED if quality is None else quality_of(quality.findings)


def _overview(stored: StoredMap, topology: TopologicalMap) -> Image:
    """The picture of a map, of a recording or of a finished grid."""
    graph = stored.record.graph
    if not (stored.path / filenames.LABELS).exists():
        return render_segmentation(topology, _segmented(stored), graph.logs[0])
    trajectory = read_trajectory(stored.path / filenames.TRAJECTORY, stored.limits)
    return render_overview(
        topology, stored.regions, trajectory, stored.labels, graph.logs, quality_of_stored(stored)
    )


def _segmented(stored: StoredMap) -> Regions:
    """The regions of a finished grid, from labels.png and the grids of the submaps."""
    path = stored.path / filenames.LABELS_IMAGE
    owner = read_picture(path, stored.limits)[..., 0].astype(np.int64) - 1
    if not set(np.unique(owner).tolist()) <= {NOBODY, *stored.ids}:
        raise MapError(f"{path}: not the labels of {filenames.TOPOLOGY}: make the map again")
    cells, corner, resolution = np.full(owner.shape, UNKNOWN, dtype=np.uint8), (0.0, 0.0), 1.0
    for id_, grid in stored.grids.items():
        own = np.argwhere(owner == id_)
        if not len(own) or not grid.free.any():
            continue
        row, column = (own.min(axis=0) - np.argwhere(grid.free).min(axis=0)).tolist()
        window = cells[row : row + grid.cells.shape[0], column : column + grid.cells.shape[1]]
        if window.shape != grid.cells.shape:
            raise MapError(f"{path}: does not fit to the grid of submap {id_}: make the map again")
        np.copyto(window, grid.cells, where=grid.cells != UNKNOWN)
        resolution = grid.resolution
        x, y = grid.origin
        corner = (x - column * resolution, y - row * resolution)
    return Regions.of(GridMap(cells, resolution, corner), owner)

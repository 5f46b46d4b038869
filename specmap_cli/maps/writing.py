"""Writing a map directory: everything that `build` and `segment` leave behind.

Write into the directory that `OutputDirectory` hands out, so that the map appears complete or not
at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.files import sha256_of
from specmap_cli.core.findings import UNDOUBTED, Quality
from specmap_cli.core.records import Labels, Trajectory
from specmap_cli.core.text import to_json
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.map_server import write_grid, write_png
from specmap_cli.maps import filenames
from specmap_cli.maps.features_file import Arrays, write_features
from specmap_cli.maps.filenames import OF_LABELS, has_digest
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.text_files import labels_text, trajectory_text
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import LogInfo, TopologicalMap

PictureArray = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapResult:
    """Everything a map directory is written from.

    `labels` are all keyframes, row i being keyframe number i, and `logs` the recordings that they
    came from, in order; `classifiers` is JSON text; `run` the contents of run.json; `quality` what
    is thought of the map; `pose_graph` text in g2o's format;
    `overview` a BGR picture (H, W, 3); `edits` the text of edits.toml, empty for no such file;
    `features` what the classifiers learned from, as arrays by name, if they are kept.
    """

    topology: TopologicalMap
    regions: Regions
    trajectory: Trajectory
    labels: Labels
    classifiers: str
    logs: tuple[LogInfo, ...]
    run: Mapping[str, Any]
    pose_graph: str
    overview: PictureArray
    quality: Quality = UNDOUBTED
    frame: str = "map"
    edits: str = ""
    features: Arrays | None = None


def write_scans(directory: Path, keyframes: KeyframeStore, labels: Labels) -> None:
    """Write the scans of all keyframes of a map into its directory, unless they are there.

    A map without them cannot be made anew from its directory.
    """
    from specmap_cli.maps.keyframe_log import write_keyframes  # loads what writes recordings

    path = directory / filenames.KEYFRAMES
    if not path.exists():
        write_keyframes(path, keyframes, labels.poses)


def write_map(
    directory: str | Path, result: MapResult, scans: Callable[[], object] | None = None
) -> None:
    """Write all files of a map into an existing directory; scans and ways that are there stay.

    After a call of `scans` those of the keyframes are there, too: see `write_scans`.
    """
    directory = Path(directory)
    write_grid(directory / filenames.MAP_GRID, result.regions.grid)
    labels = (result.regions.owner + 1).astype(np.uint16)
    write_png(directory / filenames.LABELS_IMAGE, labels[::-1])
    write_png(directory / filenames.OVERVIEW, result.overview)
    for name, text in (
        (filenames.CLASSIFIERS, result.classifiers),
        (filenames.TRAJECTORY, trajectory_text(result.trajectory)),
        (filenames.POSE_GRAPH, result.pose_graph),
        (filenames.LABELS, labels_text(result.labels)),
    ):
        if not (directory / name).exists():
            (directory / name).write_text(text, encoding="utf-8")
    if result.features is not None:
        write_features(directory / filenames.FEATURES, result.features)
    if result.edits:
        (directory / filenames.EDITS).write_text(result.edits, encoding="utf-8")
    record = TopologyRecord.of(
        result.topology, result.regions, result.logs, result.frame, result.quality
    )
    if scans is not None:
        scans()
    files = _write_topology(directory, result.topology, record)
    run = {**result.run, OF_LABELS: files[filenames.LABELS]}
    (directory / filenames.RUN).write_text(to_json(run), encoding="utf-8")


def write_segmentation(
    directory: str | Path,
    topology: TopologicalMap,
    regions: Regions,
    log: LogInfo,
    overview: PictureArray,
    full: GridMap,
) -> None:
    """Write a finished map cut into submaps: topology.json, all grids and the two pictures.

    `regions` are those of the part that is known of the `full` input. labels.png has the input's
    size and orientation, 16 bit: 0 is unlabelled, otherwise submap id + 1.
    """
    directory = Path(directory)
    write_grid(directory / filenames.MAP_GRID, full)
    labels, (height, width) = np.zeros(full.cells.shape, dtype=np.uint16), regions.owner.shape
    row, column = full.cells_of(regions.grid.centres_of(np.zeros((1, 2))))[0].tolist()
    labels[row : row + height, column : column + width] = regions.owner + 1
    write_png(directory / filenames.LABELS_IMAGE, labels[::-1])
    write_png(directory / filenames.OVERVIEW, overview)
    _write_topology(directory, topology, TopologyRecord.of(topology, regions, (log,)))


def _write_topology(
    directory: Path, topology: TopologicalMap, record: TopologyRecord
) -> Mapping[str, str]:
    """Write the grid of each submap, then topology.json with the digests of all; returns these."""
    (directory / filenames.SUBMAPS).mkdir()
    for node in record.nodes:
        image = directory / node.image
        write_grid(image.with_suffix(""), topology.submaps[node.id].grid)
    names = (path.relative_to(directory).as_posix() for path in directory.rglob("*"))
    files = {name: sha256_of(directory / name) for name in sorted(filter(has_digest, names))}
    record = record.model_copy(update={"graph": record.graph.model_copy(update={"files": files})})
    (directory / filenames.TOPOLOGY).write_text(record.text(), encoding="utf-8")
    return files

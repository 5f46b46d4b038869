"""A map directory: everything `build` leaves behind, written at once and read back.

docs/output_format.md describes every file. Write into the directory that `OutputDirectory` hands
out, so that the map appears complete or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from specmap_cli.core.config import Config
from specmap_cli.core.errors import MapError
from specmap_cli.core.records import Labels, Trajectory
from specmap_cli.core.text import to_json
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid, write_grid, write_png
from specmap_cli.maps.conversion import from_record, image_stem, to_record
from specmap_cli.maps.schema import SCHEMA_VERSION, NodeRecord, TopologyRecord
from specmap_cli.maps.tables import labels_text, read_labels, trajectory_text
from specmap_cli.topology.regions import Regions, divide
from specmap_cli.topology.topological_map import LogInfo, TopologicalMap

TOPOLOGY = "topology.json"
CLASSIFIERS = "classifiers.json"
RUN = "run.json"
LABELS = "labels.csv"
TRAJECTORY = "trajectory.tum"
POSE_GRAPH = "trajectory.g2o"
OVERVIEW = "overview.png"
LABELS_IMAGE = "labels.png"

PictureArray = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class MapResult:
    """Everything a map directory is written from.

    `labels` are all keyframes, row i being keyframe number i; `classifiers` is JSON text; `run` the
    contents of run.json; `pose_graph` text in g2o's format; `overview` a BGR picture.
    """

    topology: TopologicalMap
    regions: Regions
    trajectory: Trajectory
    labels: Labels
    classifiers: str
    log: LogInfo
    run: Mapping[str, Any]
    pose_graph: str
    overview: PictureArray
    frame: str = "map"


def write_map(directory: Path, result: MapResult) -> None:
    """Write all files of a map into an existing, empty directory."""
    write_topology(directory, result.topology, result.regions, result.log, result.frame)
    write_grid(directory / "map", result.regions.grid)
    write_png(directory / OVERVIEW, result.overview)
    for name, text in (
        (CLASSIFIERS, result.classifiers),
        (TRAJECTORY, trajectory_text(result.trajectory)),
        (POSE_GRAPH, result.pose_graph),
        (LABELS, labels_text(result.labels)),
        (RUN, to_json(dict(result.run))),
    ):
        (directory / name).write_text(text, encoding="utf-8")


def write_segmentation(
    directory: Path,
    topology: TopologicalMap,
    regions: Regions,
    log: LogInfo,
    overview: PictureArray,
) -> None:
    """Write a finished map cut into submaps: topology.json, their grids, labels.png, overview.png.

    labels.png has the size and the orientation of the input, 16 bit: 0 is unlabelled, otherwise
    submap id + 1.
    """
    write_topology(directory, topology, regions, log)
    labels = (regions.owner + 1).astype(np.uint16)
    write_png(directory / LABELS_IMAGE, labels[::-1])
    write_png(directory / OVERVIEW, overview)


def write_topology(
    directory: Path,
    topology: TopologicalMap,
    regions: Regions,
    log: LogInfo,
    frame: str = "map",
) -> None:
    """Write topology.json and the grid of each submap."""
    text = to_json(to_record(topology, regions, log, frame).model_dump(by_alias=True))
    (directory / TOPOLOGY).write_text(text, encoding="utf-8")
    (directory / "submaps").mkdir()
    for id_, submap in topology.submaps.items():
        write_grid(directory / image_stem(id_), submap.grid)


class StoredMap:
    """A map directory: topology.json read and validated, the other files when asked for.

    Every property raises MapError when its file is missing or damaged.
    """

    def __init__(self, path: Path, record: TopologyRecord) -> None:
        self.path = path
        self.record = record
        self._grids: dict[int, GridMap] = {}

    @property
    def ids(self) -> list[int]:
        """Submap ids, ascending."""
        return sorted(node.id for node in self.record.nodes)

    def grid(self, submap: int) -> GridMap:
        """The grid of one submap, in its own frame."""
        if submap not in self._grids:
            node = next(node for node in self.record.nodes if node.id == submap)
            self._grids[submap] = self._read_grid(node)
        return self._grids[submap]

    @property
    def grids(self) -> Mapping[int, GridMap]:
        """The grids of all submaps in their own frames, each read when asked for."""
        return _Grids(self)

    @cached_property
    def map_grid(self) -> GridMap:
        """The grid of the whole map."""
        return read_grid(self.path / "map.yaml")

    @cached_property
    def topology(self) -> TopologicalMap:
        """The map with all its grids; keyframes are rows of `labels`."""
        return from_record(
            self.record,
            lambda node: self.grid(node.id),
            lambda id_: np.flatnonzero(self.labels.submaps == id_).tolist(),
        )

    @cached_property
    def regions(self) -> Regions:
        """The whole map divided among the submaps, as in overview.png."""
        return divide(self.map_grid, self.labels)

    @cached_property
    def labels(self) -> Labels:
        """The keyframes with their submaps."""
        return read_labels(self.path / LABELS)

    @cached_property
    def classifiers(self) -> str:
        """The text of classifiers.json."""
        if not (self.path / CLASSIFIERS).exists():
            raise MapError(
                f"{self.path}: has no {CLASSIFIERS}: `specmap segment` makes maps without; "
                "localising needs one that `specmap build` made of a recording"
            )
        return _read_text(self.path / CLASSIFIERS)

    @cached_property
    def run(self) -> dict[str, Any]:
        """The contents of run.json."""
        run = _read_json(self.path / RUN)
        if not isinstance(run, dict):
            raise MapError(f"{self.path / RUN}: not a JSON object: build the map again")
        return run

    @cached_property
    def config(self) -> Config:
        """The configuration the map was built with (`config` in run.json)."""
        try:
            return Config.model_validate(self.run.get("config"))
        except ValidationError as error:
            raise MapError(
                f"{self.path / RUN}: config: {_first(error)}: build the map again"
            ) from None

    def _read_grid(self, node: NodeRecord) -> GridMap:
        return read_grid((self.path / node.image).with_suffix(".yaml"))


class _Grids(Mapping[int, GridMap]):
    """The grids of a stored map by submap id."""

    def __init__(self, stored: StoredMap) -> None:
        self._stored = stored

    def __getitem__(self, submap: int) -> GridMap:
        return self._stored.grid(submap)

    def __iter__(self) -> Iterator[int]:
        return iter(self._stored.ids)

    def __len__(self) -> int:
        return len(self._stored.ids)


def read_map(path: Path) -> StoredMap:
    """Open a map directory. Raises MapError in one line when it is none, or damaged."""
    if not path.exists():
        raise MapError(f"{path}: no such map directory: make one with `specmap build`")
    if not path.is_dir():
        raise MapError(f"{path}: is a file: expected a directory written by `specmap build`")
    topology = path / TOPOLOGY
    if not topology.is_file():
        what = "is not a map" if any(path.iterdir()) else "is empty"
        raise MapError(
            f"{path}: {what}: no {TOPOLOGY} in it: expected a directory written by `specmap build`"
        )
    return StoredMap(path, _read_record(topology))


def _read_record(path: Path) -> TopologyRecord:
    document = _read_json(path)
    graph = document.get("graph") if isinstance(document, dict) else None
    version = graph.get("schema_version") if isinstance(graph, dict) else None
    if version != SCHEMA_VERSION:
        raise MapError(
            f"{path}: graph.schema_version is {version!r}: this version reads {SCHEMA_VERSION}: "
            "build the map again"
        )
    try:
        record = TopologyRecord.model_validate(document)
    except ValidationError as error:
        raise MapError(f"{path}: {_first(error)}: build the map again") from None
    _check_references(path, record)
    return record


def _check_references(path: Path, record: TopologyRecord) -> None:
    ids = {node.id for node in record.nodes}
    if len(ids) != len(record.nodes):
        raise MapError(f"{path}: nodes: an id occurs twice: build the map again")
    for number, edge in enumerate(record.edges):
        for end in (edge.source, edge.target):
            if end not in ids:
                raise MapError(
                    f"{path}: edges.{number}: submap {end} is not among the nodes: "
                    "build the map again"
                )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}: build the map again") from None
    except UnicodeDecodeError:
        raise MapError(f"{path}: not UTF-8 text: build the map again") from None


def _read_json(path: Path) -> Any:
    try:
        return json.loads(_read_text(path))
    except json.JSONDecodeError as error:
        raise MapError(
            f"{path}: damaged JSON at line {error.lineno}: {error.msg}: build the map again"
        ) from None
    except RecursionError:
        raise MapError(f"{path}: JSON nested too deeply: build the map again") from None


def _first(error: ValidationError) -> str:
    """The first finding of a validation, as `key: message`."""
    finding = error.errors()[0]
    key = ".".join(str(part) for part in finding["loc"])
    return f"{key}: {finding['msg']}" if key else str(finding["msg"])

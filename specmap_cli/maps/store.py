"""Reading a map directory: topology.json at once and validated, the other files when asked for.

Whatever is missing or damaged is a MapError of one line that names the file.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from specmap_cli.core.arguments import path_of
from specmap_cli.core.config import known_settings
from specmap_cli.core.errors import MAP_MISSING, TOO_LARGE, MapError
from specmap_cli.core.files import sha256_of
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, Labels
from specmap_cli.core.settings import Config, LimitsConfig
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.map_server import read_grid, read_picture
from specmap_cli.maps import filenames
from specmap_cli.maps.features_file import Arrays, read_features
from specmap_cli.maps.schema import NodeRecord, TopologyRecord
from specmap_cli.maps.text_files import first_finding, map_json, map_text, read_labels
from specmap_cli.maps.topology_file import read_topology
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions, divide
from specmap_cli.topology.topological_map import (
    LogInfo,
    Merge,
    TopologicalMap,
    default_name,
    fences_of,
)

Value = TypeVar("Value")

_FINEST_M, _COARSEST_M = 0.002, 10.0  # a cell of a map; matching scans in finer ones takes forever


def _of_one_map(read: Callable[[StoredMap], Value]) -> Callable[[StoredMap], Value]:
    """A reader of a file that says where what is wrong is only that the map was replaced."""

    @functools.wraps(read)
    def reader(stored: StoredMap) -> Value:
        try:
            return read(stored)
        except MapError:
            stored.refuse_changed()
            raise

    return reader


class StoredMap:
    """A map directory: `record` is its topology.json, the other files are read when asked for.

    `limits` bound the size of these files; `note` is what a user should know of the map, if any.
    Every property raises MapError when its file is missing or damaged.
    """

    def __init__(
        self,
        path: Path,
        record: TopologyRecord,
        limits: LimitsConfig | None = None,
        note: str = "",
    ) -> None:
        self.path = path
        self.record = record
        self.limits = LimitsConfig() if limits is None else limits
        self.note = note
        self.as_read = _stamp_of(path / filenames.TOPOLOGY)

    def refuse_changed(self) -> None:
        """Raise MapError when another run or a person has replaced the map since it was read."""
        if _stamp_of(self.path / filenames.TOPOLOGY) != self.as_read:
            raise MapError("was replaced meanwhile", "run the command again", where=self.path)

    def checked(self, value: Value, *names: str) -> Value:
        """What was read from files of those names: MapError when one is of another map."""
        for name in names:
            path, wanted = self.path / name, self.record.graph.files.get(name)
            try:
                belongs = wanted is None or sha256_of(path) == wanted
            except OSError:  # gone since it was read
                belongs = False
            if not belongs:
                self.refuse_changed()
                raise _foreign(path)
        return value

    @property
    def ids(self) -> list[int]:
        """Submap ids, ascending."""
        return sorted(node.id for node in self.record.nodes)

    @property
    def names(self) -> dict[int, str]:
        """The names that a person gave, by submap id."""
        named = {node.id: node.name for node in self.record.nodes}
        return {id_: name for id_, name in sorted(named.items()) if name != default_name(id_)}

    def grid(self, submap: int) -> GridMap:
        """The grid of one submap, in its own frame. Raises KeyError for an id that is none."""
        return self.grids[submap]

    @cached_property
    def grids(self) -> Mapping[int, GridMap]:
        """The grids of all submaps in their own frames, each read when asked for."""
        return _Grids(self)

    @cached_property
    @_of_one_map
    def map_grid(self) -> GridMap:
        """The grid of the whole map."""
        names = [f"{filenames.MAP_GRID}{end}" for end in (".yaml", ".png")]
        return self.checked(read_grid(self._of_recording(names[0]), limits=self.limits), *names)

    @cached_property
    @_of_one_map
    def topology(self) -> TopologicalMap:
        """The map with all its grids; keyframes are rows of `labels`."""
        graph = self.record.graph
        runs = [run for stay in graph.stays for run in stay.runs]
        merged = [run for one in graph.edits.borders if isinstance(one, Merge) for run in one.runs]
        lasts = [end for _, end in runs + merged] + [each.keyframe for each in graph.breaks]
        if lasts:  # of keyframes that there are, none of them in two stays
            known = len(self.labels.stamps_ns)
            if max(lasts) >= known or sum(end - start + 1 for start, end in runs) > known:
                raise MapError(
                    "graph.stays, breaks or edits do not fit to the "
                    f"{counted(known, 'keyframe')} of {filenames.LABELS}",
                    "build the map again",
                    where=self.path / filenames.TOPOLOGY,
                )
        return self.record.topology(
            lambda node: self.grids[node.id],
            lambda id_: np.flatnonzero(self.labels.submaps == id_).tolist(),
        )

    @cached_property
    @_of_one_map
    def division(self) -> tuple[GridMap, OwnerArray]:
        """A grid of the map, and (H, W) the submap of each of its free cells, or NOBODY."""
        of_grid = self.path / filenames.LABELS_IMAGE
        if not of_grid.exists():
            borders = self.record.graph.edits.borders
            divided = divide(self.map_grid, self.labels, fences_of(borders))
            return divided.grid, divided.owner
        if not (self.path / f"{filenames.MAP_GRID}.yaml").exists():
            return _composed(self)  # an earlier version divided it
        owner = read_picture(of_grid, self.limits)[..., 0].astype(np.int64) - 1
        known = set(np.unique(owner).tolist()) <= {NOBODY, *self.ids}
        if owner.shape != self.map_grid.cells.shape or not known:
            what = f"not the labels of {filenames.TOPOLOGY}"
            raise MapError(what, "make the map again", where=of_grid)
        self.checked(owner, of_grid.name)
        return self.map_grid, np.where(self.map_grid.free, owner, NOBODY)

    @cached_property
    def regions(self) -> Regions:
        """The free cells of the map divided among the submaps, as in overview.png."""
        return Regions.of(*self.division)

    @cached_property
    @_of_one_map
    def labels(self) -> Labels:
        """The keyframes with their submaps."""
        path = self._of_recording(filenames.LABELS)
        labels = read_labels(path, self.limits)
        strangers = set(labels.submaps.tolist()) - {NO_SUBMAP, *self.ids}
        if strangers:
            raise MapError(
                f"submap {min(strangers)} is not in {filenames.TOPOLOGY}",
                "build the map again",
                where=path,
            )
        return self.checked(labels, path.name)

    @_of_one_map
    def keyframes(self) -> KeyframeStore:
        """The scans of the keyframes and their poses as registered: close the store after use."""
        from specmap_cli.maps.keyframe_log import read_keyframes  # loads the readers of recordings

        path, stamps_ns = self.path / filenames.KEYFRAMES, self.labels.stamps_ns.tolist()
        if not path.exists():
            raise MapError(
                f"has no {path.name}",
                "only maps that this version of `specmap build` made of a recording keep their "
                "scans: build the map again",
                where=self.path,
            )
        store = read_keyframes(path, len(stamps_ns), self.limits)
        if list(store.stamps_ns) != stamps_ns:
            store.close()
            raise MapError(
                f"its {counted(len(store), 'scan')} are not the "
                f"{counted(len(stamps_ns), 'keyframe')} of {filenames.LABELS}",
                "build the map again",
                where=path,
            )
        try:
            return self.checked(store, path.name)
        except MapError:
            store.close()
            raise

    @cached_property
    @_of_one_map
    def classifiers(self) -> str:
        """The text of classifiers.json."""
        path = self._of_recording(filenames.CLASSIFIERS)
        return self.checked(map_text(path, self.limits), path.name)

    @property
    @_of_one_map
    def features(self) -> Arrays | None:
        """The features that the classifiers learned from; None where they were not kept."""
        path = self.path / filenames.FEATURES
        if not path.exists():
            return None
        found = read_features(path, len(self.labels.stamps_ns), self.limits)
        return self.checked(found, path.name)

    @cached_property
    @_of_one_map
    def run(self) -> dict[str, Any]:
        """The contents of run.json."""
        run = map_json(self._of_recording(filenames.RUN), self.limits)
        if not isinstance(run, dict):
            raise MapError(
                "not a JSON object", "build the map again", where=self.path / filenames.RUN
            )
        wanted = self.record.graph.files.get(filenames.LABELS)
        if wanted is not None and run.get(filenames.OF_LABELS, wanted) != wanted:
            raise _foreign(self.path / filenames.RUN)
        return run

    def _of_recording(self, name: str) -> Path:
        """The file of that name, which every map of a recording has; MapError where it is not."""
        path = self.path / name
        if not path.exists():
            raise MapError(
                f"has no {name}",
                "`specmap segment` makes maps without; here one is needed that `specmap build` "
                "made of a recording",
                where=self.path,
            )
        return path

    @property
    def counts(self) -> dict[str, int]:
        """What run.json says was counted; whatever is no whole number is left out."""
        counts = self.run.get("counts")
        found = counts.items() if isinstance(counts, dict) else ()
        return {name: count for name, count in found if type(count) is int}

    @property
    def logs(self) -> tuple[LogInfo, ...]:
        """The recordings that the map was made of, in the order of their keyframes."""
        return self.record.graph.logs

    @cached_property
    def config(self) -> Config:
        """The configuration the map was built with (`config` in run.json).

        Settings that this version does not have are left out: `foreign_settings` names them.
        """
        written = self.run.get("config")
        try:
            known = known_settings(written)[0] if isinstance(written, dict) else written
            return Config.model_validate(known)
        except ValidationError as error:
            raise MapError(
                f"config: {first_finding(error)}",
                "build the map again",
                where=self.path / filenames.RUN,
            ) from None

    @property
    def foreign_settings(self) -> list[str]:
        """The settings, by dotted key, that another version built the map with."""
        written = self.run.get("config")
        return known_settings(written)[1] if isinstance(written, dict) else []


def _stamp_of(path: Path) -> tuple[int, ...]:
    """What changes when a file is written anew; nothing where there is none."""
    try:
        about = path.stat()
    except OSError:
        return ()
    return about.st_ino, about.st_size, about.st_mtime_ns


def _foreign(path: Path) -> MapError:
    what = f"is not the file that {filenames.TOPOLOGY} was written with"
    return MapError(what, "put that one back, or build the map again", where=path)


def _composed(stored: StoredMap) -> tuple[GridMap, OwnerArray]:
    """The grids of all submaps laid out in the map, each the owner of what is free in it.

    Earlier versions kept no more of a grid that they divided. Raises MapError when the whole would
    be beyond all bounds.
    """
    pieces = [(node, stored.grid(node.id)) for node in stored.record.nodes]
    points = np.vstack(
        [np.zeros((0, 2)), *(_placed(node, grid, grid.cells != UNKNOWN) for node, grid in pieces)]
    )
    if not len(points):
        points = np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    cell_m = min((grid.resolution for _, grid in pieces), default=1.0)
    width, height = (int(side) + 2 for side in np.ceil((high - low) / cell_m))
    if width * height > stored.limits.picture_max_mpixel * 1e6:
        raise MapError(
            f"its submaps lie so far apart that a picture of them has {width:,} x {height:,} cells",
            "if it is meant, raise limits.picture_max_mpixel",
            mark=";",
            where=stored.path,
            code=TOO_LARGE,
        )
    left, bottom = (low - 0.5 * cell_m).tolist()
    unknown = np.full((height, width), UNKNOWN, dtype=np.uint8)
    whole = GridMap(unknown, cell_m, (left, bottom))
    owner = np.full(whole.cells.shape, NOBODY, dtype=np.int64)
    for value in (FREE, OCCUPIED):
        for node, grid in pieces:
            rows, columns = whole.cells_of(_placed(node, grid, grid.cells == value)).T
            whole.cells[rows, columns] = value
            owner[rows, columns] = node.id if value == FREE else NOBODY
    return whole, owner


def _placed(node: NodeRecord, grid: GridMap, cells: BoolArray) -> FloatArray:
    """(n, 2) centres in the map of some cells of a submap's grid."""
    return node.frame.apply(grid.centres_of(np.argwhere(cells)))


class _Grids(Mapping[int, GridMap]):
    """Grids by submap id, each read from its file when it is first asked for."""

    def __init__(self, stored: StoredMap) -> None:
        self._stored = stored
        self._images = {node.id: Path(node.image) for node in stored.record.nodes}
        self._read: dict[int, GridMap] = {}

    def __getitem__(self, submap: int) -> GridMap:
        if submap not in self._read:
            image, stored = self._images[submap], self._stored
            path = stored.path / image.with_suffix(".yaml")
            grid = read_grid(path, limits=stored.limits)
            if not _FINEST_M <= grid.resolution <= _COARSEST_M:
                raise MapError(
                    f"resolution is {grid.resolution:g}",
                    f"expected {_FINEST_M:g} to {_COARSEST_M:g} metres a cell: build the map again",
                    where=path,
                )
            names = (image.as_posix(), image.with_suffix(".yaml").as_posix())
            self._read[submap] = stored.checked(grid, *names)
        return self._read[submap]

    def __contains__(self, submap: object) -> bool:
        return submap in self._images

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(self._images))

    def __len__(self) -> int:
        return len(self._images)


def read_map(path: str | Path, limits: LimitsConfig | None = None) -> StoredMap:
    """Open a map directory whose files are within `limits`.

    Raises MapError in one line when it is none, or damaged.
    """
    path = path_of(path, "path")
    if not path.exists():
        raise MapError(
            "no such map directory", "make one with `specmap build`", where=path, code=MAP_MISSING
        )
    if not path.is_dir():
        raise MapError("is a file", "expected a directory written by `specmap build`", where=path)
    topology = path / filenames.TOPOLOGY
    if not topology.is_file():
        what = "is not a map" if any(path.iterdir()) else "is empty"
        raise MapError(
            f"{what}: no {topology.name} in it",
            "expected a directory written by `specmap build`",
            where=path,
        )
    limits, as_read = LimitsConfig() if limits is None else limits, _stamp_of(topology)
    record, note = read_topology(topology, limits)
    stored = StoredMap(path, record, limits, note)
    stored.as_read = as_read  # not what it may be by now
    return stored


def opened_map(
    given: StoredMap | Path | str, name: str, limits: LimitsConfig | None = None
) -> StoredMap:
    """A map that is read already, or the directory of one, which the caller's argument `name` has.

    Raises MapError as `read_map` does, TypeError for what is neither.
    """
    return given if isinstance(given, StoredMap) else read_map(path_of(given, name), limits)

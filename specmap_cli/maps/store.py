"""Reading a map directory: topology.json at once and validated, the other files when asked for.

Whatever is missing or damaged is a MapError of one line that names the file.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic import ValidationError

from specmap_cli.core.arrays import unchanging
from specmap_cli.core.config import known_settings
from specmap_cli.core.errors import MAP_MISSING, MapError, instance_of, path_of
from specmap_cli.core.files import sha256_of
from specmap_cli.core.findings import Quality, Verdict
from specmap_cli.core.json_values import part_of
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels, Trajectory
from specmap_cli.core.settings import Config, LimitsConfig
from specmap_cli.core.text import counted, first_finding
from specmap_cli.grids.gridmap import GridMap, slices_near
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.map_server import read_grid, read_picture
from specmap_cli.maps import filenames
from specmap_cli.maps.features_file import Arrays, read_features
from specmap_cli.maps.rooms import (
    Grids,
    Room,
    RoomOrPlace,
    Rooms,
    composed,
    geodataframe_of,
    graph_of,
)
from specmap_cli.maps.schema import TopologyRecord, read_topology
from specmap_cli.maps.text_files import map_json, map_text, read_labels, read_trajectory
from specmap_cli.topology.regions import NOBODY, OwnerArray, Regions, divide
from specmap_cli.topology.topological_map import (
    Door,
    LogInfo,
    Merge,
    TopologicalMap,
    driven_m,
    fences_of,
    starts_of,
)

if TYPE_CHECKING:
    import networkx as nx

    from specmap_cli.topology.navigation import Roads, Route

Value = TypeVar("Value")

_NOTHING = np.zeros(0, dtype=np.int64)
_PUT_BACK = "put that one back, or build the map again"
_BUILD_ONE = (
    "`specmap segment` makes maps without; here one is needed that `specmap build` made of a "
    "recording"
)
_NO_LABELS = Labels(stamps_ns=_NOTHING, poses=np.zeros((0, 3)), submaps=_NOTHING)


def _of_one_map(read: Callable[..., Value]) -> Callable[..., Value]:
    """A reader of a file that says where what is wrong is only that the map was replaced."""

    @wraps(read)
    def reader(stored: Map, *args: Any) -> Value:
        try:
            return read(stored, *args)
        except MapError:
            stored.refuse_changed()
            raise

    return reader


@dataclass(frozen=True, eq=False, repr=False)
class Map:
    """A map that a program can hold: nothing of it can be changed.

    `record` is its topology.json, the other files of its directory `path` are read when asked for.
    `limits` bound the size of these files; `note` is what a user should know of the map, if any.
    Lengths are metres, angles radians, stamps nanoseconds, places in the frame of the map. Every
    property raises MapError when its file is missing or damaged.
    """

    path: Path
    record: TopologyRecord
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    note: str = ""
    as_read: tuple[int, ...] | None = None  # what changes when another map takes its place

    def __repr__(self) -> str:
        return f"<Map {str(self.path)!r}: {counted(len(self.record.nodes), 'room')}>"

    def _repr_png_(self) -> bytes | None:
        """Its picture, for notebooks."""
        overview = self.path / filenames.OVERVIEW
        return overview.read_bytes() if overview.is_file() else None

    def _repr_html_(self) -> str:
        """The same with a table of its rooms."""
        table, picture = self.rooms._repr_html_(), self._repr_png_()
        if picture is None:
            return table
        return f'<img src="data:image/png;base64,{b64encode(picture).decode("ascii")}">{table}'

    @property
    def frame(self) -> str:
        """The name of the frame that all places are in."""
        return self.record.graph.frame

    @property
    def quality(self) -> Quality | None:
        """Verdict and findings; None where the map was not judged."""
        return self.record.graph.quality

    @property
    def verdict(self) -> Verdict | None:
        """In a word: good, doubtful or poor."""
        return None if self.quality is None else self.quality.verdict

    @property
    def driven_m(self) -> float:
        """Metres driven from keyframe to keyframe."""
        return driven_m(self.logs, self.keyframes)

    @property
    def duration_s(self) -> float:
        """Seconds from first keyframe to last, of each recording by itself."""
        return self.keyframes.duration_s(starts_of(self.logs))

    @property
    def doors(self) -> tuple[Door, ...]:
        """Every door between two rooms, by id."""
        return self.record.graph.doors

    @property
    def grid(self) -> GridMap:
        """The grid of the whole map."""
        return self.division[0]

    @cached_property
    def rooms(self) -> Rooms:
        """The rooms, by id or by name."""
        return Rooms(self.record.nodes, self.doors, self.grids)

    def room_at(self, x: float, y: float) -> Room | None:
        """The room that a place is in, or None. A robot beside a wall of a room is still in it."""
        place = np.array([self.rooms.place_of((x, y))])
        grid, owner = self.regions.grid, self.regions.owner
        rows, columns = slices_near(place, 1.0, grid.origin, grid.resolution, owner.shape)
        part = Regions(grid.window(rows, columns), owner[rows, columns], {})
        found = part.owners(place)[0] if part.owner.size else NOBODY
        return None if found == NOBODY else self.rooms[int(found)]

    def route(self, start: RoomOrPlace, goal: RoomOrPlace) -> Route:
        """How a robot gets from one room or place to another, through no forbidden door.

        Rooms are given by id or name, or as they are; places as x and y, or as a pose. To a room
        leads the way to its anchor. Where there is none, `route.why` says the reason. Raises
        KeyError for an unknown room.
        """
        return self._roads.route(self.rooms.place_of(start), self.rooms.place_of(goal))

    @cached_property
    def _roads(self) -> Roads:
        from specmap_cli.topology.navigation import Roads  # few ask for routes

        graph = self.record.graph
        return Roads(self.regions, graph.doors, self.record.edges, graph.robot_radius_m)

    def to_networkx(self) -> nx.Graph:
        """A graph: nodes are rooms by id, edges the links between them, both with their figures.

        A figure that is unknown is None, such as `length_m` of a link without a way, which
        shortest paths by that weight pass over. Those of a forbidden link are there: `forbidden`.
        """
        return graph_of(self)

    def to_geopandas(self) -> Any:
        """A GeoDataFrame in metres: `kind` is submap, anchor or door, or that of a link.

        Rows are the features of `specmap export --format geojson`. Raises UsageError where
        geopandas is not installed.
        """
        return geodataframe_of(self)

    @property
    def of_recording(self) -> bool:
        """Whether it was made of a recording; one of a finished grid has no keyframes."""
        return (
            filenames.LABELS in self.record.graph.files or (self.path / filenames.LABELS).exists()
        )

    @property
    def keyframes(self) -> Labels:
        """The keyframes with their rooms: arrays, or a loop; none of a finished grid."""
        return self.labels if self.of_recording else _NO_LABELS

    @cached_property
    @_of_one_map
    def trajectory(self) -> Trajectory:
        """The pose at every scan: arrays, or one at a time by a loop; empty as `keyframes`."""
        if not self.of_recording:
            return Trajectory(_NO_LABELS.stamps_ns, _NO_LABELS.poses)
        found = read_trajectory(self.path / filenames.TRAJECTORY, self.limits)
        unchanging(found.stamps_ns, found.poses)
        return self.checked(found, filenames.TRAJECTORY)

    def refuse_changed(self) -> None:
        """Raise MapError when another run or a person has replaced the map since it was read."""
        if self.as_read not in (None, _stamp_of(self.path / filenames.TOPOLOGY)):
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
        """The ids of the rooms, ascending."""
        return list(self.rooms)

    @property
    def names(self) -> dict[int, str]:
        """The names that a person gave, by submap id."""
        return {id_: one.given_name for id_, one in self.rooms.items() if one.given_name}

    @cached_property
    def grids(self) -> Mapping[int, GridMap]:
        """The grids of all submaps in their own frames, each read when asked for."""
        return Grids(self)

    @cached_property
    @_of_one_map
    def map_grid(self) -> GridMap:
        """The grid of the whole map."""
        names = [f"{filenames.MAP_GRID}{end}" for end in (".yaml", ".png")]
        grid = read_grid(self._of_recording(names[0]), limits=self.limits)
        unchanging(grid.cells)
        return self.checked(grid, *names)

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
                raise MapError.damaged(
                    "graph.stays, breaks or edits do not fit to the "
                    f"{counted(known, 'keyframe')} of {filenames.LABELS}",
                    self.path / filenames.TOPOLOGY,
                )
        return self.record.topology(
            lambda node: self.grids[node.id],
            lambda id_: np.flatnonzero(self.labels.submaps == id_).tolist(),
        )

    @cached_property
    @_of_one_map
    def division(self) -> tuple[GridMap, OwnerArray]:
        """A grid of the map, and (H, W) the submap of each of its free cells, or NOBODY."""
        grid, owner = self._divided()
        if self.ids and (owner == NOBODY).all():
            where = self.path / f"{filenames.MAP_GRID}.yaml"
            raise MapError.damaged("its thresholds leave no free cell in a submap", where)
        return grid, owner

    def _divided(self) -> tuple[GridMap, OwnerArray]:
        of_grid = self.path / filenames.LABELS_IMAGE
        if not of_grid.exists():
            divided = divide(self.map_grid, self.labels, fences_of(self.record.graph.edits.borders))
            return divided.grid, divided.owner
        yaml = f"{filenames.MAP_GRID}.yaml"
        if yaml not in self.record.graph.files and not (self.path / yaml).exists():
            return composed(self)  # an earlier version divided it
        owner = read_picture(of_grid, self.limits)[..., 0].astype(np.int32) - 1
        known = set(np.unique(owner).tolist()) <= {NOBODY, *self.ids}
        if owner.shape != self.map_grid.cells.shape or not known:
            what = f"not the labels of {filenames.TOPOLOGY}"
            raise MapError(what, "make the map again", where=of_grid)
        self.checked(owner, of_grid.name)
        return self.map_grid, np.where(self.map_grid.free, owner, NOBODY)

    @cached_property
    def regions(self) -> Regions:
        """The free cells of the map divided among the submaps, as in overview.png."""
        grid, owner = self.division
        unchanging(grid.cells, owner)
        return Regions.of(grid, owner)

    @cached_property
    @_of_one_map
    def labels(self) -> Labels:
        """The keyframes with their submaps."""
        path = self._of_recording(filenames.LABELS)
        labels = read_labels(path, self.limits)
        strangers = set(labels.submaps.tolist()) - {NO_SUBMAP, *self.ids}
        if strangers:
            raise MapError.damaged(f"submap {min(strangers)} is not in {filenames.TOPOLOGY}", path)
        unchanging(labels.stamps_ns, labels.poses, labels.submaps)
        return self.checked(labels, path.name)

    @_of_one_map
    def scans(self, numbers: IntArray | None = None) -> KeyframeStore:
        """The scans of all keyframes, or of some `numbers` (n,), in order: close it after use."""
        from specmap_cli.maps.keyframe_log import read_keyframes  # loads the readers of recordings

        stamps_ns, path = self.labels.stamps_ns, self._of_recording(filenames.KEYFRAMES)
        store = read_keyframes(path, len(stamps_ns), self.limits, numbers)
        try:
            some = slice(None) if numbers is None else numbers
            if not np.array_equal(store.stamps_ns, stamps_ns[some]):
                raise MapError.damaged(
                    f"its {counted(len(store), 'scan')} are not the "
                    f"{counted(len(stamps_ns), 'keyframe')} of {filenames.LABELS}",
                    path,
                )
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
            raise MapError.damaged("not a JSON object", self.path / filenames.RUN)
        wanted = self.record.graph.files.get(filenames.LABELS)
        if wanted is not None and run.get(filenames.OF_LABELS, wanted) != wanted:
            raise _foreign(self.path / filenames.RUN)
        return run

    def _of_recording(self, name: str) -> Path:
        """The file of that name, which every map of a recording has; MapError where it is not."""
        path = self.path / name
        if not path.exists():
            lost = name in self.record.graph.files or self.of_recording
            advice = _PUT_BACK if lost else _BUILD_ONE
            raise MapError(f"has no {name}", advice, where=self.path)
        return path

    @property
    def counts(self) -> dict[str, int]:
        """What run.json says was counted; whatever is no whole number is left out."""
        found = part_of(self.run, "counts").items()
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
        written, where = self.run.get("config"), self.path / filenames.RUN
        try:
            known = known_settings(written)[0] if isinstance(written, dict) else written
            return Config.model_validate(known)
        except ValidationError as error:
            raise MapError.damaged(f"config: {first_finding(error)}", where) from None

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
    return MapError(what, _PUT_BACK, where=path)


def read_map(directory: str | Path, limits: LimitsConfig | None = None) -> Map:
    """Open a map directory whose files are within `limits`.

    Raises MapError in one line when it is none, or damaged.
    """
    path = path_of(directory, "directory")
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
    unchanging(*(edge.path for edge in record.edges if edge.path is not None))
    return Map(path, record, limits, note, as_read)


def opened_map(given: Map | Path | str, name: str, config: Config | None = None) -> Map:
    """The argument `name`, a map or the directory of one, within limits; TypeError for others."""
    limits = None if config is None else instance_of(config, Config, "config").limits
    return given if isinstance(given, Map) else read_map(path_of(given, name), limits)

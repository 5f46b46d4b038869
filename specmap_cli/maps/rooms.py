"""The rooms of a map, by id or by name, their grids, and what a map tells of them as flat values.

A room is a submap, as it is in the finished map: in its frame, unless it says otherwise. Flat
values of rooms, doors and links are for graphs, tables and features. One that is unknown is None;
formats that know no such thing leave it out with `known`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from specmap_cli.core.arrays import unchanging
from specmap_cli.core.errors import TOO_LARGE, MapError
from specmap_cli.core.geometry import FloatArray, Pose2, product
from specmap_cli.core.json_values import Point, PropertyValue
from specmap_cli.core.plugins import extra
from specmap_cli.core.text import legible
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.topology.regions import NOBODY, OwnerArray
from specmap_cli.topology.topological_map import Door, Edge, SubmapKind, Visit, default_name

if TYPE_CHECKING:
    import networkx as nx

    from specmap_cli.maps.store import Map


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Room:
    """A room of a map; lengths are metres, places are in the frame of the map.

    `outline` (N, 2) is the border of its largest part, counter-clockwise, not closed; empty where
    it owns no cell. `centroid` is the free cell nearest to its middle, `anchor` a place in it where
    a robot can stand, so far from everything; each is None without a cell. `kind` is None where
    nobody said it and its shape does not. `scans` counts its keyframes, `visits` are when the robot
    was in it, and `doors` lead out of it. `map_from_room` is the pose of its frame.
    """

    id: int
    name: str
    kind: SubmapKind | None
    properties: Mapping[str, PropertyValue]
    area_m2: float
    outline: FloatArray = field(repr=False)
    centroid: Point | None
    anchor: Point | None
    anchor_clearance_m: float | None
    map_from_room: Pose2
    scans: int
    visits: tuple[Visit, ...] = field(repr=False)
    doors: tuple[Door, ...] = field(repr=False)
    grids: Mapping[int, GridMap] = field(repr=False)

    @property
    def centre(self) -> Point:
        """A place in it: its centroid, or the origin of its frame when it owns no cell."""
        return self.centroid or self.map_from_room[:2]

    @property
    def place(self) -> Point:
        """Where to point at it: its anchor, else its centre."""
        return self.anchor or self.centre

    @property
    def given_name(self) -> str:
        """The name that a person gave it; empty without one."""
        return "" if self.name == default_name(self.id) else self.name

    @property
    def grid(self) -> GridMap:
        """Its grid, in its own frame: `cells` (H, W) are 0 free, 1 occupied, 2 unknown.

        It shows all that was seen from the room. Raises MapError when its file is damaged.
        """
        return self.grids[self.id]

    @property
    def transform(self) -> FloatArray:
        """(3, 3): takes (column, row, 1) of a cell's lower left corner to (x, y, 1) in the map."""
        grid, x_y = self.grid, np.eye(3)
        x_y[:2, :2] *= grid.resolution
        x_y[:2, 2] = grid.origin
        motion = np.eye(3)
        motion[:2, :2], motion[:2, 2] = self.map_from_room.rotation(), self.map_from_room[:2]
        return product(motion, x_y)


# A room by its id or name; x and y, or a pose: numbers of an array as well.
RoomOrPlace = Room | int | np.integer | str | Sequence[float] | FloatArray


class Rooms(Mapping[int, Room]):
    """The rooms of a map in the order of their ids. `rooms[3]` or `rooms["kitchen"]` is one.

    Raises KeyError for what is neither the id nor the name of a room, or the name of several.
    """

    def __init__(
        self, nodes: tuple[NodeRecord, ...], doors: tuple[Door, ...], grids: Mapping[int, GridMap]
    ) -> None:
        outlines = {node.id: np.array(node.polygon).reshape(-1, 2) for node in nodes}
        unchanging(*outlines.values())
        self._rooms = {
            node.id: Room(
                **{name: getattr(node, name) for name in _SAME},
                properties=node.properties,
                outline=outlines[node.id],
                map_from_room=node.frame,
                doors=tuple(door for door in doors if node.id in door.between),
                grids=grids,
            )
            for node in sorted(nodes, key=lambda one: one.id)
        }

    def __getitem__(self, room: int | str) -> Room:
        if isinstance(room, str):
            found = [one for one in self._rooms.values() if one.name == room]
            if len(found) == 1:
                return found[0]
            if found:
                ids = ", ".join(str(one.id) for one in found)
                raise KeyError(f"several rooms are called {room!r}: take the id, one of {ids}")
        elif room in self._rooms:
            return self._rooms[room]
        there = ", ".join(f"{one.id} {one.name!r}" for one in self._rooms.values())
        raise KeyError(f"no room {room!r}; there are {there}")

    def place_of(self, given: RoomOrPlace) -> Point:
        """The place that is meant; ValueError for one that is nowhere, KeyError for no room."""
        if isinstance(given, np.integer):  # as in the arrays of a map
            given = int(given)
        room = self[given] if isinstance(given, int | str) else given
        if isinstance(room, Room):
            return room.place
        try:
            x, y = map(float, room[:2])
        except (TypeError, ValueError):
            x = y = math.nan
        if not math.isfinite(x + y):
            raise ValueError(f"expected a room, or x and y in metres, found {given!r:.60}")
        return x, y

    def __iter__(self) -> Iterator[int]:
        return iter(self._rooms)

    def _repr_html_(self) -> str:
        """A table, for notebooks."""
        from html import escape  # which nobody else needs

        rows = [("id", "name", "kind", "area, m²", "doors")]
        rows += [
            (f"{one.id}", one.name, one.kind or "", f"{one.area_m2:.1f}", f"{len(one.doors)}")
            for one in self.values()
        ]
        cells = ["".join(f"<td>{escape(legible(cell))}</td>" for cell in row) for row in rows]
        return f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"

    def __len__(self) -> int:
        return len(self._rooms)


_SAME = (
    *("id", "name", "kind", "area_m2", "centroid", "anchor", "anchor_clearance_m"),
    *("scans", "visits"),
)


class Grids(Mapping[int, GridMap]):
    """Grids by submap id, each read from its file when it is first asked for."""

    def __init__(self, stored: Map) -> None:
        self._stored = stored
        self._images = {node.id: Path(node.image) for node in stored.record.nodes}
        self._read: dict[int, GridMap] = {}

    def __getitem__(self, submap: int) -> GridMap:
        if submap not in self._read:
            image, stored = self._images[submap], self._stored
            about = image.with_suffix(".yaml")
            grid = read_grid(stored.path / about, limits=stored.limits)
            unchanging(grid.cells)
            self._read[submap] = stored.checked(grid, image.as_posix(), about.as_posix())
        return self._read[submap]

    def __contains__(self, submap: object) -> bool:
        return submap in self._images

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(self._images))

    def __len__(self) -> int:
        return len(self._images)


def composed(stored: Map) -> tuple[GridMap, OwnerArray]:
    """The grids of all submaps laid out in the map, each the owner of what is free in it.

    Earlier versions kept no more of a grid that they divided. Raises MapError when the whole would
    be beyond all bounds.
    """
    pieces = [(node, stored.grids[node.id]) for node in stored.record.nodes]
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


Fields = dict[str, Any]


def link_line(edge: Edge, rooms: Mapping[int, Room]) -> list[Point]:
    """The way of a link; without one straight from place to place over its crossing."""
    if edge.corners:
        return edge.corners
    start, end = (rooms[id_].place for id_ in (edge.source, edge.target))
    return [start, *([] if edge.x is None or edge.y is None else [(edge.x, edge.y)]), end]


def _same(*names: str) -> dict[str, Callable[[Any], Any]]:
    """Fields that are called as in topology.json."""
    return {name: attrgetter(name) for name in names}


# A submap without what a person noted (`properties`) and without its outline.
SUBMAP: Mapping[str, Callable[[Room], Any]] = {
    **_same("name", "kind"),
    "x": lambda room: room.centre[0],
    "y": lambda room: room.centre[1],
    "anchor_x": lambda room: None if room.anchor is None else room.anchor[0],
    "anchor_y": lambda room: None if room.anchor is None else room.anchor[1],
    **_same("anchor_clearance_m", "area_m2", "scans"),
    "visits": lambda room: len(room.visits),
}
# A link between two submaps; the ids of its doors are one text, as flat formats need it.
LINK: Mapping[str, Callable[[Edge], Any]] = {
    **_same("kind"),
    "passable": lambda edge: edge.path is not None,
    **_same("forbidden", "length_m", "clearance_m", "width_m"),
    "doors": lambda edge: " ".join(map(str, edge.doors)),
    **_same("distance_m"),
    "traversals": lambda edge: len(edge.traversals),
    **_same("x", "y"),
}
# A door between two submaps.
DOOR: Mapping[str, Callable[[Door], Any]] = {
    **_same("width_m", "theta", "driven"),
    "crossings": lambda door: len(door.crossings),
    **_same("forbidden"),
}


def noted_fields(room: Room) -> Fields:
    """What a person noted of a submap, under `property.`: flat formats hold single values."""
    return {f"property.{key}": value for key, value in room.properties.items()}


def told_of(room: Room) -> Fields:
    """What a viewer tells of a submap."""
    return {"id": room.id, **fields_of(room, SUBMAP), **noted_fields(room)}


def fields_of(record: Any, wanted: Mapping[str, Callable[[Any], Any]]) -> Fields:
    """The fields of a submap, a link or a door: `wanted` is SUBMAP, LINK or DOOR."""
    return {name: of(record) for name, of in wanted.items()}


def known(fields: Mapping[str, Any]) -> Fields:
    """The fields that have a value."""
    return {key: value for key, value in fields.items() if value is not None}


def feature(kind: str, coordinates: Sequence[Any], properties: Fields) -> Fields:
    """One feature."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def collection(features: Iterable[Fields]) -> Fields:
    """Features in metres. Without the key `crs` tools take the numbers for degrees (RFC 7946)."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}
    numbered = [{**each, "id": number} for number, each in enumerate(features)]
    return {"type": "FeatureCollection", "crs": crs, "features": numbered}


def graph_of(map_: Map) -> nx.Graph:
    """The rooms by their ids, and the links between them, each with its figures."""
    import networkx as nx  # slow to load: few ask for it

    graph = nx.Graph(frame=map_.record.graph.frame)
    for room in map_.rooms.values():
        graph.add_node(room.id, **noted_fields(room), **fields_of(room, SUBMAP))
    for edge in map_.record.edges:
        graph.add_edge(edge.source, edge.target, **fields_of(edge, LINK))
    return graph


def features_of(map_: Map) -> Iterator[Fields]:
    """GeoJSON features: outlines of rooms, their anchors, doors from wall to wall, and links."""
    told: Fields
    for room in map_.rooms.values():
        if len(room.outline):
            ring = room.outline[[*range(len(room.outline)), 0]].tolist()
            kinds = {"kind": "submap", "submap_kind": room.kind}
            own = {"id": room.id, "properties": dict(room.properties)}
            yield feature("Polygon", [ring], fields_of(room, SUBMAP) | kinds | own)
    for room in map_.rooms.values():
        if room.anchor:
            told = {"kind": "anchor", "submap": room.id, "clearance_m": room.anchor_clearance_m}
            yield feature("Point", list(room.anchor), told)
    for door in map_.doors:
        sides = [[round(value, 6) for value in side] for side in door.sides]
        told = {"kind": "door", "id": door.id, "between": list(door.between)}
        yield feature("LineString", sides, fields_of(door, DOOR) | told)
    for edge in map_.record.edges:
        told = {"source": edge.source, "target": edge.target, "doors": edge.doors}
        line = link_line(edge, map_.rooms)
        yield feature("LineString", line, fields_of(edge, LINK) | told)


def geodataframe_of(map_: Map) -> Any:
    """The features as a table of geopandas; UsageError where it is not installed."""
    needed = "to_geopandas needs geopandas, which is not installed"
    geopandas = extra("geopandas", "geopandas", needed)
    return geopandas.GeoDataFrame.from_features(list(features_of(map_)))

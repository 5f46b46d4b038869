"""Pictures of maps: the overview of a build, predicted submaps, the regions of a finished map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from specmap_cli.core.findings import UNDOUBTED, Quality
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import Labels, Trajectory
from specmap_cli.core.text import counted, legible
from specmap_cli.drawing import symbols
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.palette import Colour, colours_of
from specmap_cli.drawing.sheet import Sheet, extent_of, strokes
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import Edge, LogInfo, TopologicalMap, driven_m

_STRAY_M = 2.0  # a centroid farther from the robot's way lies behind glass, not in the room
_BESIDE_M = 0.3  # of paper on the other side of a way that leads out of the grid
_ROUNDS = 100  # of moving badges apart; a dense map settles within a dozen


def render_overview(
    topology: TopologicalMap,
    regions: Regions,
    trajectory: Trajectory,
    labels: Labels,
    logs: Sequence[LogInfo],
    quality: Quality = UNDOUBTED,
    frame: str = "map",
) -> Image:
    """The map of a build: regions, walls, trajectory, and the graph over them; BGR (H, W, 3).

    Where it may be wrong, a mark says so, and the title what it is. In the margin stand the days of
    the recordings (UTC), the frame of the map, and what is thought of it.
    """
    fills = colours_of(topology, regions)
    places = trajectory.poses[:, :2]
    low, high = extent_of(regions, places, _BESIDE_M)
    warnings = [finding.place for finding in quality.worst if finding.place is not None]
    shown = _shown(topology, regions) | {"trajectory", "start", "end"}
    shown |= {symbols.DOOR_WORDS[door.driven] for door in topology.doors}
    shown |= {"the map may be wrong here"} if warnings else set()
    sheet = Sheet(low, high, symbols.legend_of(shown))
    sheet.ground(regions, fills)
    for stroke in strokes(places):  # broken where the robot was lost and turned up elsewhere
        way = sheet.pixels(places[stroke.first : stroke.drawn_to])
        sheet.canvas.line(way, symbols.PATH, 1)
    nodes = _nodes(topology, regions)
    for id_, node in nodes.items():
        # what a laser sees through a glass wall draws a centroid out of the building: onto the way
        own = labels.poses[labels.submaps == id_, :2]
        away = np.linalg.norm(own - node, axis=1)
        if len(own) and away.min() > _STRAY_M:
            nodes[id_] = np.asarray(own[np.argmin(away)])
    ends = sheet.pixels(places[[0, -1]] if len(places) else places)
    doubts = sheet.pixels(np.array(warnings).reshape(-1, 2))
    _draw_graph(sheet, topology, nodes, fills, np.concatenate([ends, doubts]))
    for place, mark in zip(ends, (symbols.start, symbols.end), strict=False):
        mark(sheet.canvas, place)
    for place in doubts:
        symbols.warning(sheet.canvas, place)
    scans = sum(log.scans for log in logs)
    way_m = driven_m(logs, labels)
    width, height = high - low
    size = f"{width:.1f} x {height:.1f} m"
    figures = [counted(scans, "scan"), f"{way_m:,.0f} m driven", size]
    doubtful = [f"{quality.verdict}: {quality.worst[0].message}"] if quality.worst else []
    sheet.title(_headline(logs, topology), ",  ".join([*figures, *doubtful]))
    sheet.margin(",  ".join([*_dates(logs), f"frame {frame}", f"quality: {quality.verdict}"]))
    return sheet.canvas.image


def render_segmentation(
    topology: TopologicalMap, regions: Regions, log: LogInfo, frame: str = "map"
) -> Image:
    """A finished map cut into regions, with their ids and the doorways between them."""
    fills = colours_of(topology, regions)
    low, high = extent_of(regions)
    shown = _shown(topology, regions) | ({symbols.DOOR_WORDS[True]} if topology.doors else set())
    sheet = Sheet(low, high, symbols.legend_of(shown))
    sheet.ground(regions, fills)
    _draw_graph(sheet, topology, _nodes(topology, regions), fills)
    width, height = high - low
    size = f"{width:.1f} x {height:.1f} m"
    seen = f", {regions.seen_m2:,.0f} m2 only seen" if regions.seen else ""
    area = f"{regions.area_m2:,.0f} m2 in submaps{seen}"
    sheet.title(_headline([log], topology), f"{area},  {size}")
    sheet.margin(",  ".join([*_dates([log]), f"frame {frame}"]))
    return sheet.canvas.image


def _shown(topology: TopologicalMap, regions: Regions) -> set[str]:
    """What every picture of a map shows, in the words of its legend; doors aside."""
    links = {symbols.LINK_WORDS[drawn_as(topology, edge)] for edge in topology.edges.values()}
    forbidden = any(edge.forbidden for edge in topology.edges.values())
    forbidden |= any(door.forbidden for door in topology.doors)
    shown = {"submap", "wall"} | links | ({"forbidden"} if forbidden else set())
    return shown | ({"only seen"} if regions.seen else set())


def _nodes(topology: TopologicalMap, regions: Regions) -> dict[int, FloatArray]:
    """The places of the submaps' badges: their anchors, else their centroids or their frames."""
    nodes = {}
    for id_, submap in topology.submaps.items():
        centroid = regions.outline(id_).centroid
        place = submap.map_from_submap[:2] if centroid is None else centroid
        nodes[id_] = np.array(place if submap.anchor is None else submap.anchor)
    return nodes


def _draw_graph(
    sheet: Sheet,
    topology: TopologicalMap,
    nodes: Mapping[int, FloatArray],
    fills: Mapping[int, Colour],
    marks: FloatArray | None = None,
) -> None:
    """Doors, links along their ways or through their crossings, then a badge on each submap.

    Badges keep clear of `marks` (N, 2), pixels at which something else will be drawn.
    """
    if not nodes:
        return
    driven = any(door.driven for door in topology.doors)  # nobody drove through a finished map
    ids = sorted(nodes)
    centres = sheet.pixels(np.array([nodes[id_] for id_ in ids]))
    centres = spread(centres, symbols.BADGE_GAP, marks)
    at = dict(zip(ids, centres, strict=True))
    for door in topology.doors:  # below the links, which lead through them, and the ids
        symbols.door(sheet.canvas, sheet.pixels(np.array(door.sides)), door.driven or not driven)
    for pair in sorted(topology.edges):
        edge = topology.edges[pair]
        crossing = [] if edge.crossing is None else [edge.crossing]
        between = sheet.pixels(
            np.array(crossing if edge.path is None else edge.path).reshape(-1, 2)
        )
        points = np.array([at[edge.source], *between, at[edge.target]])
        symbols.edge(sheet.canvas, points, drawn_as(topology, edge))
    shut = {door.between for door in topology.doors if door.forbidden}
    places = np.array([(door.x, door.y) for door in topology.doors if door.forbidden])
    forbidden = [*sheet.pixels(places.reshape(-1, 2))]  # doors, and links without one
    for pair, edge in sorted(topology.edges.items()):
        if edge.forbidden and pair not in shut and edge.crossing is not None:
            forbidden.append(sheet.pixels(np.array([edge.crossing]))[0])
        elif edge.forbidden and pair not in shut:
            forbidden.append((at[edge.source] + at[edge.target]) / 2.0)
    for place in forbidden:
        symbols.no_entry(sheet.canvas, place)
    for id_ in ids:
        symbols.badge(sheet.canvas, at[id_], str(id_), fills[id_])
    for id_ in ids:
        symbols.name_under(sheet.canvas, at[id_], legible(topology.submaps[id_].given_name))


def drawn_as(topology: TopologicalMap, edge: Edge) -> symbols.LinkKind:
    """The kind of an edge, or `narrow` where a way was looked for and none is wide enough."""
    looked_for = topology.robot_radius_m is not None and edge.kind in (
        "traversed",
        "seen",
        "doorway",
    )
    return "narrow" if looked_for and edge.path is None else edge.kind


def spread(centres: FloatArray, gap: float, fixed: FloatArray | None = None) -> FloatArray:
    """`centres` (N, 2) moved apart, as little as it takes, until none are nearer than `gap`.

    Nor are they nearer to what is `fixed` (M, 2).
    """
    count = len(centres)
    moved = np.concatenate([centres, np.zeros((0, 2)) if fixed is None else fixed])
    for _ in range(_ROUNDS):
        apart = moved[:, None] - moved[None]
        distance = np.linalg.norm(apart, axis=-1)
        np.fill_diagonal(distance, np.inf)
        distance[count:, count:] = np.inf
        close = np.argwhere(np.triu(distance < gap - 1e-6))
        if not len(close):
            break
        for i, j in close:
            way = moved[i] - moved[j]
            length = float(np.linalg.norm(way))
            step = way / length if length > 1e-9 else np.array([0.0, 1.0])
            push = max(0.0, gap - length) * step
            share = 1.0 if j >= count else 0.5
            moved[i] += share * push
            moved[j] -= (1.0 - share) * push
    return moved[:count]


_A_YEAR_NS = 365 * 24 * 3600 * 10**9  # stamps before it were counted from a start, not a date


def _dates(logs: Sequence[LogInfo]) -> list[str]:
    """The days (UTC) from the first recording to the last; none without a clock."""
    stamps = [stamp for log in logs for stamp in (log.start_ns, log.end_ns) if stamp is not None]
    if min(stamps, default=0) < _A_YEAR_NS:
        return []
    days = [
        datetime.fromtimestamp(stamp / 1e9, UTC).date().isoformat()
        for stamp in (min(stamps), max(stamps))
    ]
    return [" to ".join(dict.fromkeys(days))]


def _headline(logs: Sequence[LogInfo], topology: TopologicalMap) -> str:
    counts = [counted(len(topology.submaps), "submap"), counted(len(topology.edges), "link")]
    merged = sum(closure.merged for closure in topology.closures)
    if merged:
        counts.append(counted(merged, "revisit") + " recognised")
    more = f" and {counted(len(logs) - 1, 'more log')}" if len(logs) > 1 else ""
    return f"{logs[0].name}{more}:  {', '.join(counts)}"

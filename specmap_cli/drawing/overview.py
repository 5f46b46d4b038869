"""Pictures of maps: the overview of a build, predicted submaps, the regions of a finished map."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.findings import UNDOUBTED, Quality
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels, Trajectory
from specmap_cli.core.text import counted, legible
from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.canvas import Canvas, Image, text_width
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
    fills = palette.colours_of(topology, regions)
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
    fills = palette.colours_of(topology, regions)
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
    fills: Mapping[int, palette.Colour],
    marks: FloatArray | None = None,
) -> None:
    """Doors, links, then a badge on each submap, clear of `marks` (N, 2), which are drawn later."""
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
    """The kind of an edge, or `narrow` where a way was looked for, and none is wide or allowed."""
    looked_for = topology.robot_radius_m is not None and edge.kind in (
        "traversed",
        "seen",
        "doorway",
    )
    return "narrow" if looked_for and (edge.path is None or edge.forbidden) else edge.kind


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


_BORDER_M = 1.0  # of paper round the trajectory
_CLEAR_OF_BADGES = 3.0 * symbols.BADGE_RADIUS  # of an id on the ground
_SAME_ID_GAP = 5.0  # badges of one submap are this many times farther apart than others

# Pixels, chosen by eye for a page as wide as a screen.
_SIDE = 1400  # of all cells of the longer side together, while they are of a size to be seen
_SMALLEST_CELL, _LARGEST_CELL = 14, 72
_SMALLEST_LETTERS, _LARGEST_LETTERS = 8.0, 15.0
_FIGURES_FROM = 26  # a smaller cell has no room for its percent
_MARGIN, _TITLE, _GAP, _COUNTS, _NARROWEST = 48, 96, 12, 110, 700
_MISTAKES: palette.Colour = (40, 24, 200)
_PALEST = 0.12  # weight of the hue in the cell of a single scan: it must be seen
_DARK = 0.45  # share from which letters are white


def render_labels(
    places: FloatArray,
    submaps: IntArray,
    title: str,
    *,
    fills: Mapping[int, palette.Colour] | None = None,
    map_with_regions: tuple[TopologicalMap, Regions] | None = None,
    truth: IntArray | None = None,
) -> Image:
    """The trajectory `places` (n, 2) in the colours of the predicted `submaps` (n,).

    NO_SUBMAP is unknown. With a map, `places` are in its frame and lie over its regions, in the
    colours of its overview. Without one they may be in any frame; `fills` are then the colours, by
    `colours_of` a map, else such that differ along the trajectory. `truth` (n,) marks the scans
    that were told another submap. Scans without a place (NaN) are left out.
    """
    known = np.isfinite(places[:, :2]).all(axis=1)
    places, submaps = np.asarray(places)[known, :2], np.asarray(submaps)[known]
    if fills is None and map_with_regions is not None:
        fills = palette.colours_of(*map_with_regions)
    elif fills is None:  # such that differ along the trajectory
        ids = [int(id_) for id_ in np.unique(submaps) if id_ != NO_SUBMAP]
        fills = palette.colour_graph(ids, set(itertools.pairwise(submaps.tolist())))
    shown = {"predicted submap, with its id", "start", "end"}
    shown |= {"wall"} if map_with_regions is not None else set()
    shown |= {"unknown"} if (submaps == NO_SUBMAP).any() else set()
    shown |= {"wrong"} if truth is not None else set()
    regions = None if map_with_regions is None else map_with_regions[1]
    sheet = Sheet(*extent_of(regions, places, _BORDER_M), symbols.legend_of(shown))
    if map_with_regions is not None:
        sheet.ground(map_with_regions[1], fills)
    if truth is not None:
        wrong = (submaps != np.asarray(truth)[known]) & (submaps != NO_SUBMAP)
        for stroke in strokes(places, wrong):
            if wrong[stroke.first]:
                way = sheet.pixels(places[stroke.first : stroke.drawn_to])
                sheet.canvas.line(way, palette.WRONG, symbols.MISTAKEN)
    badges = _draw_predicted(sheet, places, submaps, fills)
    if map_with_regions is not None:
        topology, ground = map_with_regions
        for id_, submap in sorted(topology.submaps.items()):
            centroid = ground.outline(id_).centroid
            if centroid is not None:
                place = sheet.pixels(centroid[None])[0]
                if (np.linalg.norm(badges - place, axis=1) > _CLEAR_OF_BADGES).all():
                    symbols.ground_id(sheet.canvas, place, id_)
                symbols.name_under(sheet.canvas, place, legible(submap.given_name))
    sheet.title(title, "")
    return sheet.canvas.image


def _draw_predicted(
    sheet: Sheet, places: FloatArray, submaps: IntArray, fills: Mapping[int, palette.Colour]
) -> FloatArray:
    """Runs of one prediction in its colour, badges where there is room: their pixels (N, 2)."""
    pixels = sheet.pixels(places)
    drawn = strokes(places, submaps)
    told = [stroke for stroke in drawn if submaps[stroke.first] != NO_SUBMAP]
    for stroke in told:
        sheet.canvas.line(pixels[stroke.first : stroke.drawn_to], palette.PAPER, symbols.RIM)
    for stroke in told:
        way = pixels[stroke.first : stroke.drawn_to]
        sheet.canvas.line(way, palette.vivid(fills[int(submaps[stroke.first])]), symbols.PREDICTED)
    for pixel in pixels[submaps == NO_SUBMAP]:
        symbols.unknown(sheet.canvas, pixel)
    taken: list[tuple[int, FloatArray]] = []
    for stroke in sorted(drawn, key=lambda stroke: stroke.first - stroke.end):  # longest first
        id_, middle = int(submaps[stroke.first]), pixels[(stroke.first + stroke.end) // 2]
        # clear of all others, and well away from one of the same id
        if id_ != NO_SUBMAP and all(
            np.linalg.norm(middle - other)
            > symbols.BADGE_GAP * (_SAME_ID_GAP if id_ == other_id else 1.0)
            for other_id, other in taken
        ):
            symbols.badge(sheet.canvas, middle, str(id_), fills[id_])
            taken.append((id_, middle))
    if len(pixels):
        symbols.end(sheet.canvas, pixels[-1])
        symbols.start(sheet.canvas, pixels[0])
    return np.array([middle for _, middle in taken]).reshape(-1, 2)


def render_confusion(matrix: NDArray[Any], names: Sequence[str], columns: Sequence[str]) -> Image:
    """Counts `matrix` (k, m), a row per true submap, a column per prediction; BGR (H, W, 3).

    Each cell shows its share of the row in percent: blue where right, red where wrong. `names` are
    those of the rows, `columns` those of the columns, which may have more (such as "unknown").
    """
    counts = np.asarray(matrix, dtype=np.float64)
    if counts.shape != (len(names), len(columns)):
        raise ValueError(f"matrix {counts.shape} for {len(names)} rows, {len(columns)} columns")
    # the largest cells that fit, to the right of and below the names
    side = _SIDE / max(1, *counts.shape)
    cell = int(np.clip(side, _SMALLEST_CELL, _LARGEST_CELL))
    letters = float(np.clip(cell * 0.3, _SMALLEST_LETTERS, _LARGEST_LETTERS))
    left = _MARGIN + 40 + max([text_width(name, letters) for name in names], default=0)
    top = _TITLE + 40 + max([text_width(name, letters) for name in columns], default=0)
    right = left + cell * len(columns)
    width = max(right + _COUNTS + _MARGIN, _NARROWEST)
    canvas = Canvas(width, top + cell * len(names) + _MARGIN)
    canvas.text(_MARGIN, 46, "Confusion", 20, bold=True)
    canvas.text(
        _MARGIN,
        80,
        "row: where it was;  column: what was said;  percent of the row",
        13,
        palette.QUIET,
    )
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    for (i, j), share in np.ndenumerate(shares):
        hue = palette.RIGHT if names[i] == columns[j] else _MISTAKES
        weight = _PALEST + (1.0 - _PALEST) * float(share)
        corner = np.array([left + j * cell, top + i * cell])
        canvas.box(
            corner, corner + cell - 2, palette.paler(hue, 1.0 - weight) if share else palette.SHADE
        )
        if share and cell >= _FIGURES_FROM:
            percent = f"{100 * share:.0f}"
            colour = palette.PAPER if share > _DARK else palette.INK
            x, y = corner + (cell - 2) / 2
            words = "<1" if percent == "0" else percent
            canvas.text(x, y, words, cell * 0.26, colour, "centre")
    for i, name in enumerate(names):
        y = top + (i + 0.5) * cell
        canvas.text(left - _GAP, y, name, letters, palette.INK, "right")
        canvas.text(right + _GAP, y, f"{counts[i].sum():,.0f} scans", letters, palette.QUIET)
    for j, name in enumerate(columns):
        x, y = left + (j + 0.5) * cell, top - _GAP
        if text_width(name, letters) > cell - 4:
            canvas.upright_text(x, y, name, letters)
        else:
            canvas.text(x, y - letters / 2, name, letters, align="centre")
    return canvas.image

"""The page: what is known of a map, in figures, words and sheets, filled into the templates.

Names, properties and reasons are somebody's text: the templates escape whatever they show, and the
page runs no script but its own, which the browser knows by its hash.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.findings import Verdict
from specmap_cli.core.json_values import part_of
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted, one_line, seconds
from specmap_cli.core.toml import flat
from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.grids.map_server import png_bytes
from specmap_cli.maps import filenames
from specmap_cli.maps.store import Map
from specmap_cli.report import layers
from specmap_cli.report.html import PACKAGE, fill_names, html_page, lasting, tones
from specmap_cli.topology.topological_map import starts_of

# the parts of the script in their order; each uses only what stands before it
_SCRIPTS = (
    *("core.js", "viewport.js", "layers.js", "selection.js", "playback.js"),
    *("tables.js", "places.js", "spectra.js"),
)
_STYLES = ("page.css", "map.css", "parts.css", "print.css")
# heads of the table of submaps: their words, and how the column is sorted
_COLUMNS = (
    ("id", "number"),
    ("name", "text"),
    ("kind", "text"),
    ("m²", "number"),
    ("doors", "number"),
)
_DRIVEN_COLUMNS = (("visits", "number"), ("time there", "number"))
_LEARNED_COLUMNS = (("told right", "number"), ("most like", "text"))


_MOST_LOST = 500  # places of lost scans that are drawn, evenly spread


def render(stored: Map, evidence: layers.Evidence, changes: layers.Changes | None = None) -> str:
    """The report on a stored map as the text of one HTML page.

    Raises MapError when a file of the map is missing or damaged.
    """
    map_ = layers.DrawnMap(stored)
    starts = starts_of(stored.logs)  # of the recordings after the first one, in keyframes
    track = layers.Track.of(stored.keyframes, starts, evidence.fit)
    seconds = layers.running_seconds(stored.keyframes.stamps_ns, starts).tolist()
    spectra = layers.spectra_of(evidence, seconds, map_.frame)
    closures, refused = layers.closures_of(map_)
    context = {
        **_drawn(map_, track),
        **_words(map_, track, evidence),
        "closures": closures,
        "spectra": spectra,
        "old": None if changes is None else layers.old_map(changes, map_),
        "data": {  # what the script needs to know
            "width": map_.frame.width,
            "height": map_.frame.height,
            "track": track.table(map_.frame),
            "names": {str(id_): name for id_, name in map_.names.items()},
            "tests": spectra["table"],
            "threshold": spectra["threshold"],
            "logs": [log.name for log in stored.record.graph.logs],
        },
        "thinned": _left_out(track, spectra, len(closures["refused"]), refused),
    }
    return html_page(PACKAGE, "page.html", context, _STYLES, _SCRIPTS)


def _drawn(map_: layers.DrawnMap, track: layers.Track) -> dict[str, Any]:
    """What is drawn of the map, and of the robot's way."""
    doors = map_.stored.doors
    fills = fill_names(map_.fills.values())
    visits = track.visits()
    return {
        "frame": map_.frame,
        "tones": tones(map_.fills.values()),
        "fill_of": {id_: fills[fill] for id_, fill in map_.fills.items()},
        "seen": map_.seen,
        "walls": map_.walls,
        "regions": layers.regions_of(map_),
        "links": layers.links_of(map_),
        "doors": doors,
        "any_driven": any(door.driven for door in doors),  # no robot drove through a floor plan
        "cell_cm": round(map_.stored.regions.grid.resolution * 100.0, 2),
        "track": track,
        "by_time": track.by_time(map_.frame),
        "by_fit": track.by_fit(map_.frame),
        "lost": map_.frame.places(evenly(map_.lost, _MOST_LOST)).tolist(),
        "visits": visits,
        "visits_of": {
            id_: [(start, end) for start, end, submap in visits if submap == id_]
            for id_ in map_.stored.rooms
        },
    }


def _words(map_: layers.DrawnMap, track: layers.Track, evidence: layers.Evidence) -> dict[str, Any]:
    """What is written beside the map."""
    quality, gravity = map_.stored.quality, ("poor", "doubtful", "note")
    findings = [] if quality is None else list(quality.findings)
    # why closures were accepted or refused, and how often, the most frequent first
    counts = Counter((each.reason, each.merged) for each in map_.stored.record.graph.closures)
    ranked = sorted(counts.items(), key=lambda one: (not one[0][1], -one[1], one[0][0]))
    note = map_.stored.note
    headline, *others = [log.name for log in map_.stored.record.graph.logs]
    headline += f" and {counted(len(others), 'more recording')}" if others else ""
    return {
        "title": one_line(headline),
        "place": one_line(map_.stored.path.resolve().name),
        "verdict": "not judged" if quality is None else quality.verdict,
        "sentence": _VERDICTS[map_.stored.verdict],
        "facts": _facts_of(map_, track),
        "findings": sorted(findings, key=lambda one: gravity.index(one.severity)),
        "run": _run_of(map_),
        "sheets": _sheets_of(map_, evidence.learned),
        "columns": (
            *_COLUMNS,
            *(_DRIVEN_COLUMNS if track.total else ()),
            *(_LEARNED_COLUMNS if evidence.learned else ()),
        ),
        "learned": evidence.learned,
        "names": map_.names,
        "logs": map_.stored.record.graph.logs,
        "reasons": [(reason, accepted, count) for (reason, accepted), count in ranked],
        "notes": [*([note] if note else []), *evidence.notes],
    }


def _left_out(
    track: layers.Track, spectra: Mapping[str, Any], drawn: int, refused: int
) -> list[str]:
    """A sentence for each part of the map that is not shown whole."""
    found = ["Outlines are simplified by half a cell; places are rounded to centimetres."]
    if len(track.seconds) < track.total:
        kept, total = len(track.seconds), counted(track.total, "keyframe")
        found.append(f"The way is drawn through {kept:,} of {total}, evenly spread.")
    if len(spectra["dots"]) < spectra["total"]:
        kept, total = len(spectra["dots"]), counted(spectra["total"], "split test")
        found.append(f"Of {total} {kept:,} are shown, those that split a submap first.")
    if spectra["thinned"]:
        found.append("Split tests show some of their nodes, evenly spread.")
    if drawn < refused:
        found.append(
            f"Of {refused:,} refused closures the {drawn:,} with the largest xi are drawn."
        )
    return found


_THUMBNAIL = 240  # pixels of the longer side, at most
_AROUND_M = 0.7  # shown round the outline of a submap
_GREYS = np.zeros(256, dtype=np.uint8)
_GREYS[[FREE, UNKNOWN]] = 255, 214
_VERDICTS: Mapping[Verdict | None, str] = {
    None: "nobody checked this map against itself",
    "good": "nothing was found that speaks against the map",
    "doubtful": "something is wrong, or cannot be known: see the findings before you use the map",
    "poor": "do not use this map",
}


def _facts_of(map_: layers.DrawnMap, track: layers.Track) -> list[tuple[str, str, str]]:
    """The figures at the top of the page, each with its unit and what it counts."""
    record, doors = map_.stored.record, map_.stored.doors
    driven = sum(door.driven for door in doors)
    how_many = "all" if driven == len(doors) else f"{driven:,}"
    found = [
        (f"{len(record.nodes):,}", "", _plural(len(record.nodes), "submap")),
        (f"{record.area_m2:,.0f}", "m²", "free space"),
        *([(f"{record.seen_m2:,.0f}", "m²", "only seen")] if record.graph.seen else []),
        (
            f"{len(doors):,}",
            "",
            _plural(len(doors), "door") + (f", {how_many} driven through" if driven else ""),
        ),
    ]
    if track.total:
        found.append(
            (f"{map_.stored.driven_m:,.0f}", "m", f"driven in {lasting(track.duration_s)}")
        )
        merged = sum(closure.merged for closure in record.graph.closures)
        found.append((f"{merged:,}", "", _plural(merged, "revisit") + " recognised"))
        lost = len(map_.lost)
        scans = sum(log.scans for log in record.graph.logs)
        found.append((f"{lost:,}", "", f"of {scans:,} scans lost"))
    return found


def _plural(count: int, noun: str) -> str:
    return counted(count, noun).split(" ", 1)[1]


def _run_of(map_: layers.DrawnMap) -> dict[str, Any]:
    """How the map was made, by parts; they are empty for a map without run.json."""
    stored = map_.stored
    known = (stored.path / filenames.RUN).exists()
    run = stored.run if known else {}
    warnings = run.get("warnings")
    usual, own = flat(Config().model_dump()), flat(stored.config.model_dump()) if known else {}
    settings = [(key, str(own[key]), str(usual[key])) for key in own if own[key] != usual[key]]
    took = part_of(run, "seconds").items()
    seconds = [(key, float(value)) for key, value in took if type(value) in (int, float)]
    counts = stored.counts if known else {}
    return {
        "selection": _pairs(part_of(run, "selection")),
        "settings": settings,
        "counts": [(key, f"{count:,}") for key, count in counts.items() if count],
        "seconds": sorted(seconds, key=lambda one: -one[1]),
        "versions": _pairs(part_of(run, "versions")),
        "warnings": list(map(str, warnings)) if isinstance(warnings, list) else [],
    }


def _pairs(values: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    told = {key: value for key, value in values.items() if value is not None}
    return tuple(
        (key.replace("_", " "), ", ".join(map(str, value if isinstance(value, list) else [value])))
        for key, value in told.items()
    )


def _sheets_of(
    map_: layers.DrawnMap, learned: Mapping[int, layers.Learned]
) -> list[dict[str, Any]]:
    """All that is told of each submap, by id; `visits` are start and length in seconds."""
    edges = map_.stored.record.edges
    ends = [(edge.source, edge.target) for edge in edges if not edge.doors]
    sheets = []
    for id_, room in map_.stored.rooms.items():
        grid = room.grid
        sides_m = [0.0, 0.0]  # of the smallest upright box round its outline
        if len(room.outline):  # the grid shows far more than the part round it, through doors
            sides_m = np.ptp(room.outline, axis=0).tolist()
            part = grid.near(room.map_from_room.inverse().apply(room.outline), _AROUND_M)
            grid = part if part.cells.size else grid
        thumbnail, size = _thumbnail(grid)
        spans = [(seconds(visit.start_ns), seconds(visit.end_ns)) for visit in room.visits]
        visits = [(start, end - start) for start, end in spans]
        sheets.append(
            {
                "node": room,
                "named": bool(room.given_name),
                "doors": room.doors,
                "open_to": sorted(b if a == id_ else a for a, b in ends if id_ in (a, b)),
                "visits": visits,
                "stayed_s": sum(length for _, length in visits),
                "sides_m": sides_m,
                "thumbnail": thumbnail,
                "thumbnail_size": size,
                "learned": learned.get(id_, layers.Learned()),
            }
        )
    return sheets


def _thumbnail(grid: GridMap) -> tuple[str, tuple[int, int]]:
    """The grid of a submap, cropped to what is known, as a data URL, and its width and height."""
    known = np.argwhere(grid.cells != UNKNOWN)
    if not len(known):
        return "", (0, 0)
    (low, left), (high, right) = known.min(axis=0), known.max(axis=0) + 1
    picture: NDArray[Any] = _GREYS[grid.cells[low:high, left:right][::-1]]
    scale = min(1.0, _THUMBNAIL / max(picture.shape))
    if scale < 1.0:
        size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    picture = picture & 0xF0  # sixteen greys: a third of the bytes
    data = base64.b64encode(png_bytes(picture)).decode("ascii")
    return f"data:image/png;base64,{data}", (picture.shape[1], picture.shape[0])

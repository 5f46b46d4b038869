"""The page put together: what is known of a map, filled into the templates.

Names, properties and reasons are somebody's text: the templates escape whatever they show, and the
page runs no script but its own, which the browser knows by its hash.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from specmap_cli.core.text import counted
from specmap_cli.maps.store import Map
from specmap_cli.report import facts, layers
from specmap_cli.report.evidence import Evidence, Spectra, spectra_of
from specmap_cli.report.html import PACKAGE, html_page, shown
from specmap_cli.report.layers import Changes, Closures, DrawnMap, old_map
from specmap_cli.report.svg import fill_names, tones
from specmap_cli.report.track import Track, running_seconds

# the parts of the script in their order; each uses only what stands before it
_SCRIPTS = (
    "core.js",
    "viewport.js",
    "layers.js",
    "selection.js",
    "playback.js",
    "tables.js",
    "places.js",
    "spectra.js",
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


def render(stored: Map, evidence: Evidence, changes: Changes | None = None) -> str:
    """The report on a stored map as the text of one HTML page.

    Raises MapError when a file of the map is missing or damaged.
    """
    map_ = DrawnMap(stored)
    track = Track.of(stored.keyframes, map_.starts, evidence.fit)
    seconds = running_seconds(stored.keyframes.stamps_ns, map_.starts).tolist()
    spectra = spectra_of(evidence, seconds, map_.frame)
    closures = layers.closures_of(map_)
    context = {
        **_drawn(map_, track),
        **_words(map_, track, evidence),
        "closures": closures,
        "spectra": spectra,
        "old": None if changes is None else old_map(changes, map_),
        "data": {  # what the script needs to know
            "width": map_.frame.width,
            "height": map_.frame.height,
            "track": track.table(map_.frame),
            "names": {str(id_): name for id_, name in map_.names.items()},
            "tests": list(spectra.table),
            "threshold": spectra.threshold,
            "logs": [log.name for log in stored.record.graph.logs],
        },
        "thinned": _left_out(track, spectra, closures),
    }
    return html_page(PACKAGE, "page.html", context, _STYLES, _SCRIPTS)


def _drawn(map_: DrawnMap, track: Track) -> dict[str, Any]:
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
        "lost": layers.lost_places(map_),
        "visits": visits,
        "visits_of": {
            id_: [(start, end) for start, end, submap in visits if submap == id_]
            for id_ in map_.stored.rooms
        },
    }


def _words(map_: DrawnMap, track: Track, evidence: Evidence) -> dict[str, Any]:
    """What is written beside the map."""
    verdict, sentence, findings = facts.judgement_of(map_)
    # why closures were accepted or refused, and how often, the most frequent first
    counts = Counter((each.reason, each.merged) for each in map_.stored.record.graph.closures)
    ranked = sorted(counts.items(), key=lambda one: (not one[0][1], -one[1], one[0][0]))
    note = map_.stored.note
    return {
        "title": shown(facts.headline(map_)),
        "place": shown(map_.stored.path.resolve().name),
        "verdict": verdict,
        "sentence": sentence,
        "facts": facts.facts_of(map_, track),
        "findings": findings,
        "run": facts.run_of(map_),
        "sheets": facts.sheets_of(map_, evidence.learned),
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


def _left_out(track: Track, spectra: Spectra, closures: Closures) -> list[str]:
    """A sentence for each part of the map that is not shown whole."""
    found = ["Outlines are simplified by half a cell; places are rounded to centimetres."]
    if len(track.seconds) < track.total:
        kept, total = len(track.seconds), counted(track.total, "keyframe")
        found.append(f"The way is drawn through {kept:,} of {total}, evenly spread.")
    if len(spectra.dots) < spectra.total:
        kept, total = len(spectra.dots), counted(spectra.total, "split test")
        found.append(f"Of {total} {kept:,} are shown, those that split a submap first.")
    if spectra.thinned:
        found.append("Split tests show some of their nodes, evenly spread.")
    if len(closures.refused) < closures.refused_total:
        kept, total = len(closures.refused), f"{closures.refused_total:,} refused closures"
        found.append(f"Of {total} the {kept:,} with the largest xi are drawn.")
    return found

"""The page put together: what is known of a map, poured into the templates.

Names, properties and reasons are somebody's text: the templates escape whatever they show, and the
page runs no script but its own, which the browser knows by its hash.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from specmap_cli.maps.store import StoredMap
from specmap_cli.report import facts, layers, words
from specmap_cli.report.changes import old_map
from specmap_cli.report.colours import fill_names, tones
from specmap_cli.report.evidence import Changes, Evidence
from specmap_cli.report.ground import Ground
from specmap_cli.report.pouring import PACKAGE, page_parts, poured
from specmap_cli.report.sheets import sheets_of
from specmap_cli.report.spectra import Spectra, spectra_of
from specmap_cli.report.thinned import thinned
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
_FILTERS = ("clock", "lasting", "stamp", "percent", "figure", "feature_words")
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


def render(stored: StoredMap, evidence: Evidence, changes: Changes | None = None) -> str:
    """The report on a stored map as the text of one HTML page.

    Raises MapError when a file of the map is missing or damaged.
    """
    ground = Ground(stored)
    track = Track.of(ground.labels, ground.starts, evidence.fit)
    seconds = running_seconds(ground.labels.stamps_ns, ground.starts).tolist()
    spectra = spectra_of(evidence, seconds, ground.frame)
    closures = layers.closures_of(ground)
    context = {
        **_layers(ground),
        **_way(ground, track),
        **_words(ground, track, evidence),
        "closures": closures,
        "spectra": spectra,
        "old": None if changes is None else old_map(changes, ground),
        "data": _data(ground, track, spectra),
        "thinned": thinned(track, spectra, closures),
        **page_parts(PACKAGE, _SCRIPTS, _STYLES),
    }
    return poured(PACKAGE, "page.html", context, {name: getattr(words, name) for name in _FILTERS})


def _layers(ground: Ground) -> dict[str, Any]:
    """What is drawn of the map."""
    fills = fill_names(ground.fills.values())
    return {
        "frame": ground.frame,
        "tones": tones(ground.fills.values()),
        "fill_of": {id_: fills[fill] for id_, fill in ground.fills.items()},
        "floor": layers.unreached(ground.regions, ground.frame),
        "walls": layers.walls(ground.regions, ground.frame),
        "regions": layers.regions_of(ground),
        "links": layers.links_of(ground),
        "doors": layers.doors_of(ground),
        "cell_cm": round(ground.regions.grid.resolution * 100.0, 2),
    }


def _way(ground: Ground, track: Track) -> dict[str, Any]:
    """What is drawn of the robot's way."""
    visits = track.visits()
    return {
        "track": track,
        "by_time": track.by_time(ground.frame),
        "by_fit": track.by_fit(ground.frame),
        "lost": layers.lost_places(ground),
        "visits": visits,
        "visits_of": {
            id_: [(start, end) for start, end, submap in visits if submap == id_]
            for id_ in ground.nodes
        },
    }


def _words(ground: Ground, track: Track, evidence: Evidence) -> dict[str, Any]:
    """What is written beside the map."""
    verdict, sentence = facts.verdict_of(ground)
    note = ground.stored.note
    return {
        "title": words.shown(facts.headline(ground)),
        "place": words.shown(ground.stored.path.resolve().name),
        "verdict": verdict,
        "sentence": sentence,
        "facts": facts.facts_of(ground, track),
        "findings": facts.findings_of(ground),
        "run": facts.run_of(ground),
        "sheets": sheets_of(ground, evidence.learned),
        "columns": (
            *_COLUMNS,
            *(_DRIVEN_COLUMNS if track.known else ()),
            *(_LEARNED_COLUMNS if evidence.learned else ()),
        ),
        "learned": evidence.learned,
        "names": ground.names,
        "logs": ground.stored.record.graph.logs,
        "reasons": _reasons(ground),
        "notes": [*([note] if note else []), *evidence.notes],
    }


def _reasons(ground: Ground) -> list[tuple[str, bool, int]]:
    """Why closures were accepted or refused, and how often, the most frequent first."""
    closures = ground.stored.record.graph.closures
    counts = Counter((each.reason, each.merged) for each in closures)
    ranked = sorted(counts.items(), key=lambda one: (not one[0][1], -one[1], one[0][0]))
    return [(reason, accepted, count) for (reason, accepted), count in ranked]


def _data(ground: Ground, track: Track, spectra: Spectra) -> dict[str, Any]:
    """What the script needs to know."""
    return {
        "width": ground.frame.width,
        "height": ground.frame.height,
        "track": track.table(ground.frame),
        "names": {str(id_): name for id_, name in ground.names.items()},
        "tests": list(spectra.table),
        "threshold": spectra.threshold,
        "logs": [log.name for log in ground.stored.record.graph.logs],
    }

"""The figures of a map that a rule can bound, each by its name.

A figure that the map does not hold is None: a map of `specmap segment`, say, lost no scans and read
none. Figures that begin with `golden.` are of a comparison with another map.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import networkx as nx

from specmap_cli.maps import filenames
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.store import Map
from specmap_cli.topology.topological_map import driven_m, starts_of

Figures = Mapping[str, float | None]

FINDINGS, GOLDEN = "findings.", "golden."  # what the names of such figures begin with
MEANINGS = {
    "scans": "scans that were read",
    "lost_share": "share of the scans that could not be registered",
    "damage": "places where a recording is damaged or cut off, so that scans may be missing",
    "breaks": "how often tracking was lost and began afresh",
    "duration_s": "seconds from the first keyframe to the last, of all recordings",
    "path_m": "metres driven",
    "revisits": "stays that were recognised as one submap seen before",
    "submaps": "submaps",
    "edges": "links between submaps",
    "impassable": "links without a way that the robot can drive",
    "parts": "parts of the map that no link joins",
    "doors": "doors",
    "area_m2": "square metres of the submaps: their free cells",
    "wall_s": "seconds that the command took to make the map",
    "scans_per_s": "scans read in each of these seconds",
    "memory_mb": "most megabytes that its process held",
    "golden.aligned": "1 where the map was recognised in the other one, 0 where not",
    "golden.same_share": "share of the other map's submaps that are the same",
    "golden.gone": "submaps whose floor is gone",
    "golden.unseen": "submaps of the other map that this one did not see",
    "golden.new": "submaps that the other map did not see",
    "golden.area_share": "area of the submaps, times that of those of the other map",
    "golden.closed": "ways that were open and are blocked",
    "golden.opened": "ways that were blocked and are open",
    "golden.off_m": "how far submaps lie off, root mean square, metres",
    "golden.appeared_m2": "square metres covered by things that were not there",
    "golden.vanished_m2": "square metres covered before by things that are gone",
}


# docs/quality.md says what each means
_CODES = (
    *("lost-scans", "tracking-break", "hole-in-log", "unmeasured-way", "odometry-disagrees"),
    *("loose-part", "walls-disagree", "part-moved", "rival-place", "layout-refused"),
    *("closures-refuted", "beyond-grid", "input"),
)
BOUNDED = (*MEANINGS, *(FINDINGS + code for code in _CODES))  # what a rule can bound


def figures_of(stored: Map) -> dict[str, float | None]:
    """The figures of a map. Raises MapError when a file of it is damaged."""
    record = stored.record
    # what the command that made the map wrote down about its run, if it did
    written = (stored.path / filenames.RUN).exists()
    run: Mapping[str, Any] = stored.run if written else {}
    counts = stored.counts if written else {}
    scans, lost, wall_s = counts.get("scans"), counts.get("lost"), _number(run.get("wall_s"))
    duration_s = path_m = None
    if stored.of_recording:  # a divided grid knows of no way
        labels, starts = stored.labels, starts_of(stored.logs)
        duration_s, path_m = labels.duration_s(starts), driven_m(stored.logs, labels)
    quality = record.graph.quality
    grave = [] if quality is None else [one for one in quality.findings if one.severity != "note"]
    return {
        "scans": scans,
        "lost_share": lost / scans if scans and lost is not None else None,
        "damage": counts.get("damage", 0),
        "breaks": counts.get("breaks"),
        "revisits": counts.get("merges"),
        "wall_s": wall_s,
        "scans_per_s": scans / wall_s if scans is not None and wall_s else None,
        "memory_mb": _number(run.get("memory_mb")),
        "duration_s": duration_s,
        "path_m": path_m,
        "submaps": len(stored.rooms),
        "edges": len(record.edges),
        "impassable": sum(edge.path is None for edge in record.edges),
        "parts": nx.number_connected_components(stored.to_networkx()),
        "doors": len(stored.doors),
        "area_m2": record.area_m2,
        **{
            f"{FINDINGS}{code}": sum(one.code == code for one in grave)
            for code in sorted({one.code for one in grave})
        },
    }


def _number(value: Any) -> float | None:
    """A number that a person may have spoiled: None for anything else."""
    return float(value) if type(value) in (int, float) and abs(value) < 1e15 else None


def figures_against(record: ComparisonRecord | None) -> dict[str, float | None]:
    """The figures of a comparison, the golden map being the old one; None: it cannot be aligned."""
    if record is None:
        return {name: None for name in MEANINGS if name.startswith(GOLDEN)} | {"golden.aligned": 0}
    old, new = record.old, record.new
    same = len(record.submaps.same) / old.submaps if old.submaps else None
    return {
        "golden.aligned": 1,
        "golden.same_share": 1.0 if record.identical else same,
        "golden.gone": len(record.submaps.gone),
        "golden.unseen": len(record.submaps.unseen),
        "golden.new": len(record.submaps.new),
        "golden.area_share": new.area_m2 / old.area_m2 if old.area_m2 else None,
        "golden.closed": len(record.doors.closed),
        "golden.opened": len(record.doors.opened),
        "golden.off_m": record.alignment.residual_m,
        "golden.appeared_m2": sum(one.area_m2 for one in record.things.appeared),
        "golden.vanished_m2": sum(one.area_m2 for one in record.things.vanished),
    }

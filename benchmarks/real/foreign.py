"""Recordings of one building localised in the maps of others: all of it must be unknown.

Five real maps, and the sessions of the other buildings. A recording whose laser sees too little for
a map is refused, and counts as unknown. Then each two of these maps are compared: none may align.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.cost.processes import SPECMAP
from benchmarks.cost.processes import measure as measured
from benchmarks.data import recording
from benchmarks.localized import UNKNOWN, localized
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.maps.store import read_map

# building: the session that its map is made of
BUILDINGS = {
    "corridor": "corridor_2",
    "ring": "ring",
    "hallway": "hallway_1",
    "room": "room_1",
    "floor": "floor_1",
}
# recordings: the building of each
LOGS = {
    "corridor_1": "corridor",
    "corridor_3": "corridor",
    "ring": "ring",
    "hallway_2": "hallway",
    "room_4": "room",
    "floor_2": "floor",
    "turtlebot4_office": "office",
}

ROWS = (
    Row("ring", "corridor_3 in the map of the ring: called known", 0.05, 0.0, "less"),
    Row("known", "called known, mean of 30 pairs", 0.03, 0.0, "less"),
    Row("worst", "called known, the worst pair", 0.10, 0.0, "less"),
    Row("aligned", "maps of two buildings that `compare` aligns, of 10", 0, 0, "less", ".0f"),
)


def measure(bench: Bench) -> Figures:
    """Ask every map about the recordings of all other buildings."""
    maps = {name: bench.recorded(log) for name, log in BUILDINGS.items()}
    known = {}
    with bench.scratch("foreign") as folder:
        print(f"{'known, in':10}" + "".join(f"{name:>18}" for name in LOGS))
        for name, map_ in maps.items():
            texts = []
            for log, of in LOGS.items():
                if of == name:
                    texts.append("")
                    continue
                share = share_known(map_, recording(log), folder)
                known[name, log] = share or 0.0
                texts.append("refused" if share is None else f"{share:.3f}")
            print(f"{name:10}" + "".join(f"{text:>18}" for text in texts), flush=True)
        pairs = list(combinations(maps, 2))
        aligned = [pair for pair in pairs if aligns(maps[pair[0]], maps[pair[1]], folder)]
    print(f"aligned: {aligned or 'none'}")
    return {
        "ring": known["ring", "corridor_3"],
        "known": float(np.mean(list(known.values()))),
        "worst": max(known.values()),
        "aligned": len(aligned),
    }


def share_known(map_: Path, log: Path, folder: Path) -> float | None:
    """The share of scans that are called known; None when the laser is refused."""
    said = localized(read_map(map_), log, folder)
    return None if said is None else float((said.filtered != UNKNOWN).mean())


def aligns(old: Path, new: Path, folder: Path) -> bool:
    """Whether `compare` takes two maps for one building."""
    try:
        measured([SPECMAP, "compare", str(old), str(new), "-q"], folder)
    except RuntimeError as error:
        if "not aligned" not in str(error):
            raise
        return False
    return True

"""Is it the same map again: more noise, backwards, begun elsewhere, another way, another session?

Takes of one building that should become the same submaps (making/takes.py), and pairs of sessions
that were really recorded. The second map is laid on the first by its walls (laying.py). Of the
cells that belong to a submap in both, the share is that of the submaps with a partner whose
intersection over union is above 0.5, of the map that has more of them. A submap counts when both
maps saw at least half of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.making.recordings import write
from benchmarks.making.takes import LOGS, takes
from benchmarks.real.laying import Seen, whole
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.maps.store import Map, read_map

SAME = 0.5  # IoU above which two submaps are one: each submap has one such partner at the most
BUILDINGS = {
    "fr079": "fr079",
    "csail": "mit_csail",
    "office": "office",
    "furnished": "Freiburg79_scan_furnitures",
}
SESSIONS = (
    ("corridor_1", "corridor_2"),
    ("corridor_1", "corridor_3"),
    ("corridor_2", "corridor_3"),
    ("room_1", "room_4"),
    ("floor_1", "floor_2"),
    ("floor_1", "carried_after"),
    ("hallway_1", "hallway_2"),
)

ROWS = (
    Row("sessions", "submaps found again in another session, 7 pairs", 0.9, 1.0),
    Row("fr079", "fr079, submaps found again, the worst of 3 takes", 0.9, 1.0),
    Row("csail", "mit_csail, the worst of 3 takes", 0.9, 1.0),
    Row("office", "sample office, simulated, the worst of 3 takes", 0.9, 1.0),
    Row("furnished", "furnished Freiburg79, simulated, the worst of 3 takes", 0.9, 1.0),
)


@dataclass(frozen=True, slots=True)
class Agreement:
    """`matched` submaps of the `first` and `second` that both maps saw, and the mean best IoU."""

    matched: int
    first: int
    second: int
    iou: float

    @property
    def share(self) -> float:
        """Matched submaps of those of the map that has more of them."""
        return self.matched / max(self.first, self.second, 1)


def measure(bench: Bench) -> Figures:
    """Build the takes of every building, and hold the sessions of each place together."""
    print(f"{'first':28} {'second':14} submaps  matched  share    IoU")
    figures: dict[str, Figure | float] = {}
    for key, building in BUILDINGS.items():
        shares = []
        first = read_map(bench.recorded(building)) if building in LOGS else None
        for take in takes(building):
            make = partial(write, take.sweeps, iter)
            stored = read_map(bench.simulated(f"{building}-take-{take.kind}", make))
            if first is None:
                first = stored
                continue
            shares.append(_told(first, stored, building, take.kind))
        figures[key] = Figure(min(shares), note=f"mean {np.mean(shares):.2f}")
    pairs = [
        _told(read_map(bench.recorded(one)), read_map(bench.recorded(other)), one, other)
        for one, other in SESSIONS
    ]
    worst = f"worst {min(pairs):.2f}"
    return {**figures, "sessions": Figure(float(np.mean(pairs)), note=worst)}


def _told(first: Map, second: Map, name: str, other: str) -> float:
    """The share of submaps that are found again, told in a line."""
    one = agreement(first, second, whole(Seen(first), Seen(second)).pose)
    print(
        f"{name:28} {other:14} {one.first:3}/{one.second:<3} {one.matched:8} {one.share:6.3f} "
        f"{one.iou:6.3f}",
        flush=True,
    )
    return one.share


def agreement(first: Map, second: Map, first_from_second: Pose2) -> Agreement:
    """The submaps of two maps against each other, over the cells that belong to one in both."""
    one, other = first.regions, second.regions
    cells = np.argwhere(one.owner >= 0)
    places = first_from_second.inverse().apply(one.grid.centres_of(cells))
    there = other.grid.cells_of(places)
    inside = other.grid.inside(there)
    mine, theirs = one.owner[tuple(cells[inside].T)], other.owner[tuple(there[inside].T)]
    both = theirs >= 0
    shared = np.zeros((one.owner.max() + 1, other.owner.max() + 1))
    np.add.at(shared, (mine[both], theirs[both]), 1.0)
    iou = shared / np.maximum(shared.sum(axis=1)[:, None] + shared.sum(axis=0) - shared, 1.0)
    counted = iou[_seen(shared.sum(axis=1), one.owner)][:, _seen(shared.sum(axis=0), other.owner)]
    return Agreement(
        matched=int((counted > SAME).sum()),
        first=counted.shape[0],
        second=counted.shape[1],
        iou=float(counted.max(axis=1).mean()) if counted.size else 0.0,
    )


def _seen(common: np.ndarray, owner: np.ndarray) -> BoolArray:
    """Which regions (k,) lie in both maps by half at the least, of those that own a cell."""
    size = np.bincount(owner[owner >= 0], minlength=len(common))
    return np.asarray((size > 0) & (common >= 0.5 * size))

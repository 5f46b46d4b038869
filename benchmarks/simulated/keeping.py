"""A map that is kept: what updates and merges leave of ids, borders and accuracy, and their cost.

The sample office and its second log; fr079 cut in three by time, each piece added to the map of
those before, and the three maps merged in two orders. Submaps that kept their ids; the least IoU of
their borders over cells that both maps knew, and the least apart from floor that submaps which were
entered now took; the error of the layout; processor time against that of building the new log
alone.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.cost.processes import SPECMAP
from benchmarks.cost.processes import measure as measured
from benchmarks.data import SAMPLES, recording, truth_file
from benchmarks.making.replays import write_pieces
from benchmarks.scoreboard.bench import Bench, build
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.core.geometry import FloatArray
from specmap_cli.evaluation.trajectories import read_relations, reference_errors, relation_errors
from specmap_cli.maps.store import Map, read_map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.topology.identity import BorderChange, border_changes

Error = Callable[[Path], float]  # of the trajectory of a map, metres

ROWS = (
    Row("ids", "sample office, its second log added: ids kept", 1.0, 1.0),
    Row("border", "the same: the least IoU of an old border", 0.9),
    Row("cut_ids", "fr079 in three pieces, added one by one: ids kept", 1.0, 1.0),
    Row("cut_border", "the same: the least IoU, apart from rooms entered now", 0.9),
    Row("cut_error", "the same: relation error", 0.032, 0.031, "less", ".4f", "m"),
    Row("orders", "the three maps merged in two orders: different results", 1, 1, "less", ".0f"),
    Row("cost", "processor time of `update` against building the new log", 1.3, 1.1, "less", ".2f"),
)


@dataclass(frozen=True, slots=True)
class Updated:
    """What an update left: ids of the old map, the least IoU of its borders, its cost."""

    kept: int
    ids: int
    border: float
    apart: float
    cost: float


def measure(bench: Bench) -> Figures:
    """The second log of the office, and fr079 cut in three."""
    with bench.scratch("keeping") as folder:
        second = second_log(folder)
        cut, error, orders = cut_log(folder)
    return {
        "ids": second.kept / second.ids,
        "border": second.border,
        "cut_ids": sum(one.kept for one in cut) / sum(one.ids for one in cut),
        "cut_border": min(one.apart for one in cut),
        "cut_error": error,
        "orders": orders,
        "cost": Figure.of([second.cost, *(one.cost for one in cut)]),
    }


def second_log(folder: Path) -> Updated:
    """The sample office: its second log added to the map of the first."""
    logs = [SAMPLES / f"{name}.mcap" for name in ("office", "office_again")]
    truths = [log.with_suffix(".tum") for log in logs]
    build(logs[0], folder / "map0")
    return update(folder, 0, logs[1], partial(tour_error, truths=truths))


def cut_log(folder: Path) -> tuple[list[Updated], float, int]:
    """fr079 in three pieces: updates in turn; their error; results of merging in two orders."""
    relations = read_relations(truth_file("fr079.relations"))

    def error(path: Path) -> float:
        return relation_errors(read_tum(path), relations).translation_m.mean

    pieces = [folder / f"piece{k}.mcap" for k in range(3)]
    write_pieces(recording("fr079"), pieces)
    for k, piece in enumerate(pieces):
        build(piece, folder / f"part{k}")
    shutil.copytree(folder / "part0", folder / "map0", dirs_exist_ok=True)
    updates = [update(folder, k, pieces[k + 1], error) for k in (0, 1)]
    results = set()
    for order in ((0, 1, 2), (2, 0, 1)):
        maps = [str(folder / f"part{k}") for k in order]
        out = folder / "merged"
        measured([SPECMAP, "merge", *maps, "-o", str(out), "--overwrite", "-q"], folder)
        results.add((out / "labels.csv").read_bytes())
    joined = error(folder / "map2" / "trajectory.tum")
    return updates, joined, len(results)


def update(folder: Path, number: int, log: Path, error: Error) -> Updated:
    """Add a log to map `number`, and print what it left of it."""
    old, new = folder / f"map{number}", folder / f"map{number + 1}"
    command = [SPECMAP, "update", str(old), str(log), "-o", str(new), "--overwrite", "-q"]
    cost = measured(command, folder).processor_s / build(log, folder / "alone").processor_s
    before, after = read_map(old), read_map(new)
    kept, entered = set(before.ids) & set(after.ids), set(after.ids) - set(before.ids)
    changes = border_changes(before.regions, after.regions)
    ious = [change.iou for change in changes]
    apart = [apart_from_entered(change, entered) for change in changes]
    away = moved_by(before, after)
    print(
        f"update {number + 1}: {len(kept)} of {len(before.ids)} ids kept, IoU at least "
        f"{min(ious):.3f}, mean {np.mean(ious):.3f}; at least {min(apart):.3f} apart from rooms "
        f"entered now; moved {away.mean():.3f} m, at most {away.max():.3f}; new {sorted(entered)}; "
        f"error {error(new / 'trajectory.tum'):.4f} m (before "
        f"{error(old / 'trajectory.tum'):.4f}); keyframes {len(before.labels.poses)} -> "
        f"{len(after.labels.poses)}; cost {cost:.2f}",
        flush=True,
    )
    return Updated(len(kept), len(before.ids), min(ious), min(apart), cost)


def moved_by(before: Map, after: Map) -> FloatArray:
    """Metres by which the keyframes of a map moved in an update, of those that it left."""
    logs = len(before.logs)
    old, new = places(before, logs), places(after, logs)
    left = sorted(old.keys() & new.keys())
    return np.array([math.hypot(*(old[key] - new[key])[:2]) for key in left])


def places(map_: Map, logs: int) -> dict[tuple[int, int], FloatArray]:
    """The poses of the keyframes of the first `logs` recordings, by recording and stamp."""
    found = {}
    for number, log in enumerate(map_.logs[:logs]):
        first, last = log.keyframes or (0, -1)
        for row in range(first, last + 1):
            found[number, int(map_.labels.stamps_ns[row])] = map_.labels.poses[row]
    return found


def apart_from_entered(change: BorderChange, new: Collection[int]) -> float:
    """The IoU of a border without the floor that submaps which were entered now took from it."""
    taken = sum(m2 for submap, m2 in change.given.items() if submap in new)
    before_m2 = max(change.was_m2 - taken, 0.0)
    kept_m2 = change.was_m2 - sum(change.given.values())
    return max(0.0, kept_m2) / max(1e-9, before_m2 + sum(change.taken.values()))


def tour_error(path: Path, truths: Sequence[Path]) -> float:
    """The largest absolute error of the tours in a trajectory, one after the other, metres."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    errors, first = [], 0
    for truth in truths:
        true = read_tum(truth)
        piece = path.with_name("piece.tum")
        piece.write_text("\n".join(lines[first : first + len(true.stamps_ns)]), encoding="utf-8")
        first += len(true.stamps_ns)
        if piece.stat().st_size:
            errors.append(reference_errors(read_tum(piece), true).ate_m)
        piece.unlink()
    return max(errors)

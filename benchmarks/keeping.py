"""A map that is kept: what updates and merges leave of ids, borders and accuracy, and their cost.

    SPECMAP_DATA=... python -m benchmarks.keeping [--only second cut tours like]

`second`: the sample office and its second log. `cut`: fr079 cut in three by time, each piece added
to the map of those before, and the three maps merged in all six orders. `tours`: another tour of
simulated plans added to the map of the first, and five more in turn. `like`: the takes of
benchmarks.stability of three buildings, each built with `--like` the map of the first: the share of
submaps that have the id of the one that they share more than half of their ground with. Of the
others a line an update: submaps that
kept their ids, the least and the mean IoU of their borders over cells that both maps knew, the
least apart from floor that submaps entered now took, how far old keyframes moved, new ids, the
error of the layout against that of one build over everything (`kept / once`), keyframes before and
after, and processor time against that of building the new log alone.
"""

from __future__ import annotations

import argparse
import itertools
import math
import tempfile
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.data import log_file, plan, truth_file
from benchmarks.hard_logs.recordings import write
from benchmarks.processes import SCRIPTS, measure
from benchmarks.replays import write_pieces
from benchmarks.stability.comparing import SAME
from benchmarks.stability.recordings import takes
from specmap_cli.core.geometry import FloatArray
from specmap_cli.evaluation.trajectories import (
    read_relations,
    read_tum,
    reference_errors,
    relation_errors,
)
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.topology.border_changes import BorderChange, border_changes

SPECMAP = str(SCRIPTS / "specmap")
SAMPLES = Path("sample_logs")
PLANS = (("Freiburg79_scan", 360.0), ("office_h_furnitures", 270.0))
UPDATES = 5
LIKE = ("sample office", "fr079", "mit_csail")

Error = Callable[[Path], float]  # of the trajectory of a map, metres


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    sections = {"second": second_log, "cut": cut_log, "tours": more_tours, "like": like_first}
    parser.add_argument("--only", nargs="*", choices=sections, default=list(sections))
    arguments = parser.parse_args()
    for name in arguments.only:
        with tempfile.TemporaryDirectory() as folder:
            print(f"\n{name}")
            sections[name](Path(folder))


def second_log(folder: Path) -> None:
    """The sample office: its second log added to the map of the first."""
    logs = [SAMPLES.resolve() / f"{name}.mcap" for name in ("office", "office_again")]
    truths = [log.with_suffix(".tum") for log in logs]
    build(logs[0], folder / "map0")
    update(folder, 0, logs[1], partial(tour_error, truths=truths))


def cut_log(folder: Path) -> None:
    """fr079 in three pieces: updates in turn, and merges in every order."""
    relations = read_relations(truth_file("fr079.relations"))

    def error(path: Path) -> float:
        return relation_errors(read_tum(path), relations).translation_m.mean

    pieces = [folder / f"piece{k}.mcap" for k in range(3)]
    write_pieces(log_file("fr079"), pieces)
    build(log_file("fr079"), folder / "once")
    once = error(folder / "once" / "trajectory.tum")
    for k, piece in enumerate(pieces):
        build(piece, folder / f"part{k}")
    build(pieces[0], folder / "map0")
    for k in (0, 1):
        update(folder, k, pieces[k + 1], error)
    print(f"fr079 in one build: {once:.4f} m, {len(read_map(folder / 'once').ids)} submaps")
    results = set()
    for order in itertools.permutations(range(3)):
        maps = [str(folder / f"part{k}") for k in order]
        out = folder / "merged"
        measure([SPECMAP, "merge", *maps, "-o", str(out), "--overwrite", "-q"], folder)
        results.add((out / "labels.csv").read_bytes())
    merged = read_map(folder / "merged")
    print(
        f"merged in six orders: {len(results)} different result(s), {len(merged.ids)} submaps, "
        f"{error(folder / 'merged' / 'trajectory.tum'):.4f} m"
    )


def more_tours(folder: Path) -> None:
    """Simulated plans: a first tour, then others that begin elsewhere and look closer."""
    for name, view_deg in PLANS:
        print(f"{name}, {view_deg:.0f} degrees")
        tours = []
        for seed in range(1 + UPDATES):
            options = SimulationOptions(
                field_of_view_deg=view_deg, beams=361, seed=seed, spacing_m=2.0 - 0.1 * seed
            )
            tours.append(simulate(plan(name), options, folder / f"{name}{seed}.mcap"))
        truths = [tour.truth for tour in tours]
        build(tours[0].log, folder / "map0")
        for k in range(UPDATES):
            update(folder, k, tours[k + 1].log, partial(tour_error, truths=truths[: k + 2]))


def like_first(folder: Path) -> None:
    """Other takes of a building, built with the frame and the ids of the map of the first one."""
    log, first, like = folder / "take.mcap", folder / "map0", folder / "like"
    for building in LIKE:
        others = takes(building)
        write(next(others).sweeps, iter, log)
        build(log, first)
        before = read_map(first)
        for take in others:
            write(take.sweeps, iter, log)
            build(log, like, "--like", str(first), "--set", f"seed={take.seed}")
            after = read_map(like)
            changes = border_changes(before.regions, after.regions)
            same = sum(change.iou > SAME for change in changes)
            share = same / max(len(before.ids), len(after.ids))
            print(
                f"{building:13} {take.kind} {take.name:6} {len(before.ids):3}/{len(after.ids):<3} "
                f"same id {same:3}, {share:.3f}",
                flush=True,
            )


def build(log: Path, out: Path, *options: str) -> float:
    """Build a map; processor seconds."""
    command = [SPECMAP, "build", str(log), "-o", str(out), "--overwrite", "-q", *options]
    return measure(command, out.parent).processor_s


def update(folder: Path, number: int, log: Path, error: Error) -> None:
    """Add a log to map `number`, and print what it left of it."""
    old, new = folder / f"map{number}", folder / f"map{number + 1}"
    command = [SPECMAP, "update", str(old), str(log), "-o", str(new), "--overwrite", "-q"]
    cost = measure(command, folder).processor_s / build(log, folder / "alone")
    before, after = read_map(old), read_map(new)
    kept, entered = set(before.ids) & set(after.ids), set(after.ids) - set(before.ids)
    changes = border_changes(before.regions, after.regions)
    ious = [change.iou for change in changes]
    apart = [apart_from_entered(change, entered) for change in changes]
    away = moved_by(before, after)
    print(
        f"update {number + 1}: {len(kept)} of {len(before.ids)} ids kept, IoU at least "
        f"{min(ious):.3f}, mean {np.mean(ious):.3f}; at least {min(apart):.3f} apart from rooms "
        f"entered now; moved {away.mean():.3f} m, at most "
        f"{away.max():.3f}; new {sorted(entered)}; error "
        f"{error(new / 'trajectory.tum'):.4f} m (before "
        f"{error(old / 'trajectory.tum'):.4f}); keyframes {len(before.labels.poses)} -> "
        f"{len(after.labels.poses)}; cost {cost:.2f}",
        flush=True,
    )


def moved_by(before: StoredMap, after: StoredMap) -> FloatArray:
    """Metres by which the keyframes of a map moved in an update, of those that it left."""
    logs = len(before.logs)
    old, new = places(before, logs), places(after, logs)
    left = sorted(old.keys() & new.keys())
    return np.array([math.hypot(*(old[key] - new[key])[:2]) for key in left])


def places(map_: StoredMap, logs: int) -> dict[tuple[int, int], FloatArray]:
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


if __name__ == "__main__":
    main()

"""Whole maps of simulated tours against their rooms: the sample log, and tours in real plans.

python -m benchmarks.sample_tour [--set KEY=VALUE ...] [--plans]

Prints for each tour: submaps, the share of visited rooms that are part of at most two submaps, the
share of rooms in which the second lap opened no submap, how many doors driven through are edges,
edges between rooms that no door joins, purity, and the absolute error of the trajectory.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.data import RESOLUTION_M, plan, rooms_of
from specmap_cli.cli.options import Settings
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.rooms import map_scores
from specmap_cli.evaluation.trajectories import associate, read_tum, reference_errors
from specmap_cli.maps.store import read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.room_truth import RoomTruth, read_rooms
from specmap_cli.simulation.simulator import SimulationOptions

SAMPLE_LOG = Path("sample_logs/office.mcap")
SAMPLE_TRUTH = Path("sample_logs/office.tum")
PLANS = ("Freiburg79_scan", "Freiburg79_scan_furnitures", "lab_c_scan", "office_h_furnitures")


def sample_rooms() -> RoomTruth:
    """The rooms of the sample log, in the frame of its true poses."""
    return read_rooms("sample_logs/office_rooms.png", RESOLUTION_M)


def score(name: str, log: Path, truth: Path, rooms: RoomTruth, config: Config, out: Path) -> str:
    """Build the map of one tour and return its line of the table."""
    build_map([log], out, config)
    stored, true = read_map(out), read_tum(truth)
    labelled, row = associate(true.stamps_ns, stored.labels.stamps_ns)
    found = map_scores(rooms, true.poses[row], stored.labels.submaps[labelled])
    error = reference_errors(read_tum(out / "trajectory.tum"), true)
    merges = sum(closure.accepted for closure in stored.record.graph.closures)
    return (
        f"{name:28} {len(found.pieces):5} {len(stored.ids):7} {found.whole:9.2f} "
        f"{found.recognised:10.2f} {found.found:5}/{found.doors:<3} {found.invented:8} "
        f"{found.purity:6.3f} {merges:6} {error.ate_m:7.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("--plans", action="store_true", help="also the plans of the data folder")
    arguments = parser.parse_args()
    config = Settings(assignments=arguments.settings).load()
    print(
        f"{'tour':28} {'rooms':>5} {'submaps':>7} {'whole <=2':>9} {'recognised':>10} "
        f"{'doors':>9} {'invented':>8} {'purity':>6} {'merges':>6} {'ATE m':>7}"
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sample = SAMPLE_LOG, SAMPLE_TRUTH, sample_rooms()
        print(score("sample_logs/office", *sample, config, folder / "office"), flush=True)
        for tour in PLANS if arguments.plans else ():
            log = folder / f"{tour}.mcap"
            options = SimulationOptions(beams=541, speed_mps=0.8, spacing_m=3.0, laps=2, seed=3)
            made = simulate(plan(tour), options, log)
            row = score(tour, log, made.truth, rooms_of(tour), config, folder / tour)
            print(row, flush=True)


if __name__ == "__main__":
    main()

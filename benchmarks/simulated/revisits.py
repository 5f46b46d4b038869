"""Loop closures of simulated tours, whose poses are exact: revisits found, and wrong merges.

The scans are registered as those of a log, with drifting odometry. Merges are those before the
layout's veto; a region comes back when two fifths of its track lie within a metre of an earlier
one's, and the other way round (real/closure_truth.py).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.data import plan
from benchmarks.making.tours import tour_options
from benchmarks.real.closure_truth import Judged, judged
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.pipelines.build import explore
from specmap_cli.pipelines.exploration import Exploration
from specmap_cli.pipelines.session import Session
from specmap_cli.registration.frontend import FrontEnd
from specmap_cli.simulation.simulator import simulated_tour

CASES = (
    ("lab_c_scan_furnitures", 360.0),
    ("Freiburg52_scan_furnitures", 180.0),
    ("lab_c_scan", 180.0),
)
LONGEST_S = 600.0

ROWS = (
    Row("found", "revisits found, 3 tours", 0.90, 0.98),
    Row("wrong", "merges whose transform is wrong, before any veto", 0, 0, "less", ".0f"),
    Row("error", "median error of the transforms", 1.0, None, "less", ".1f", "cm"),
)


def measure(_: Bench) -> Figures:
    """Explore every tour and judge its closures."""
    print("tour                         regions merges right | revisits | constraints | halves")
    rows = []
    for name, view in CASES:
        rows.append(closures_of(name, view))
        print(f"{name:27} {view:4.0f} {rows[-1]}", flush=True)
    found, revisits = sum(row.found for row in rows), sum(row.revisits for row in rows)
    errors = np.concatenate([row.errors[:, 0] for row in rows])
    return {
        "found": Figure(found / revisits, note=f"{found} of {revisits}"),
        "wrong": sum(row.wrong for row in rows),
        "error": 100 * float(np.median(errors)),
    }


def closures_of(name: str, view: float) -> Judged:
    """The closures of two laps through a plan, against its exact poses."""
    config, poses = load_config(), dict[int, Pose2]()
    options = tour_options(view, 0, laps=2, max_duration_s=LONGEST_S)
    front_end = FrontEnd(config.registration)

    def scans() -> Iterator[PosedScan]:
        for sweep, pose in simulated_tour(plan(name), options).scans():
            poses[sweep.stamp_ns] = pose
            yield front_end.register(sweep)

    with KeyframeStore() as store:
        exploration = Exploration(Session(config, store))
        accepts = KeyframeSelector(config.keyframes).accepts
        explored = explore(scans(), exploration, accepts)
        return judged(explored, store, np.array([poses[s] for s in store.stamps_ns]))

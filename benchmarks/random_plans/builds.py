"""Whole maps of simulated tours through the random plans, held against the truth.

Each plan has another laser, drift and noise, drawn by its kind and number; every fourth log has no
odometry.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.hard_logs.recordings import absolute, write
from benchmarks.hard_logs.spoiling import without_odometry
from benchmarks.random_plans.buildings import BUILDINGS
from benchmarks.random_plans.drawing import RESOLUTION_M, Drawing
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation.rooms import map_scores
from specmap_cli.evaluation.trajectories import associate, read_tum
from specmap_cli.maps.store import read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.simulation.room_truth import RoomTruth
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour, stamp_of

HEADER = "kind  number  view  reach  odometry  rooms  submaps  purity  doors  error m  verdict"
_DEGREES = (180.0, 240.0, 270.0, 360.0)
_BEAMS = (180, 360, 720, 1080)
_REACH_M = (4.0, 8.0, 10.0, 20.0, 30.0)
_NOISE_M = (0.005, 0.01, 0.02, 0.03)
_DRIFT = (1.0, 2.0, 4.0)


@dataclass(frozen=True, slots=True)
class Build:
    """What became of one tour."""

    options: SimulationOptions
    measured: bool
    rooms: int
    submaps: int
    purity: float
    doors: str
    error_m: float
    verdict: str

    def line(self, kind: str, number: int) -> str:
        """A row of the table."""
        odometry = f"x {self.options.odometry_drift:g}" if self.measured else "none"
        return (
            f"{kind:6} {number:5} {self.options.field_of_view_deg:5.0f} "
            f"{self.options.range_max_m:6.0f}  {odometry:>8} {self.rooms:6} {self.submaps:8} "
            f"{self.purity:7.3f} {self.doors:>6} {self.error_m:8.3f}  {self.verdict}"
        )


def sensor(kind: str, number: int) -> tuple[SimulationOptions, bool]:
    """The robot that drives through a plan, and whether its log has odometry."""
    rng = np.random.default_rng([number, 2, list(BUILDINGS).index(kind)])
    options = SimulationOptions(
        field_of_view_deg=float(rng.choice(_DEGREES)),
        beams=int(rng.choice(_BEAMS)),
        range_max_m=float(rng.choice(_REACH_M)),
        noise_m=float(rng.choice(_NOISE_M)),
        odometry_drift=float(rng.choice(_DRIFT)),
        rate_hz=5.0,
        speed_mps=0.8,
        spacing_m=3.0,
        max_duration_s=400.0,
        seed=number,
    )
    return options, bool(number % 4)


def built(kind: str, number: int, plan: Drawing) -> Build:
    """Drive through a plan, build its map and score it."""
    options, measured = sensor(kind, number)
    tour = simulated_tour(plan.grid(), options)
    stamps = np.array([stamp_of(time) for time in tour.scan_times_s.tolist()])
    truth = Trajectory(stamps, tour.truth.at(tour.scan_times_s))
    with tempfile.TemporaryDirectory() as name:
        log, out = Path(name) / "log.mcap", Path(name) / "map"
        write((sweep for sweep, _ in tour.scans()), iter if measured else without_odometry, log)
        report = build_map([log], out)
        labels, found = read_map(out).labels, read_tum(out / "trajectory.tum")
    rows, at = associate(truth.stamps_ns, labels.stamps_ns)
    rooms = RoomTruth(plan.labels + 1, RESOLUTION_M, plan.grid().origin)
    scores = map_scores(rooms, truth.poses[at], labels.submaps[rows])
    return Build(
        options=options,
        measured=measured,
        rooms=len(scores.pieces),
        submaps=int(report.run["counts"]["submaps"]),
        purity=scores.purity,
        doors=f"{scores.found}/{scores.doors}",
        error_m=absolute(truth)(found),
        verdict=report.quality.verdict,
    )


def table(kind: str, plans: Iterable[tuple[int, Drawing]]) -> None:
    """Print a line a plan."""
    for number, plan in plans:
        print(built(kind, number, plan).line(kind, number), flush=True)

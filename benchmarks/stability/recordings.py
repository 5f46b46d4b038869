"""Recordings of one building that should all become the same map."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.data import log_file, plan
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.simulation.simulator import (
    SimulatedTour,
    SimulationOptions,
    simulated_tour,
    tour_along,
)

SEEDS = range(1, 6)
NOISES_M = (0.010, 0.011)
SAMPLE = SimulationOptions(beams=181, speed_mps=0.8, spacing_m=3.0, laps=2, seed=2)
TOUR = SimulationOptions(beams=361, rate_hz=5.0, speed_mps=0.8, spacing_m=3.0, seed=1)
PLANS = ("Freiburg79_scan_furnitures", "lab_c_scan", "office_a")
LOGS = ("fr079", "mit_csail")
BUILDINGS = ("sample office", *LOGS, *PLANS)
KINDS = ("seed", "noise", "reversed", "start", "tour")
_EARLIER = 1 / 3  # of the way: where a tour from another start begins


@dataclass(frozen=True, slots=True)
class Take:
    """A recording of a building and how its map is to be built.

    `sweeps` are those of the log. `references` (n, 3) are poses of the base at each of them in a
    frame that all takes of a building share, None where the first take's own map has to give them,
    by the numbers `sources` (n,) of the sweeps in its log.
    """

    kind: str
    name: str
    sweeps: Iterable[Sweep]
    seed: int = 0
    references: FloatArray | None = None
    sources: Sequence[int] = ()


def takes(building: str) -> Iterator[Take]:
    """The first take of a building, which the others are held against, and then these."""
    if building in LOGS:
        yield from _recorded(log_file(building))
    elif building == "sample office":
        yield from _simulated(read_grid("sample_logs/office.yaml"), SAMPLE)
    else:
        yield from _simulated(plan(building), TOUR)


def _simulated(world: GridMap, options: SimulationOptions) -> Iterator[Take]:
    """Tours of a plan: other errors of laser, wheels and build, other ways."""
    first = simulated_tour(world, options)
    path = first.truth.poses[:, :2]

    def along(way: FloatArray, **changes: float) -> SimulatedTour:
        return tour_along(
            way, first.world, options.model_copy(update=changes), area_m2=first.area_m2
        )

    yield _toured("base", "", first)
    for seed in SEEDS:
        yield _toured("seed", str(seed), along(path, seed=options.seed + seed), seed)
    for noise in NOISES_M:
        name = f"{1000 * noise:.0f} mm"
        yield _toured("noise", name, along(path, noise_m=noise, seed=options.seed + 10))
    yield _toured("reversed", "", along(path[::-1]))
    early = round(_EARLIER * len(path))
    yield _toured("start", "", along(np.concatenate([path[:early][::-1], path])))
    for seed in SEEDS[:2]:
        other = options.model_copy(update={"seed": options.seed + 20 + seed})
        yield _toured("tour", str(seed), simulated_tour(world, other))


def _toured(kind: str, name: str, tour: SimulatedTour, seed: int = 0) -> Take:
    sweeps = (sweep for sweep, _ in tour.scans())
    return Take(kind, name, sweeps, seed, tour.truth.at(tour.scan_times_s))


def _recorded(log: Path) -> Iterator[Take]:
    """A recorded log and what can honestly be made of it: nobody can drive it again.

    It is played backwards, as if the robot drove in reverse gear; and played backwards from a third
    of it to its beginning and then forwards to its end: so it begins elsewhere, without a jump.
    """
    with open_log([log]) as source:
        sweeps = list(SweepStream(source, LogConfig()))
    everything = list(range(len(sweeps)))
    yield Take("base", "", sweeps, sources=everything)
    for seed in SEEDS:
        yield Take("seed", str(seed), sweeps, seed, sources=everything)
    for noise in NOISES_M:
        name = f"{1000 * noise:.0f} mm"
        yield Take("noise", name, _noisy(sweeps, noise), sources=everything)
    early = round(_EARLIER * len(sweeps))
    for kind, order in (
        ("reversed", everything[::-1]),
        ("start", everything[:early][::-1] + everything[1:]),
    ):
        yield Take(kind, "", _played(sweeps, order), sources=order)


def _noisy(sweeps: Iterable[Sweep], noise_m: float) -> Iterator[Sweep]:
    """The sweeps with noise added to every range."""
    rng = np.random.default_rng(round(1e6 * noise_m))
    for sweep in sweeps:
        ranges = sweep.planar.ranges + rng.normal(0.0, noise_m, len(sweep.planar.ranges))
        yield replace(sweep, planar=replace(sweep.planar, ranges=ranges))


def _played(sweeps: Sequence[Sweep], order: Sequence[int]) -> Iterator[Sweep]:
    """The sweeps in another order, as long apart as they were."""
    stamp_ns, last = sweeps[0].stamp_ns, order[0]
    for index, number in enumerate(order):
        stamp_ns += abs(sweeps[number].stamp_ns - sweeps[last].stamp_ns)
        last = number
        planar = replace(sweeps[number].planar, stamp_ns=stamp_ns)
        yield replace(sweeps[number], index=index, stamp_ns=stamp_ns, planar=planar)

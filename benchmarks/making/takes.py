"""Recordings of one building that should all become the same map.

Each take is one variation of the first: noise of 10 mm (a simulated robot has other errors of the
wheels, too), the way backwards, another start or another way. Nobody can drive a recorded log
again: it is played backwards, as if the robot drove in reverse gear, and from a third of it to its
beginning and then to its end, without a jump.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.data import plan, recording
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour, tour_along

NOISE_M = 0.010
LOGS = ("fr079", "mit_csail")
OFFICE = SimulationOptions(beams=181, speed_mps=0.8, spacing_m=3.0, laps=2, seed=2)
TOUR = SimulationOptions(beams=361, rate_hz=5.0, speed_mps=0.8, spacing_m=3.0, seed=1)
_EARLIER = 1 / 3  # of the way: where a tour from another start begins


@dataclass(frozen=True, slots=True)
class Take:
    """The sweeps of a recording of a building."""

    kind: str
    sweeps: Iterable[Sweep]


def takes(building: str) -> Iterator[Take]:
    """The first take of a simulated building, and others; the others of a recorded one."""
    if building in LOGS:
        yield from _recorded(building)
    else:
        yield from _simulated(building, OFFICE if building == "office" else TOUR)


def _simulated(building: str, options: SimulationOptions) -> Iterator[Take]:
    """Tours of a plan: other errors of laser, wheels and build, other ways."""
    world = plan(building)
    first = simulated_tour(world, options)
    way = first.truth.poses[:, :2]
    ways = {
        "first": (way, options),
        "noise": (way, options.model_copy(update={"noise_m": NOISE_M, "seed": options.seed + 10})),
        "reversed": (way[::-1], options),
    }
    for kind, (along, chosen) in ways.items():
        tour = tour_along(along, first.world, chosen, area_m2=first.area_m2)
        yield Take(kind, (sweep for sweep, _ in tour.scans()))
    other = simulated_tour(world, options.model_copy(update={"seed": options.seed + 21}))
    yield Take("tour", (sweep for sweep, _ in other.scans()))


def _recorded(name: str) -> Iterator[Take]:
    with open_log([recording(name)]) as source:
        sweeps = list(SweepStream(source, LogConfig()))
    yield Take("noise", _noisy(sweeps))
    order = list(range(len(sweeps)))
    early = round(_EARLIER * len(sweeps))
    yield Take("reversed", _played(sweeps, order[::-1]))
    yield Take("start", _played(sweeps, order[:early][::-1] + order[1:]))


def _noisy(sweeps: Iterable[Sweep]) -> Iterator[Sweep]:
    """The sweeps with noise added to every range."""
    rng = np.random.default_rng(10_000)
    for sweep in sweeps:
        ranges = sweep.planar.ranges + rng.normal(0.0, NOISE_M, len(sweep.planar.ranges))
        yield replace(sweep, planar=replace(sweep.planar, ranges=ranges))


def _played(sweeps: Sequence[Sweep], order: Sequence[int]) -> Iterator[Sweep]:
    """The sweeps in another order, as long apart as they were."""
    stamp_ns, last = sweeps[0].stamp_ns, order[0]
    for index, number in enumerate(order):
        stamp_ns += abs(sweeps[number].stamp_ns - sweeps[last].stamp_ns)
        last = number
        planar = replace(sweeps[number].planar, stamp_ns=stamp_ns)
        yield replace(sweeps[number], index=index, stamp_ns=stamp_ns, planar=planar)

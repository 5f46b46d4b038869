"""Is a log from this map at all? Own rooms must be recognised, other buildings refused.

Maps of simulated tours: of one room, of two and of four in a row, and of the sample office, with
lasers of 180, 270 and 360 degrees. In each of them: another tour of the same world by another way,
with a laser of twice the beams; a robot that stands still at several places, so that its scans
differ by noise alone; and tours of all other worlds. Shares of scans that are called known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.localized import UNKNOWN, localized
from benchmarks.making.recordings import write
from benchmarks.making.tours import tour_options, world_of
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.maps.store import Map, read_map
from specmap_cli.simulation.simulator import simulated_tour

WORLDS = {"row-1-11": 270.0, "row-2-10": 360.0, "row-4-10": 180.0, "office": 180.0}
STANDING_SCANS, STANDING_PLACES = 40, 3
FOREIGN_S, RATE_HZ = 60.0, 4.0

ROWS = (
    Row("own", "another tour of the same world: known", 0.98, 1.0),
    Row("standing", "a robot that stands still: known", 0.98, 1.0),
    Row("foreign", "tours of other worlds: known, mean of 12 pairs", 0.05, 0.0, "less"),
    Row("worst", "tours of other worlds: known, the worst pair", 0.15, 0.0, "less"),
)


def measure(bench: Bench) -> Figures:
    """Ask the map of every world about its own logs and those of the others."""
    print(f"{'map':12} view  own    standing  foreign")
    own, standing, foreign = list[float](), list[float](), list[float]()
    for name, view in WORLDS.items():
        world = world_of(name)[0]
        sweeps = (sweep for sweep, _ in simulated_tour(world, tour_options(view, 1)).scans())
        map_ = read_map(bench.simulated(f"unknown-{name}", partial(write, sweeps, iter)))
        with bench.scratch(f"unknown-{name}") as folder:
            own.append(_share(map_, _tour(name, view, 8, 2 * int(view)), folder))
            places = _tour(name, view, 7, int(view))
            every = max(1, len(places) // STANDING_PLACES)
            standing += [
                _share(map_, list(still(place, k)), folder)
                for k, place in enumerate(places[::every][:STANDING_PLACES])
            ]
            others = [
                _share(map_, _tour(other, view, 5, int(view), FOREIGN_S), folder)
                for other in WORLDS
                if other != name
            ]
        foreign += others
        shares = " ".join(f"{share:.3f}" for share in others)
        stood = np.mean(standing[-STANDING_PLACES:])
        print(f"{name:12} {view:4.0f} {own[-1]:.3f} {stood:9.3f}  {shares}", flush=True)
    return {
        "own": float(np.mean(own)),
        "standing": float(np.mean(standing)),
        "foreign": float(np.mean(foreign)),
        "worst": max(foreign),
    }


def _tour(
    name: str, view: float, seed: int, beams: int, longest_s: float | None = None
) -> list[Sweep]:
    """The sweeps of a tour of a world."""
    options = tour_options(
        view, seed, spacing_m=2.0, beams=beams, rate_hz=RATE_HZ, max_duration_s=longest_s
    )
    return [sweep for sweep, _ in simulated_tour(world_of(name)[0], options).scans()]


def _share(map_: Map, sweeps: list[Sweep], folder: Path) -> float:
    """The share of scans whose filtered label is a submap."""
    log = folder / "log.mcap"
    write(sweeps, iter, log)
    said = localized(map_, log, folder)
    return 0.0 if said is None else float((said.filtered != UNKNOWN).mean())


def still(sweep: Sweep, seed: int) -> Iterator[Sweep]:
    """Sweeps of a robot that stands where one was taken: noise, and wheels that tremble."""
    rng = np.random.default_rng(seed)
    for k in range(STANDING_SCANS):
        stamp_ns = sweep.stamp_ns + k * 10**8
        ranges = sweep.planar.ranges + rng.normal(0.0, 0.01, len(sweep.planar.ranges))
        yield replace(
            sweep,
            index=k,
            stamp_ns=stamp_ns,
            planar=replace(sweep.planar, stamp_ns=stamp_ns, ranges=ranges),
            odom_from_base=Pose2(*rng.normal(0.0, (0.002, 0.002, 0.001)).tolist()),
        )

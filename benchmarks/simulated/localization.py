"""Another tour of a furnished plan in the map of the first, and a robot that is carried away.

The map is built of one simulated tour; a tour by another way is localised in it with `--metric`, by
the program. The true poses of the keyframes lay the map on the plan. Carried: half a tour is cut
out of the other log, so that the robot is elsewhere from one scan to the next, and its wheels tell
nothing of it; how many metres it drives until a pose is right again, and how many poses are wrong
meanwhile. What is right is in localized.py. A covariance holds when the error lies inside its 95 %.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from benchmarks.data import plan
from benchmarks.localized import HEADER, Localized, judged, localized, nearest, scored
from benchmarks.making.recordings import write
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.core.geometry import FloatArray, Pose2, compose, nearest_motion, travelled
from specmap_cli.core.records import IntArray, Sweep
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.maps.store import Map, read_map
from specmap_cli.simulation.simulator import SimulatedTour, SimulationOptions, simulated_tour

CASES = (("Freiburg79_scan_furnitures", 180.0), ("lab_c_scan_furnitures", 180.0))
CARRIED_AT = (1 / 8, 2 / 8, 3 / 8)  # of the tour: where the robot is picked up
_AROUND = 300  # scans before and after it is carried

ROWS = (
    Row("filtered", "another tour: filtered labels that are right, 2 plans", 0.97, 0.99),
    Row("raw", "labels of single scans that are right"),
    Row("poses", "poses within .1 m and 1 degree", 0.92, 0.98),
    Row("wrong", "wrong poses", 0.0, 0.0, "less", ".4f"),
    Row(
        "carried",
        "carried away: metres until a pose is right, the worst of 6",
        2.0,
        1.0,
        "less",
        ".1f",
    ),
    Row("carried_wrong", "carried away: wrong poses", 0.0, 0.0, "less", ".4f"),
)


@dataclass(frozen=True, slots=True)
class Driven:
    """A simulated tour: its sweeps, their stamps (n,) and true poses (n, 3) in the plan."""

    sweeps: Sequence[Sweep]
    stamps_ns: IntArray
    truth: FloatArray


def measure(bench: Bench) -> Figures:
    """Localise the other tour of each plan, whole and cut."""
    print(f"{'tour':27} {HEADER}")
    found, metres, wrong = [], list[float](), list[float]()
    for name, view in CASES:
        first = driven(name, view, 1, 3.0)
        make = partial(write, first.sweeps, iter)
        map_ = read_map(bench.simulated(f"localization-{name}", make))
        again = driven(name, view, 11, 2.6)
        map_from_plan = laid(map_, first)
        with bench.scratch(f"localization-{name}") as folder:
            said = _localized(map_, again.sweeps, folder)
            found.append(scored(map_, said, truth_of(said, again, map_from_plan)))
            print(f"{name:27} {found[-1]}", flush=True)
            for at in CARRIED_AT:
                cut = carried(again, at)
                said = _localized(map_, cut.sweeps, folder)
                late, share = after(said, cut, truth_of(said, cut, map_from_plan))
                metres.append(late)
                wrong.append(share)
                print(
                    f"    carried at {at:.3f}: right after {late:.1f} m, wrong {share:.3f}",
                    flush=True,
                )
    worst = max(math.inf if math.isnan(late) else late for late in metres)
    return {
        "filtered": float(np.mean([one.right for one in found])),
        "raw": float(np.mean([one.raw for one in found])),
        "poses": float(np.mean([one.poses for one in found])),
        "wrong": float(np.mean([one.wrong for one in found])),
        "carried": Figure(worst, note=f"median {np.nanmedian(metres):.1f}"),
        "carried_wrong": float(np.mean(wrong)),
    }


def driven(name: str, view: float, seed: int, spacing_m: float) -> Driven:
    """A tour of a plan with a beam a degree, five scans a second."""
    options = SimulationOptions(
        field_of_view_deg=view, beams=int(view), rate_hz=5.0, seed=seed, spacing_m=spacing_m
    )
    return of_tour(simulated_tour(plan(name), options))


def of_tour(tour: SimulatedTour) -> Driven:
    """The sweeps of a tour and their truth."""
    scans = list(tour.scans())
    stamps = np.array([sweep.stamp_ns for sweep, _ in scans], dtype=np.int64)
    return Driven([sweep for sweep, _ in scans], stamps, np.array([pose for _, pose in scans]))


def laid(map_: Map, first: Driven) -> Pose2:
    """Where the plan lies in the map, by the true poses of the keyframes."""
    keyframes, rows = associate(first.stamps_ns, map_.labels.stamps_ns)
    return nearest_motion(first.truth[rows, :2], map_.labels.poses[keyframes, :2])


def truth_of(said: Localized, tour: Driven, map_from_plan: Pose2) -> FloatArray:
    """(n, 3) the true poses of the scans, in the map."""
    rows = nearest(tour.stamps_ns, said.stamps_ns)
    return compose(np.array(map_from_plan), tour.truth[rows])


def _localized(map_: Map, sweeps: Sequence[Sweep], folder: Path) -> Localized:
    log = folder / "again.mcap"
    write(sweeps, iter, log)
    said = localized(map_, log, folder, "--metric")
    assert said is not None, "the laser of the map is not refused"
    return said


def carried(tour: Driven, at: float) -> Driven:
    """The tour as if the robot were carried half of it on, at a share of it."""
    count = len(tour.sweeps)
    first = int(at * count)
    before = slice(max(0, first - _AROUND), first)
    after_it = slice(first + count // 2, first + count // 2 + _AROUND)
    moved = list(pushed(tour.sweeps[first - 1], tour.sweeps[after_it]))
    sweeps = [*tour.sweeps[before], *moved]
    stamps = np.array([sweep.stamp_ns for sweep in sweeps], dtype=np.int64)
    return Driven(sweeps, stamps, np.concatenate([tour.truth[before], tour.truth[after_it]]))


def pushed(last: Sweep, sweeps: Sequence[Sweep]) -> Iterator[Sweep]:
    """The sweeps as if the wheels had not turned since the last one."""
    assert last.odom_from_base is not None
    assert sweeps[0].odom_from_base is not None
    back = last.odom_from_base @ sweeps[0].odom_from_base.inverse()
    behind_ns = sweeps[0].stamp_ns - last.stamp_ns - 200_000_000
    for sweep in sweeps:
        assert sweep.odom_from_base is not None
        stamp_ns = sweep.stamp_ns - behind_ns
        planar = replace(sweep.planar, stamp_ns=stamp_ns)
        yield replace(
            sweep, stamp_ns=stamp_ns, planar=planar, odom_from_base=back @ sweep.odom_from_base
        )


def after(said: Localized, cut: Driven, true: FloatArray) -> tuple[float, float]:
    """Metres from where the robot was set down to the first right pose, NaN for none; and wrong."""
    moved = len(cut.sweeps) - _AROUND
    later = said.stamps_ns >= cut.stamps_ns[moved]
    right, wrong = judged(said.poses[later], true[later])
    way = travelled(true[later])
    first = next(chain(np.flatnonzero(right).tolist(), (None,)))
    return float("nan") if first is None else float(way[first]), float(wrong.mean())

"""Whole builds of logs that are hard to map, held against the truth and against what they say.

Real and simulated logs, thinned by way and by time, with good, noisy and no odometry; spoiled
scans, holes, slipping wheels, a person, two lasers on one topic, zero stamps; bare corridors. Each
case has bounds for the share of lost scans and the metres off the truth. It keeps them; or it
tells, by its verdict or by an error, that it does not; or it misses. Last, the sample log is
written with its beams in reverse order and with its laser upside down: the readings are the same,
and so should the map be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.data import SAMPLES, plan
from benchmarks.making import spoiling as s
from benchmarks.making.recordings import (
    Recording,
    recorded,
    simulated,
    two_lasers,
    without_stamps,
    write_turned,
)
from benchmarks.making.worlds import corridors, drive_along
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.cli.options import Settings
from specmap_cli.core.errors import SpecmapError
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.build import build_map
from specmap_cli.simulation.simulator import (
    OdometryErrors,
    SimulatedTour,
    simulated_tour,
    simulation_options,
)

NOISY = OdometryErrors(distance_scale=0.05, turn_scale=0.05, veer_per_m=0.01)

ROWS = (
    Row("kept", "cases that keep their bounds, of 22", form=".0f"),
    Row("missed", "cases that miss them and do not say so", 0, 0, "less", ".0f"),
    Row(
        "moved",
        "beams in another order, laser upside down: largest move",
        2.0,
        0.1,
        "less",
        ".1f",
        "mm",
    ),
)


@dataclass(frozen=True, slots=True)
class Case:
    """A log to be made, and the bounds it must keep: share of lost scans and metres off."""

    name: str
    make: Callable[[Path], Recording]
    lost: float = 0.02
    error_m: float = 0.3
    settings: tuple[str, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a case; `said` is its error, if it ended with one.

    `doubts` are the codes of the findings that make its map doubtful or poor.
    """

    scans: int = 0
    lost: int = 0
    error_m: float = math.nan
    verdict: str = ""
    said: str = ""
    doubts: tuple[str, ...] = ()

    def result(self, case: Case) -> str:
        """`kept`, `told`, or what was missed."""
        if self.said:
            return f"told: {self.said[:100]}"
        share = self.lost / max(1, self.scans)
        missed = []
        if share > case.lost:
            missed.append(f"lost {share:.1%} > {case.lost:.1%}")
        if not self.error_m <= case.error_m:
            missed.append(f"error > {case.error_m:g} m")
        if not missed:
            return "kept"
        told = self.verdict in ("doubtful", "poor")
        return f"{'told' if told else 'MISSED'}: {'; '.join(missed)}"


def measure(bench: Bench) -> Figures:
    """A line a case."""
    tally = {"kept": 0, "told": 0, "MISSED": 0}
    print(f"{'case':46} {'scans':>6} {'lost':>6} {'error m':>8} {'verdict':>9}  result")
    for number, case in enumerate(cases()):
        with bench.scratch(f"hard_logs-{number}") as folder:
            found = outcome(case, folder)
        result = found.result(case)
        tally[result.partition(":")[0]] += 1
        print(
            f"{case.name:46} {found.scans:6} {found.lost / max(1, found.scans):6.1%} "
            f"{found.error_m:8.3f} {found.verdict:>9}  {result}",
            flush=True,
        )
    with bench.scratch("hard_logs-turned") as folder:
        moved = turned(folder)
    return {"kept": tally["kept"], "missed": tally["MISSED"], "moved": 1000 * moved}


def outcome(case: Case, folder: Path) -> Outcome:
    """Make the log of a case, build its map, and hold it against the truth."""
    recording = case.make(folder / "log.mcap")
    config = Settings(assignments=list(case.settings)).load()
    try:
        report = build_map([recording.log], folder / "map", config)
    except SpecmapError as error:
        return Outcome(said=str(error))
    counts = report.run["counts"]
    return Outcome(
        scans=counts["scans"],
        lost=counts["lost"],
        error_m=recording.score(read_tum(folder / "map" / "trajectory.tum")),
        verdict=report.quality.verdict,
        doubts=tuple(one.code for one in report.quality.findings if one.severity != "note"),
    )


def cases() -> Iterator[Case]:
    """All of them."""
    half = s.every_metres(0.5)
    blind = s.chained(half, s.without_odometry)
    yield Case("fr079 every 0.5 m, no odometry", partial(recorded, "fr079", blind))
    noisy = s.chained(s.noisier(NOISY), half)
    yield Case("fr079 every 0.5 m, noisy odometry", partial(recorded, "fr079", noisy))
    yield Case("fr079 at 1 Hz", partial(recorded, "fr079", s.every_seconds(1.0)))
    yield Case("mit_csail every 0.5 m", partial(recorded, "mit_csail", half))
    yield Case("mit_csail every 0.5 m, no odometry", partial(recorded, "mit_csail", blind))
    for name, start_s in (("fr079", 450.0), ("mit_csail", 150.0)):
        hole = s.chained(s.dropped(start_s, 90.0), s.without_odometry)
        yield Case(f"{name} with a hole of 90 s, no odometry", partial(recorded, name, hole))
    yield tour("every 0.5 m, no odometry", blind)
    rare = s.chained(s.noisier(NOISY), s.every_seconds(1.0))
    yield tour("at 1 Hz, odometry 5 % off", rare, drift=0.0, error_m=0.25)
    yield tour("every metre, usual odometry", s.every_metres(1.0))
    yield tour("first five scans spoiled", s.first_scans_spoiled(5))
    yield tour("5 s dropped", s.dropped(60.0, 5.0))
    yield tour("wheels slip for 5 s", s.slipping(60.0, 5.0, 3.0))
    yield tour("carried off seven times", s.carried_off(400.0, 7))
    yield tour("a person walks beside", s.accompanied(40.0, 120.0, 0.8, 0.6))
    yield Case("office, two lasers on one topic", pair)
    chosen = ("log.scan_frame=laser_0",)
    yield Case("office, two lasers on one topic, one chosen", pair, settings=chosen)
    yield Case("office, zero stamps", timeless)
    for what, niches in (("bare", None), ("with niches", 4.0)):
        for odometry, spoil in (("no", s.without_odometry), ("usual", iter)):
            make = partial(corridor_loop, niches, spoil)
            yield Case(f"60 m of corridors, {what}, {odometry} odometry", make, error_m=0.5)


def tour(what: str, spoil: s.Spoiling, *, drift: float = 1.0, error_m: float = 0.3) -> Case:
    """A tour of the sample office, whose odometry errs `drift` times as much as usual, spoiled."""

    def make(path: Path) -> Recording:
        return simulated(tour_of(odometry_drift=drift), spoil, path)

    return Case(f"office, {what}", make, error_m=error_m)


def tour_of(**options: object) -> SimulatedTour:
    """A tour of two laps through the sample office."""
    chosen: dict[str, object] = {"beams": 361, "speed_mps": 0.8, "spacing_m": 3.0, "laps": 2}
    return simulated_tour(plan("office"), simulation_options(**{**chosen, "seed": 3, **options}))


def timeless(path: Path) -> Recording:
    """A tour whose stamps are all 0; a CARMEN line of 361 beams is one of 180 degrees."""
    return without_stamps(tour_of(field_of_view_deg=180.0), path.with_suffix(".log"))


def pair(path: Path) -> Recording:
    """One laser looks ahead, one back."""
    return two_lasers(tour_of(), tour_of(laser_x_m=-0.2, laser_yaw_deg=180.0), path)


def corridor_loop(niche_every_m: float | None, spoil: s.Spoiling, path: Path) -> Recording:
    """One and a half laps of a loop that a laser of short sight sees little of."""
    corners = ((0.0, 0.0), (22.0, 0.0), (22.0, 8.0), (0.0, 8.0))
    driven = drive_along(
        corridors(tuple(zip(corners, (*corners[1:], corners[0]), strict=True)), 2.0, niche_every_m),
        (*corners, *corners[:3]),
        range_max_m=8.0,
        rate_hz=8.0,
        speed_mps=0.7,
        errors=OdometryErrors(),
    )
    return simulated(driven, spoil, path)


def turned(folder: Path) -> float:
    """The largest distance in metres between the poses of three maps that should be one."""
    poses = {}
    for how in ("as it is", "reversed", "upside down"):
        log, out = folder / "log.mcap", folder / how.replace(" ", "_")
        write_turned(SAMPLES / "office.mcap", how, log)
        build_map(log, out)
        poses[how] = read_tum(out / "trajectory.tum").poses
        off = np.hypot(*(poses[how] - poses["as it is"])[:, :2].T).max()
        print(f"sample office, beams {how}: moved by {1000 * off:.2f} mm", flush=True)
    first = poses.pop("as it is")
    return max(float(np.hypot(*(other - first)[:, :2].T).max()) for other in poses.values())

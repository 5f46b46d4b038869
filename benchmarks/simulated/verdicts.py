"""Does a map know when it is wrong? Good and spoiled recordings, and the verdicts of their maps.

Tours of simulated buildings, as they are and spoiled in ten ways. The truth says whether a map is
right: no more than 0.3 m off (root mean square), no more than 5 % of its scans lost.

The verdict of a wrong map is right when it is doubtful or poor. That of a right map is right when
it is good. One thing more counts as right, but only for spoiled recordings: `doubtful` on a right
map, if every finding that makes it so is true of what was done to the recording (`TRUE`). Odometry
of another robot does disagree with a right map, and after 30 s without scans nothing does show
where a robot was. A right map that is called poor counts as wrong always.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.data import plan
from benchmarks.making import spoiling as s
from benchmarks.making.recordings import Recording, simulated
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from benchmarks.simulated.hard_logs import Case, Outcome, outcome
from specmap_cli.simulation.simulator import simulated_tour, simulation_options

PLANS = ("lab_a_scan", "office_c", "Freiburg52_scan_furnitures", "office_a_furnitures")
GOOD = 6
RATE_HZ = 5  # scans a second
RIGHT_M, RIGHT_LOST = 0.3, 0.05
# Classifiers are of no interest here.
QUICK = ("recognition.rounds=5", "localization.augmentation=20", "localization.track_samples=20")
AS_IT_IS = "as it is"

SPOILED: dict[str, s.Spoiling] = {
    "kidnapped": s.kidnapped(60.0, 30.0),
    "a scan every 2 s, no odometry": s.chained(s.every_seconds(2.0), s.without_odometry),
    "odometry of another robot": s.foreign_odometry(-1.0),
    "laser upside down": s.mirrored,
    "angles stretched": s.stretched(1.15),
    "laser turned by 30 degrees": s.misplaced_laser(0.0, 0.52),
    "crowd": s.crowded(0.8),
    "laser hangs for 15 s": s.frozen(60.0, 15.0),
    "odometry 2 s late": s.late_odometry(2 * RATE_HZ),
    "first 10 s spoiled, 20 s dropped": s.chained(
        s.first_scans_spoiled(10 * RATE_HZ), s.dropped(60.0, 20.0), s.without_odometry
    ),
    "laser 1 m ahead": s.misplaced_laser(1.0, 0.0),
}
# Findings that are true of a recording spoiled so, though its map may be right. That scans were
# lost is true whenever it is said. Odometry that turns the other way cannot be told from a laser
# upside down: the finding of a laser misplaced names both.
TRUE: dict[str, frozenset[str]] = {
    "kidnapped": frozenset({"hole-in-log"}),
    "a scan every 2 s, no odometry": frozenset({"unmeasured-way"}),
    "odometry of another robot": frozenset({"odometry-disagrees", "laser-misplaced"}),
    "laser turned by 30 degrees": frozenset({"laser-misplaced"}),
    "laser 1 m ahead": frozenset({"laser-misplaced"}),
    "odometry 2 s late": frozenset({"odometry-disagrees"}),
    "first 10 s spoiled, 20 s dropped": frozenset({"hole-in-log", "unmeasured-way"}),
}
ALWAYS_TRUE = frozenset({"lost-scans"})

ROWS = (
    Row("right", "verdicts that are right, 17 recordings", 0.97, 1.0),
    Row("strict", "the same, when every right map must be good"),
    Row("wrong_good", "wrong maps called good", 0, 0, "less", ".0f"),
)


@dataclass(frozen=True, slots=True)
class Trial:
    """A recording, and what was done to it."""

    case: Case
    what: str

    def is_strict(self, found: Outcome) -> bool:
        """Whether a verdict is right: good on a right map, anything else on a wrong one."""
        if found.said:
            return self.what != AS_IT_IS
        return is_right(found) == (found.verdict == "good")

    def is_fair(self, found: Outcome) -> bool:
        """The same, or doubtful on a right map for what is true of a spoiled recording."""
        if self.is_strict(found):
            return True
        true = TRUE.get(self.what, frozenset()) | ALWAYS_TRUE
        spoiled, doubtful = self.what != AS_IT_IS, found.verdict == "doubtful"
        return spoiled and doubtful and is_right(found) and set(found.doubts) <= true


def measure(bench: Bench) -> Figures:
    """A line a recording."""
    strict = fair = wrong_good = total = 0
    print(f"{'case':58} {'lost':>6} {'error m':>8} {'map':>6} {'verdict':>9}")
    for number, trial in enumerate(trials()):
        with bench.scratch(f"verdicts-{number}") as folder:
            found = outcome(trial.case, folder)
        right, verdict, total = is_right(found), found.verdict or "error", total + 1
        strict += trial.is_strict(found)
        fair += trial.is_fair(found)
        wrong_good += not found.said and not right and verdict == "good"
        print(
            f"{trial.case.name:58} {found.lost / max(1, found.scans):6.1%} {found.error_m:8.3f} "
            f"{'right' if right else 'wrong':>6} {verdict:>9}  {', '.join(found.doubts)}"
            f"{'' if trial.is_fair(found) else '  MISSED'}",
            flush=True,
        )
    return {
        "right": Figure(fair / total, note=f"{fair} of {total}"),
        "strict": Figure(strict / total, note=f"{strict} of {total}"),
        "wrong_good": wrong_good,
    }


def trials() -> Iterator[Trial]:
    """A tour spoiled in each of the eleven ways, and good ones, of the plans in turn."""
    for number, (what, spoil) in enumerate(SPOILED.items()):
        yield trial(PLANS[number % len(PLANS)], 100 + number, what, spoil)
    for number in range(GOOD):
        yield trial(PLANS[number % len(PLANS)], number, AS_IT_IS, iter)


def trial(name: str, seed: int, what: str, spoil: s.Spoiling) -> Trial:
    """One recording of a plan."""
    make = partial(tour, name, seed, spoil)
    return Trial(Case(f"{name}, seed {seed}: {what}", make, settings=QUICK), what)


def tour(name: str, seed: int, spoil: s.Spoiling, path: Path) -> Recording:
    """Two laps; the seed also chooses among lasers."""
    options = simulation_options(
        field_of_view_deg=(180.0, 270.0, 360.0)[seed % 3],
        beams=(181, 541, 360)[seed % 3],
        range_max_m=(8.0, 20.0, 12.0)[seed // 3 % 3],
        rate_hz=RATE_HZ,
        speed_mps=0.8,
        spacing_m=3.0,
        laps=2,
        max_duration_s=300.0,
        seed=seed,
    )
    return simulated(simulated_tour(plan(name), options), spoil, path)


def is_right(found: Outcome) -> bool:
    """Whether the truth says that the map can be used."""
    return found.error_m <= RIGHT_M and found.lost <= RIGHT_LOST * found.scans

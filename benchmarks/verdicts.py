"""Does a map know when it is wrong? Good and spoiled recordings, and the verdicts of their maps.

    python -m benchmarks.verdicts [--part development|test] [--only TEXT ...] [--set KEY=VALUE ...]

Tours of simulated buildings, as they are and spoiled in ten ways. The truth says whether a map is
right: no more than 0.3 m off (root mean square), no more than 5 % of its scans lost.

How a verdict is counted: that of a wrong map is right when it is doubtful or poor. That of a right
map is right when it is good. One thing more is counted as right, but only for spoiled recordings:
`doubtful` on a right map, if every finding that makes it so is true of what was done to the
recording (`TRUE`). Odometry of another robot does disagree with a right map, and after 30 s
without scans nothing does show where a robot was. Such a map came out right in spite of its
recording; whoever reads the finding learns something true and can mend it. A right map that is
called poor counts as wrong always. The strict count, in which every right map must be good, is
printed beside it.

The thresholds were set on the plans of `development`; those of `test` were not looked at for that.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.data import plan
from benchmarks.hard_logs import spoiling as s
from benchmarks.hard_logs.__main__ import Outcome, outcome
from benchmarks.hard_logs.cases import Case
from benchmarks.hard_logs.recordings import Recording, simulated
from specmap_cli.simulation.simulator import simulated_tour, simulation_options

PLANS = {
    "development": ("lab_a_scan", "office_c", "Freiburg52_scan_furnitures", "office_a_furnitures"),
    "test": ("lab_c_scan_furnitures", "office_e", "Freiburg79_scan", "lab_intel"),
}
SEEDS = range(10)  # good maps of each plan
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
    "laser turned by 30 degrees": s.turned_laser(0.52),
    "crowd": s.crowded(0.8),
    "laser hangs for 15 s": s.frozen(60.0, 15.0),
    "odometry 2 s late": s.late_odometry(2 * RATE_HZ),
    "first 10 s spoiled, 20 s dropped": s.chained(
        s.first_scans_spoiled(10 * RATE_HZ), s.dropped(60.0, 20.0), s.without_odometry
    ),
}
# Findings that are true of a recording spoiled so, though its map may be right. That scans were
# lost is true whenever it is said.
TRUE: dict[str, frozenset[str]] = {
    "kidnapped": frozenset({"hole-in-log"}),
    "a scan every 2 s, no odometry": frozenset({"unmeasured-way"}),
    "odometry of another robot": frozenset({"odometry-disagrees"}),
    "laser turned by 30 degrees": frozenset({"odometry-disagrees"}),
    "odometry 2 s late": frozenset({"odometry-disagrees"}),
    "first 10 s spoiled, 20 s dropped": frozenset({"hole-in-log", "unmeasured-way"}),
}
ALWAYS_TRUE = frozenset({"lost-scans"})


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", choices=sorted(PLANS), default="development")
    parser.add_argument("--only", action="append", default=[], help="cases with this in their name")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    arguments = parser.parse_args()
    tally: Counter[tuple[bool, str]] = Counter()
    strict = fair = 0
    print(f"{'case':62} {'lost':>6} {'error m':>8} {'map':>6} {'verdict':>9}")
    for trial in trials(arguments.part):
        if not all(text in trial.case.name for text in arguments.only):
            continue
        with tempfile.TemporaryDirectory() as name:
            found = outcome(trial.case, Path(name), arguments.settings)
        right, verdict = is_right(found), found.verdict or "error"
        tally[right, verdict] += 1
        strict += trial.is_strict(found)
        fair += trial.is_fair(found)
        print(
            f"{trial.case.name:62} {found.lost / max(1, found.scans):6.1%} {found.error_m:8.3f} "
            f"{'right' if right else 'wrong':>6} {verdict:>9}  {', '.join(found.doubts)}"
            f"{'' if trial.is_fair(found) else '  MISSED'}",
            flush=True,
        )
    report(tally, strict, fair)


def trials(part: str) -> Iterator[Trial]:
    """Ten good tours of each plan, and one of each spoiled in ten ways.

    They take turns: whatever piece of the list is run, it has good and spoiled tours of all plans.
    """
    for number in SEEDS:
        for place, name in enumerate(PLANS[part]):
            turn = (number + 3 * place) % len(SPOILED)
            what = tuple(SPOILED)[turn]
            yield trial(name, 100 + turn, what, SPOILED[what])
            yield trial(name, turn, AS_IT_IS, iter)


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
        max_duration_s=400.0,
        seed=seed,
    )
    return simulated(simulated_tour(plan(name), options), spoil, path)


def is_right(found: Outcome) -> bool:
    """Whether the truth says that the map can be used."""
    return found.error_m <= RIGHT_M and found.lost <= RIGHT_LOST * found.scans


def report(tally: Counter[tuple[bool, str]], strict: int, fair: int) -> None:
    """How many maps are right and wrong, what they were called, and how often that is right."""
    for right in (True, False):
        counts = {verdict: count for (is_, verdict), count in tally.items() if is_ == right}
        told = ", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items()))
        print(f"{sum(counts.values())} maps are {'right' if right else 'wrong'}: {told}")
    total = sum(tally.values())
    print(
        f"{fair} of {total} verdicts are right ({fair / max(1, total):.0%}); "
        f"{strict} when every right map must be good ({strict / max(1, total):.0%})"
    )


if __name__ == "__main__":
    main()

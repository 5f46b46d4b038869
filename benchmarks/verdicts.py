"""Does a map know when it is wrong? Good and spoiled recordings, and the verdicts of their maps.

    python -m benchmarks.verdicts [--part development|test] [--only TEXT ...] [--set KEY=VALUE ...]

Tours of simulated buildings, as they are and spoiled in ten ways. The truth says whether a map is
right: no more than 0.3 m off (root mean square), no more than 5 % of its scans lost. A verdict is
right when a right map is called good, and a wrong one doubtful or poor. The thresholds were set on
the plans of `development`; those of `test` were not looked at for that.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
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
RIGHT_M, RIGHT_LOST = 0.3, 0.05
# Classifiers are of no interest here.
QUICK = ("recognition.rounds=5", "localization.augmentation=20", "localization.track_samples=20")

SPOILED: dict[str, s.Spoiling] = {
    "kidnapped": s.kidnapped(60.0, 30.0),
    "a scan every 2 s, no odometry": s.chained(s.every_seconds(2.0), s.without_odometry),
    "odometry of another robot": s.foreign_odometry(-1.0),
    "laser upside down": s.mirrored,
    "angles stretched": s.stretched(1.15),
    "laser turned by 30 degrees": s.turned_laser(0.52),
    "crowd": s.crowded(0.8),
    "laser hangs for 15 s": s.frozen(60.0, 15.0),
    "odometry 2 s late": s.late_odometry(20),
    "first 10 s spoiled, 20 s dropped": s.chained(
        s.first_scans_spoiled(100), s.dropped(60.0, 20.0), s.without_odometry
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", choices=sorted(PLANS), default="development")
    parser.add_argument("--only", action="append", default=[], help="cases with this in their name")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    arguments = parser.parse_args()
    tally: Counter[tuple[bool, str]] = Counter()
    print(f"{'case':62} {'lost':>6} {'error m':>8} {'map':>6} {'verdict':>9}")
    for case in cases(arguments.part):
        if not all(text in case.name for text in arguments.only):
            continue
        with tempfile.TemporaryDirectory() as name:
            found = outcome(case, Path(name), arguments.settings)
        right, verdict = is_right(found), found.verdict or "error"
        tally[right, verdict] += 1
        print(
            f"{case.name:62} {found.lost / max(1, found.scans):6.1%} {found.error_m:8.3f} "
            f"{'right' if right else 'wrong':>6} {verdict:>9}",
            flush=True,
        )
    report(tally)


def cases(part: str) -> list[Case]:
    """Ten good tours of each plan, and one of each spoiled in ten ways."""
    good = [(name, seed, "as it is", iter) for name in PLANS[part] for seed in SEEDS]
    spoiled = [
        (name, 100 + number, what, spoil)
        for name in PLANS[part]
        for number, (what, spoil) in enumerate(SPOILED.items())
    ]
    return [
        Case(f"{name}, seed {seed}: {what}", partial(tour, name, seed, spoil), settings=QUICK)
        for name, seed, what, spoil in (*good, *spoiled)
    ]


def tour(name: str, seed: int, spoil: s.Spoiling, path: Path) -> Recording:
    """Two laps; the seed also chooses among lasers."""
    options = simulation_options(
        field_of_view_deg=(180.0, 270.0, 360.0)[seed % 3],
        beams=(181, 541, 360)[seed % 3],
        range_max_m=(8.0, 20.0, 12.0)[seed // 3 % 3],
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


def report(tally: Counter[tuple[bool, str]]) -> None:
    """How many verdicts are right, and which are not."""
    for right in (True, False):
        counts = {verdict: count for (is_, verdict), count in tally.items() if is_ == right}
        told = ", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items()))
        print(f"{sum(counts.values())} maps are {'right' if right else 'wrong'}: {told}")
    fits = sum(count for (right, verdict), count in tally.items() if right == (verdict == "good"))
    total = sum(tally.values())
    print(f"{fits} of {total} verdicts are right ({fits / max(1, total):.0%})")


if __name__ == "__main__":
    main()

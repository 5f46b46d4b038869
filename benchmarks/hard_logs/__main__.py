"""Whole builds of logs that are hard to map, held against the truth and against what they say.

    python -m benchmarks.hard_logs [--only TEXT ...] [--set KEY=VALUE ...] [--keep DIR] [--list]

Each line: scans, the share that was lost, breaks of the tracking, metres off the truth, the verdict
that the map gives itself, seconds of processor time, of these the seconds of the layout with its
audit, and whether the bounds of the case are kept.
`told` is a case that misses its bounds, and says so by its verdict or by an error.
"""

from __future__ import annotations

import argparse
import math
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.hard_logs.cases import Case, cases
from specmap_cli.cli.options import Settings
from specmap_cli.core.errors import SpecmapError
from specmap_cli.evaluation.trajectories import read_tum
from specmap_cli.pipelines.build import build_map

HEADER = (
    f"{'case':52} {'scans':>6} {'lost':>6} {'breaks':>6} {'error m':>8} {'verdict':>9} "
    f"{'s':>6} {'layout':>6}  result"
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a case; `said` is its error, if it ended with one.

    `doubts` are the codes of the findings that make its map doubtful or poor.
    """

    scans: int = 0
    lost: int = 0
    breaks: int = 0
    error_m: float = math.nan
    verdict: str = ""
    said: str = ""
    doubts: tuple[str, ...] = ()
    layout_s: float = 0.0

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
        return (
            f"{'told' if self.verdict in ('doubtful', 'poor') else 'MISSED'}: {'; '.join(missed)}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", action="append", default=[], help="cases with this in their name")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("--keep", type=Path, help="a folder for the logs and maps")
    parser.add_argument("--list", action="store_true", help="only name the cases")
    arguments = parser.parse_args()
    chosen = [case for case in cases() if all(text in case.name for text in arguments.only)]
    if arguments.list:
        print("\n".join(case.name for case in chosen))
        return
    print(HEADER)
    tally = {"kept": 0, "told": 0, "MISSED": 0}
    for case in chosen:
        with tempfile.TemporaryDirectory() as name:
            folder = arguments.keep / plain(case.name) if arguments.keep else Path(name)
            folder.mkdir(parents=True, exist_ok=True)
            before = seconds()
            found = outcome(case, folder, arguments.settings)
            spent, result = seconds() - before, found.result(case)
        tally[result.partition(":")[0]] += 1
        print(
            f"{case.name:52} {found.scans:6} {found.lost / max(1, found.scans):6.1%} "
            f"{found.breaks:6} {found.error_m:8.3f} {found.verdict:>9} {spent:6.1f} "
            f"{found.layout_s:6.1f}  {result}",
            flush=True,
        )
    print(", ".join(f"{count} {name}" for name, count in tally.items()))


def outcome(case: Case, folder: Path, settings: Sequence[str]) -> Outcome:
    """Make the log of a case, build its map, and hold it against the truth."""
    recording = case.make(folder / "log.mcap")
    config = Settings(assignments=[*case.settings, *settings]).load()
    try:
        report = build_map([recording.log], folder / "map", config, overwrite=True)
    except SpecmapError as error:
        return Outcome(said=str(error))
    counts = report.run["counts"]
    return Outcome(
        scans=counts["scans"],
        lost=counts["lost"],
        breaks=counts["breaks"],
        error_m=recording.score(read_tum(folder / "map" / "trajectory.tum")),
        verdict=report.quality.verdict,
        layout_s=sum(report.run["seconds"].get(stage, 0.0) for stage in ("layout", "audit")),
        doubts=tuple(one.code for one in report.quality.findings if one.severity != "note"),
    )


def plain(name: str) -> str:
    """A name for a folder."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def seconds() -> float:
    """Processor time of this process and its children."""
    uses = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(use.ru_utime + use.ru_stime for use in uses)


if __name__ == "__main__":
    main()

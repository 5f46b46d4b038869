"""The summary of a run: failures by kind, each with the command that repeats its first case."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from fuzz.cases import LogCase, case_of
from fuzz.judging import log_commands, map_commands
from fuzz.map_changes import write_map
from fuzz.seeds import Seeds, settings, write_intact
from fuzz.workers import Outcome

_NUMBER = re.compile(r"\d+")


class Tally:
    """Outcomes counted as they come in."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.cases = 0
        self.failed = 0
        self.cpu_s = 0.0
        self._groups: dict[tuple[str, str], list[Outcome]] = {}

    def add(self, outcome: Outcome) -> None:
        """Take in the outcome of a case."""
        self.cases += 1
        self.failed += bool(outcome.failures)
        self.cpu_s += outcome.cpu_s
        for failure in outcome.failures:
            key = (failure.kind, _NUMBER.sub("N", failure.what))
            self._groups.setdefault(key, []).append(outcome)

    def kinds(self) -> dict[str, int]:
        """How many failures there are of each kind."""
        found: dict[str, int] = {}
        for (kind, _), outcomes in self._groups.items():
            found[kind] = found.get(kind, 0) + len(outcomes)
        return found

    def progress(self, wall_s: float) -> str:
        """One line on how far it is."""
        return f"{self.cases:,} cases, {self.failed:,} failed, {wall_s:.0f} s"

    def lines(self, wall_s: float) -> list[str]:
        """The summary."""
        each = 1000.0 * self.cpu_s / max(self.cases, 1)
        told = [
            f"{self.cases:,} cases of seed {self.seed}: {self.failed:,} failed; "
            f"{wall_s:.0f} s, {each:.0f} ms of processor time a case"
        ]
        for (kind, what), outcomes in sorted(
            self._groups.items(), key=lambda group: (group[0][0], -len(group[1]))
        ):
            first = min(outcomes, key=lambda outcome: outcome.number)
            told.append(f"{kind}: {len(outcomes)} x {what}")
            told.append(f"    {first.name}: {'; '.join(first.notes)}")
            told.append(f"    python -m fuzz --seed {self.seed} --case {first.number}")
        return told


def case_lines(seeds: Seeds, seed: int, number: int, keep: Path | None) -> list[str]:
    """What a case is; its damaged input goes to `keep`, with the commands that were run on it."""
    case = case_of(seeds, seed, number)
    told = [f"case {number}, {case.name}: {'; '.join(case.notes)}"]
    if keep is None:
        return [*told, "--keep DIR keeps its input"]
    keep.mkdir(parents=True, exist_ok=True)
    if isinstance(case, LogCase):
        (keep / "log").write_bytes(case.data)
        commands = list(log_commands(case, keep, settings()))
    else:
        write_intact(seeds, keep)
        write_map(keep / "damaged", case.files, list(case.deeds))
        commands = list(map_commands(case, keep, keep))
    return [*told, *(shlex.join(["specmap", *command]) for command in commands)]

"""Rules: which figures of a map have bounds, and whether a map keeps within them.

A file of rules is TOML. What it says goes over the rules that hold by default; an infinite bound
takes a default away, and `defaults = false` all of them::

    verdict = "good"          # the worst verdict that passes

    [most]
    lost_share = 0.01
    findings.walls-disagree = 0

    [least]
    submaps = 5
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

from specmap_cli.checking.figures import GOLDEN, MEANINGS, is_figure
from specmap_cli.core.errors import SETTING, UsageError
from specmap_cli.core.findings import VERDICTS, Verdict
from specmap_cli.core.tomltext import read_toml

Bound = Literal["most", "least"]
BOUNDS: tuple[Bound, ...] = ("most", "least")


@dataclass(frozen=True, slots=True)
class Rules:
    """The worst `verdict` that passes, and what figures may be at `most` and must be at `least`."""

    verdict: Verdict
    most: Mapping[str, float]
    least: Mapping[str, float]

    def each(self) -> Iterator[tuple[str, Bound, float]]:
        """Every bound: the name of the figure, which bound it is, and its value."""
        for bound in BOUNDS:
            for name, limit in getattr(self, bound).items():
                yield name, bound, limit


# What a fleet wants of every map: nothing in doubt, and the building as it was. What is doubtful
# is found while the map is made: docs/quality.md lists the codes and their limits.
DEFAULTS = Rules(
    verdict="doubtful",
    most={
        "lost_share": 0.05,
        "parts": 1,
        "findings.lost-scans": 0,
        "findings.hole-in-log": 0,
        "findings.unmeasured-way": 0,
        "findings.odometry-disagrees": 0,
        "findings.loose-part": 0,
        "findings.walls-disagree": 0,
        "findings.part-moved": 0,
        "findings.rival-place": 0,
        "findings.layout-refused": 0,
        "findings.beyond-grid": 0,
        "golden.gone": 0,
        "golden.unseen": 0,
        "golden.closed": 0,
        "golden.off_m": 0.15,
    },
    least={"submaps": 1, "golden.aligned": 1, "golden.area_share": 0.9},
)


def read_rules(path: Path | None, *, against: bool) -> Rules:
    """The rules in force: those of the file `path` over the defaults.

    Rules of `golden.` figures hold only `against` another map. Raises UsageError for a file that
    cannot be read, a rule of no figure, and one that needs another map where there is none.
    """
    written = {} if path is None else read_toml(path)
    where = f"{path}: "
    for key in written:
        if key not in ("defaults", "verdict", *BOUNDS):
            raise UsageError(
                f"{where}{key}: no such key: use defaults, verdict, most and least", code=SETTING
            )
    bounds = {bound: _bounds(written.get(bound, {}), bound, where) for bound in BOUNDS}
    if not against:
        for bound, found in bounds.items():
            for name in found:
                if name.startswith(GOLDEN):
                    raise UsageError(
                        f"{where}{bound}.{name}: needs another map: give --against", code=SETTING
                    )
    base = DEFAULTS if _wants_defaults(written, where) else Rules("poor", {}, {})
    most, least = (
        {
            name: limit
            for name, limit in {**getattr(base, bound), **bounds[bound]}.items()
            if math.isfinite(limit) and (against or not name.startswith(GOLDEN))
        }
        for bound in BOUNDS
    )
    return Rules(_verdict(written, base, where), most, least)


def _wants_defaults(written: Mapping[str, Any], where: str) -> bool:
    wanted = written.get("defaults", True)
    if not isinstance(wanted, bool):
        raise UsageError(f"{where}defaults is {wanted!r:.60}: expected true or false", code=SETTING)
    return wanted


def _verdict(written: Mapping[str, Any], base: Rules, where: str) -> Verdict:
    verdict = written.get("verdict", base.verdict)
    if verdict not in VERDICTS:
        raise UsageError(
            f"{where}verdict is {verdict!r:.60}: choose from {', '.join(VERDICTS)}", code=SETTING
        )
    return cast(Verdict, verdict)


def _bounds(table: Any, bound: Bound, where: str) -> dict[str, float]:
    """The bounds of one table by the dotted names of their figures."""
    if not isinstance(table, Mapping):
        raise UsageError(
            f"{where}{bound} is {table!r:.60}: expected a table [{bound}]", code=SETTING
        )
    found = dict(_flat(table))
    for name, limit in found.items():
        if not is_figure(name):
            near = difflib.get_close_matches(name, MEANINGS, 1)
            hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(MEANINGS)}"
            raise UsageError(f"{where}{bound}.{name}: no such figure: {hint}", code=SETTING)
        if type(limit) not in (int, float) or math.isnan(limit):
            raise UsageError(
                f"{where}{bound}.{name} is {limit!r:.60}: expected a number", code=SETTING
            )
    return found


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The entries of nested tables by dotted key."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value

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

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from specmap_cli.checking.figures import BOUNDED, FINDINGS, GOLDEN, Figures
from specmap_cli.checking.record import CheckRecord, OutcomeRecord
from specmap_cli.core.errors import SETTING, UsageError
from specmap_cli.core.findings import VERDICTS, Verdict, at_least_as_bad
from specmap_cli.core.toml import TomlFormat, UnfitError, choice, unless

Bound = Literal["most", "least"]
BOUNDS: tuple[Bound, ...] = ("most", "least")
VERDICT = "verdict"
_UNKNOWN = "not known: the map does not say"


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
        "damage": 0,
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


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and not math.isnan(value)


def _figure(name: str) -> str:
    """Refuse what is no figure of a map."""
    if name not in BOUNDED:
        raise UnfitError(choice(name, BOUNDED), "no such figure")
    return name


def _flat(table: Any) -> Any:
    """The entries of nested tables by dotted key; what is no table as it is."""
    if not isinstance(table, Mapping):
        return table
    found: dict[str, Any] = {}
    for key, value in table.items():
        inner = _flat(value)
        below = isinstance(value, Mapping)
        found |= {f"{key}.{name}": each for name, each in inner.items()} if below else {key: inner}
    return found


_Limit = Annotated[int | float, unless(_is_number, "expected a number")]
_Limits = Annotated[dict[Annotated[str, AfterValidator(_figure)], _Limit], BeforeValidator(_flat)]


class _Written(BaseModel):
    """What a file of rules says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    defaults: Annotated[
        bool, unless(lambda value: isinstance(value, bool), "expected true or false")
    ] = True
    verdict: Annotated[
        Verdict | None,
        unless(lambda value: value in VERDICTS, f"choose from {', '.join(VERDICTS)}"),
    ] = None
    most: _Limits = Field(default_factory=dict)
    least: _Limits = Field(default_factory=dict)


_FORMAT = TomlFormat(model=_Written, error=UsageError, code=SETTING)


def read_rules(path: Path | None, *, against: bool) -> Rules:
    """The rules in force: those of the file `path` over the defaults.

    Rules of `golden.` figures hold only `against` another map. Raises UsageError for a file that
    cannot be read, a rule of no figure, and one that needs another map where there is none.
    """
    written = _Written() if path is None else _FORMAT.read(path)
    bounds: dict[Bound, dict[str, float]] = {"most": written.most, "least": written.least}
    golden = [
        f"{bound}.{name}" for bound in BOUNDS for name in bounds[bound] if name.startswith(GOLDEN)
    ]
    if golden and not against:
        raise UsageError(
            f"{golden[0]}: needs another map", "give --against", where=path, code=SETTING
        )
    base = DEFAULTS if written.defaults else Rules("poor", {}, {})
    most, least = (
        {
            name: limit
            for name, limit in {**getattr(base, bound), **bounds[bound]}.items()
            if math.isfinite(limit) and (against or not name.startswith(GOLDEN))
        }
        for bound in BOUNDS
    )
    return Rules(written.verdict or base.verdict, most, least)


def judged(
    map_: str,
    against: str | None,
    figures: Figures,
    verdict: Verdict | None,
    rules: Rules,
    details: Mapping[str, str],
) -> CheckRecord:
    """Every rule and whether the map keeps it; `details` are words on figures that break one."""
    found: list[tuple[str, Bound, float | str, float | str | None, bool]] = []
    kept = at_least_as_bad(rules.verdict, verdict or "poor")  # nobody judged it: as bad as can be
    found.append((VERDICT, "most", rules.verdict, verdict, kept))
    for name, bound, limit in rules.each():
        value = figures.get(name, 0 if name.startswith(FINDINGS) else None)  # no finding of a code
        kept = value is not None and (value <= limit if bound == "most" else value >= limit)
        found.append((name, bound, limit, value, kept))
    outcomes = [
        OutcomeRecord(
            rule=name,
            bound=bound,
            limit=most,
            value=held,
            passed=passed,
            detail="" if passed else details.get(name, _UNKNOWN if held is None else ""),
        )
        for name, bound, most, held, passed in found
    ]
    return CheckRecord(
        schema_version=1,
        map=map_,
        against=against,
        passed=all(outcome.passed for outcome in outcomes),
        rules=outcomes,
        figures={name: figures[name] for name in sorted(figures)},
    )

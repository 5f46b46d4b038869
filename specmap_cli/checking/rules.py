"""Rules: which figures of a map have bounds, and whether a map keeps within them.

A figure that the map does not hold is None: a map of `specmap segment`, say, lost no scans and read
none. Figures that begin with `golden.` are of a comparison with another map.

A file of rules is TOML (docs/check.md shows one). What it says goes over `default_rules.toml`
beside this file; an infinite bound takes a default away, and `defaults = false` all of them.

What a check found is told for a machine, a person and a CI.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import networkx as nx
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from specmap_cli.core.errors import SETTING, UsageError
from specmap_cli.core.findings import VERDICTS, Verdict, at_least_as_bad
from specmap_cli.core.json_values import Record
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.core.text import Case, counted, legible, markdown_table, markdown_text
from specmap_cli.core.text import junit as test_suite
from specmap_cli.core.toml import TomlFormat, UnfitError, choice, flat, unless
from specmap_cli.maps import filenames
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.store import Map

Figures = Mapping[str, float | None]

FINDINGS, GOLDEN = "findings.", "golden."  # what the names of such figures begin with
# docs/check.md says what each of these means, and docs/quality.md each code of a finding
_FIGURES = (
    *("scans", "lost_share", "damage", "breaks", "duration_s", "path_m", "revisits", "submaps"),
    *("edges", "impassable", "parts", "doors", "area_m2", "wall_s", "scans_per_s", "memory_mb"),
)
_AGAINST = (
    *("golden.aligned", "golden.same_share", "golden.gone", "golden.unseen", "golden.new"),
    *("golden.area_share", "golden.closed", "golden.opened", "golden.off_m"),
    *("golden.appeared_m2", "golden.vanished_m2"),
)
_CODES = (
    *("lost-scans", "tracking-break", "hole-in-log", "unmeasured-way", "odometry-disagrees"),
    *(
        "laser-misplaced",
        "loose-part",
        "walls-disagree",
        "part-moved",
        "rival-place",
        "layout-refused",
    ),
    *("closures-refuted", "beyond-grid", "too-narrow", "input"),
)
BOUNDED = (*_FIGURES, *_AGAINST, *(FINDINGS + code for code in _CODES))  # what a rule can bound


def figures_of(stored: Map) -> dict[str, float | None]:
    """The figures of a map. Raises MapError when a file of it is damaged."""
    record = stored.record
    # what the command that made the map wrote down about its run, if it did
    written = (stored.path / filenames.RUN).exists()
    run: Mapping[str, Any] = stored.run if written else {}
    counts = stored.counts if written else {}
    scans, lost, wall_s = counts.get("scans"), counts.get("lost"), _number(run.get("wall_s"))
    findings = () if stored.quality is None else stored.quality.findings
    grave = Counter(f"{FINDINGS}{one.code}" for one in findings if one.severity != "note")
    return {
        "scans": scans,
        "lost_share": lost / scans if scans and lost is not None else None,
        "damage": counts.get("damage", 0),
        "breaks": counts.get("breaks"),
        "revisits": counts.get("merges"),
        "wall_s": wall_s,
        "scans_per_s": scans / wall_s if scans is not None and wall_s else None,
        "memory_mb": _number(run.get("memory_mb")),
        "duration_s": stored.duration_s if stored.of_recording else None,
        "path_m": stored.driven_m if stored.of_recording else None,
        "submaps": len(stored.rooms),
        "edges": len(record.edges),
        "impassable": sum(edge.path is None for edge in record.edges),
        "parts": nx.number_connected_components(stored.to_networkx()),
        "doors": len(stored.doors),
        "area_m2": record.area_m2,
        **dict(sorted(grave.items())),
    }


def _number(value: Any) -> float | None:
    """A number that a person may have spoiled: None for anything else."""
    return float(value) if type(value) in (int, float) and abs(value) < 1e15 else None


def figures_against(record: ComparisonRecord | None) -> dict[str, float | None]:
    """The figures of a comparison, the golden map being the old one; None: it cannot be aligned."""
    if record is None:
        return dict.fromkeys(_AGAINST) | {"golden.aligned": 0}
    old, new = record.old, record.new
    same = len(record.submaps.same) / old.submaps if old.submaps else None
    return {
        "golden.aligned": 1,
        "golden.same_share": 1.0 if record.identical else same,
        "golden.gone": len(record.submaps.gone),
        "golden.unseen": len(record.submaps.unseen),
        "golden.new": len(record.submaps.new),
        "golden.area_share": new.area_m2 / old.area_m2 if old.area_m2 else None,
        "golden.closed": len(record.doors.closed),
        "golden.opened": len(record.doors.opened),
        "golden.off_m": record.alignment.residual_m,
        "golden.appeared_m2": sum(one.area_m2 for one in record.things.appeared),
        "golden.vanished_m2": sum(one.area_m2 for one in record.things.vanished),
    }


Bound = Literal["most", "least"]
BOUNDS: tuple[Bound, ...] = get_args(Bound)
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


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and not math.isnan(value)


def _figure(name: str) -> str:
    """Refuse what is no figure of a map."""
    if name not in BOUNDED:
        raise UnfitError(choice(name, BOUNDED), "no such figure")
    return name


_Limit = Annotated[int | float, unless(_is_number, "expected a number")]
_Limits = Annotated[dict[Annotated[str, AfterValidator(_figure)], _Limit], BeforeValidator(flat)]


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
_OWN = _FORMAT.read(Path(__file__).with_name("default_rules.toml"))
DEFAULTS = Rules(_OWN.verdict or "poor", _OWN.most, _OWN.least)


def read_rules(path: Path | None, *, against: bool) -> Rules:
    """The rules in force: those of the file `path` over the defaults.

    Rules of `golden.` figures hold only `against` another map. Raises UsageError for a file that
    cannot be read, a rule of no figure, and one that needs another map where there is none.
    """
    written = _Written() if path is None else _FORMAT.read(path)
    base = DEFAULTS if written.defaults else Rules("poor", {}, {})
    given = Rules(written.verdict or base.verdict, written.most, written.least)
    golden = [f"{bound}.{name}" for name, bound, _ in given.each() if name.startswith(GOLDEN)]
    if golden and not against:
        raise UsageError(
            f"{golden[0]}: needs another map", "give --against", where=path, code=SETTING
        )
    most, least = (
        {
            name: limit
            for name, limit in {**getattr(base, bound), **getattr(given, bound)}.items()
            if math.isfinite(limit) and (against or not name.startswith(GOLDEN))
        }
        for bound in BOUNDS
    )
    return Rules(given.verdict, most, least)


def judged(
    map_: str,
    against: str | None,
    figures: Figures,
    verdict: Verdict | None,
    rules: Rules,
    details: Mapping[str, str],
) -> CheckRecord:
    """Every rule and whether the map keeps it; `details` are words on figures that break one."""

    def outcome(
        rule: str, bound: Bound, limit: float | str, value: float | str | None, passed: bool
    ) -> OutcomeRecord:
        detail = "" if passed else details.get(rule, _UNKNOWN if value is None else "")
        return OutcomeRecord(
            rule=rule, bound=bound, limit=limit, value=value, passed=passed, detail=detail
        )

    kept = at_least_as_bad(rules.verdict, verdict or "poor")  # nobody judged it: as bad as can be
    outcomes = [outcome(VERDICT, "most", rules.verdict, verdict, kept)]
    for name, bound, limit in rules.each():
        value = figures.get(name, 0 if name.startswith(FINDINGS) else None)  # no finding of a code
        kept = value is not None and (value <= limit if bound == "most" else value >= limit)
        outcomes.append(outcome(name, bound, limit, value, kept))
    return CheckRecord(
        schema_version=1,
        map=map_,
        against=against,
        passed=all(outcome.passed for outcome in outcomes),
        rules=outcomes,
        figures={name: figures[name] for name in sorted(figures)},
    )


_SIGNS = {"most": "<=", "least": ">="}


class OutcomeRecord(Record):
    """One rule, and whether the map keeps it."""

    rule: str = Field(description="name of the figure that has a bound")
    bound: Literal["most", "least"] = Field(description="on which side it is bounded")
    limit: float | str = Field(description="the bound; a word for the verdict")
    value: float | str | None = Field(description="of the map; null where it is not known")
    passed: bool = Field(description="what is not known does not pass")
    detail: str = Field(description="which findings or submaps break it; empty where none does")


class CheckRecord(Record):
    """The whole object."""

    schema_version: Literal[1] = Field(description="the version of this format")
    map: str = Field(description="as it was named on the command line")
    against: str | None = Field(description="the golden map, as named; null without one")
    passed: bool = Field(description="whether every rule is kept")
    rules: list[OutcomeRecord] = Field(description="the verdict, upper bounds, lower bounds")
    figures: dict[str, float | None] = Field(
        description="every figure that a rule could bound; null where it is not known"
    )


def lines_of(record: CheckRecord) -> list[str]:
    """A line a rule, broken ones with what breaks them; then whether all are kept."""
    width = max(len(outcome.rule) for outcome in record.rules)
    rows = [
        f"  {'ok    ' if outcome.passed else 'BROKEN'}  {outcome.rule:<{width}}  "
        f"{_value(outcome.value):>8}  {_bound(outcome)}"
        + (f"  {legible(outcome.detail)}" if outcome.detail else "")
        for outcome in record.rules
    ]
    return [*rows, summary(record)]


def summary(record: CheckRecord) -> str:
    """Whether the map keeps the rules, in a line."""
    broken = [outcome.rule for outcome in record.rules if not outcome.passed]
    against = "" if record.against is None else f" against {record.against}"
    if not broken:
        return f"{record.map}{against}: keeps {counted(len(record.rules), 'rule')}"
    return (
        f"{record.map}{against}: breaks {len(broken)} of "
        f"{counted(len(record.rules), 'rule')}: {', '.join(broken)}"
    )


def junit(record: CheckRecord) -> bytes:
    """A test suite with a test case a rule, as CI servers read it."""
    cases = []
    for one in record.rules:
        told = f"{one.rule} is {_value(one.value)}, allowed is {_bound(one)}"
        failure = None if one.passed else told
        name = f"{one.rule} {_bound(one)}"
        cases.append(Case(name=name, failure=failure, kind="BrokenRule", detail=one.detail))
    return test_suite(f"specmap check {record.map}", record.map, cases)


def markdown(record: CheckRecord) -> bytes:
    """A section with a table for the summary page of a CI: broken rules first."""
    rows = [
        (
            "ok" if one.passed else "**broken**",
            markdown_text(one.rule),
            _value(one.value),
            markdown_text(_bound(one)),
            markdown_text(one.detail),
        )
        for one in sorted(record.rules, key=lambda outcome: outcome.passed)
    ]
    table = markdown_table(("", "rule", "value", "bound", ""), rows, {"value"})
    return "\n".join([f"### {markdown_text(summary(record))}", "", *table, ""]).encode()


def _bound(outcome: OutcomeRecord) -> str:
    return f"{_SIGNS[outcome.bound]} {_value(outcome.limit)}"


def _value(value: float | str | None) -> str:
    """A figure, short: four digits tell enough."""
    if value is None:
        return "unknown"
    if isinstance(value, str):
        return value
    return f"{value:.0f}" if value == round(value) or abs(value) >= 1e4 else f"{value:.4g}"


SCHEMA = ModelSchema(CheckRecord, "check", 1, "specmap check --json")

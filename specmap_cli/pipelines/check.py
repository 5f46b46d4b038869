"""A map under rules: its own figures, and what a golden map of the building says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from specmap_cli.checking.rules import (
    FINDINGS,
    VERDICT,
    CheckRecord,
    Rules,
    figures_against,
    figures_of,
    judged,
    read_rules,
)
from specmap_cli.core.errors import NoResultError, instance_of
from specmap_cli.core.findings import Finding, Severity
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import plain
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.compare import compare_maps

_OF_NO_RECORDING = "not known: of no recording; rules with `defaults = false` leave this one out"
_GRAVITY: tuple[Severity, ...] = ("note", "doubtful", "poor")


@one_blas_thread()
def check_map(
    stored: Map | Path | str,
    rules: Rules | None = None,
    against: Map | Path | str | None = None,
    progress: Progress | None = None,
) -> CheckRecord:
    """Whether a map keeps rules; `against` is a golden map of the same building.

    Without `rules` the defaults hold. A map that cannot be aligned with the golden one breaks the
    rule `golden.aligned`. Raises MapError for a directory that is no map or damaged.
    """
    map_ = opened_map(stored, "stored")
    golden = None if against is None else opened_map(against, "against")
    if rules is None:
        rules = read_rules(None, against=golden is not None)
    instance_of(rules, Rules, "rules")
    figures, details = figures_of(map_), dict(_told(map_))
    if not map_.of_recording:
        left_out = [VERDICT, *(name for name, value in figures.items() if value is None)]
        details |= dict.fromkeys(left_out, _OF_NO_RECORDING)
    if golden is not None:
        try:
            record = compare_maps(golden, map_, progress=progress).record
        except NoResultError as error:
            unknown = figures_against(None)
            figures |= unknown
            details |= dict.fromkeys(unknown, "not known: see golden.aligned")
            details["golden.aligned"] = str(error)
        else:
            figures |= figures_against(record)
            details |= _changes(record)
    named = None if golden is None else str(golden.path)
    return judged(str(map_.path), named, plain(figures), map_.verdict, rules, details)


def _told(stored: Map) -> Iterable[tuple[str, str]]:
    """What the findings say, by the figure that counts them, and those that made the verdict."""
    quality = stored.quality
    if quality is None:
        return
    by_code: dict[str, list[Finding]] = {}
    for finding in quality.findings:
        if finding.severity != "note":
            by_code.setdefault(finding.code, []).append(finding)
    for code, findings in by_code.items():
        worst = max(findings, key=lambda one: _GRAVITY.index(one.severity))
        more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
        yield f"{FINDINGS}{code}", f"{worst.message}{more}"
    yield VERDICT, ", ".join(by_code)


def _changes(record: ComparisonRecord) -> dict[str, str]:
    """Which submaps and ways the figures of a comparison count, by name."""
    old, new = record.old.names, record.new.names
    return {
        "golden.gone": _named(record.submaps.gone, old),
        "golden.unseen": _named(record.submaps.unseen, old),
        "golden.new": _named(record.submaps.new, new),
        "golden.closed": "; ".join(_named(way.between, old) for way in record.doors.closed),
        "golden.opened": "; ".join(_named(way.between, new) for way in record.doors.opened),
    }


def _named(ids: Iterable[int], names: Mapping[int, str]) -> str:
    return ", ".join(names.get(id_, str(id_)) for id_ in ids)

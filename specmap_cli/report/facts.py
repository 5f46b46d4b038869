"""What the page says of the whole map: its figures, its verdict, and how it was made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from specmap_cli.core.findings import Finding, Verdict
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.maps import filenames
from specmap_cli.report.frame import Frame
from specmap_cli.report.ground import Ground
from specmap_cli.report.track import Track
from specmap_cli.report.words import lasting
from specmap_cli.topology.topological_map import driven_m

_VERDICTS: Mapping[Verdict, str] = {
    "good": "nothing was found that speaks against the map",
    "doubtful": "something is wrong, or cannot be known: see the findings before you use the map",
    "poor": "do not use this map",
}


@dataclass(frozen=True, slots=True)
class Fact:
    """A figure with its unit, and what it counts."""

    value: str
    unit: str
    what: str


@dataclass(frozen=True, slots=True)
class FoundAt:
    """A finding, numbered as on the map; `place` in the drawing where it has one."""

    number: int
    record: Finding
    place: tuple[int, int] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """How the map was made, as run.json has it; empty parts for a map without that file."""

    selection: tuple[tuple[str, str], ...] = ()
    settings: tuple[tuple[str, str, str], ...] = ()
    counts: tuple[tuple[str, str], ...] = ()
    seconds: tuple[tuple[str, float], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()


def verdict_of(ground: Ground) -> tuple[str, str]:
    """The verdict in a word and in a sentence."""
    quality = ground.stored.record.graph.quality
    if quality is None:
        return "not judged", "nobody checked this map against itself"
    return quality.verdict, _VERDICTS[quality.verdict]


def findings_of(ground: Ground) -> list[FoundAt]:
    """All findings, the gravest first."""
    quality = ground.stored.record.graph.quality
    if quality is None:
        return []
    ranked = sorted(
        quality.findings, key=lambda one: ("poor", "doubtful", "note").index(one.severity)
    )
    return [FoundAt(k, each, _place(each, ground.frame)) for k, each in enumerate(ranked, start=1)]


def _place(finding: Finding, frame: Frame) -> tuple[int, int] | None:
    return None if finding.place is None else frame.place(finding.place)


def headline(ground: Ground) -> str:
    """The recordings that the map was made of."""
    first, *others = [log.name for log in ground.stored.record.graph.logs]
    return f"{first} and {counted(len(others), 'more recording')}" if others else first


def facts_of(ground: Ground, track: Track) -> list[Fact]:
    """The figures at the top of the page."""
    record = ground.stored.record
    doors, closures = record.graph.doors, record.graph.closures
    driven = sum(door.driven for door in doors)
    found = [
        Fact(f"{len(record.nodes):,}", "", _plural(len(record.nodes), "submap")),
        Fact(f"{sum(node.area_m2 for node in record.nodes):,.0f}", "m²", "free space"),
        Fact(f"{len(doors):,}", "", _plural(len(doors), "door") + _driven(driven, len(doors))),
    ]
    if track.known:
        way = driven_m(ground.stored.logs, ground.labels)
        found.append(Fact(f"{way:,.0f}", "m", f"driven in {lasting(track.duration_s)}"))
        merged = sum(closure.merged for closure in closures)
        found.append(Fact(f"{merged:,}", "", _plural(merged, "revisit") + " recognised"))
        lost = len(ground.lost)
        scans = sum(log.scans for log in record.graph.logs)
        found.append(Fact(f"{lost:,}", "", f"of {scans:,} scans lost"))
    return found


def _plural(count: int, noun: str) -> str:
    return counted(count, noun).split(" ", 1)[1]


def _driven(driven: int, doors: int) -> str:
    if not doors or not driven:
        return ""
    return ", all driven through" if driven == doors else f", {driven:,} driven through"


def run_of(ground: Ground) -> Run:
    """How the map was made."""
    stored = ground.stored
    if not (stored.path / filenames.RUN).exists():
        return Run()
    run = stored.run
    seconds = [
        (key, float(value)) for key, value in _dict(run, "seconds").items() if _is_number(value)
    ]
    return Run(
        selection=_pairs(_dict(run, "selection")),
        settings=tuple(_changed(stored.config)),
        counts=tuple((key, f"{count:,}") for key, count in stored.counts.items() if count),
        seconds=tuple(sorted(seconds, key=lambda one: -one[1])),
        versions=_pairs(_dict(run, "versions")),
        warnings=_texts(run.get("warnings")),
    )


def _dict(run: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """A part of run.json, which a person may have changed; empty when it is something else."""
    found = run.get(key)
    return found if isinstance(found, dict) else {}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _texts(values: Any) -> tuple[str, ...]:
    return tuple(map(str, values)) if isinstance(values, list) else ()


def _pairs(values: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (key.replace("_", " "), _text(value)) for key, value in values.items() if value is not None
    )


def _text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _changed(config: Config) -> Iterator[tuple[str, str, str]]:
    """Settings that are not the defaults: key, value, default."""
    usual, own = Config().model_dump(), config.model_dump()
    for section, values in own.items():
        if not isinstance(values, dict):
            if values != usual[section]:
                yield section, str(values), str(usual[section])
            continue
        for key, value in values.items():
            if value != usual[section][key]:
                yield f"{section}.{key}", str(value), str(usual[section][key])

"""What holds for a whole map as the records of topology.json, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from specmap_cli.core.findings import Finding, Quality
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Closure
from specmap_cli.core.text import nanoseconds, plain, rounded, seconds
from specmap_cli.maps.edit_conversion import edits_record, numbers_of, runs_of
from specmap_cli.maps.schema_graph import (
    SCHEMA_VERSION,
    BreakRecord,
    ClosureRecord,
    FindingRecord,
    GraphRecord,
    LogRecord,
    QualityRecord,
    StayRecord,
)
from specmap_cli.maps.schema_values import transform
from specmap_cli.maps.way_conversion import door_record
from specmap_cli.topology.topological_map import Break, LogInfo, Stay, TopologicalMap


def graph_record(
    topology: TopologicalMap, logs: Sequence[LogInfo], frame: str, quality: Quality | None
) -> GraphRecord:
    """The key `graph`."""
    submap_of = {stay.number: stay.submap for stay in topology.stays}
    return GraphRecord(
        schema_version=SCHEMA_VERSION,
        frame=frame,
        next_id=max(topology.next_id, 1 + max(topology.submaps, default=-1)),
        logs=[_log_record(log) for log in logs],
        stays=[_stay_record(stay) for stay in topology.stays],
        breaks=[_break_record(each) for each in topology.breaks],
        closures=[_closure_record(closure, submap_of) for closure in topology.closures],
        doors=[door_record(door) for door in topology.doors],
        robot_radius_m=topology.robot_radius_m,
        edits=edits_record(topology.said, topology.borders),
        quality=None if quality is None else _quality_record(quality),
    )


def log_of(record: LogRecord) -> LogInfo:
    """A recording as it was written."""
    return LogInfo(
        name=record.name,
        start_ns=None if record.start is None else nanoseconds(record.start),
        end_ns=None if record.end is None else nanoseconds(record.end),
        scans=record.scans,
        keyframes=record.keyframes,
        path_m=record.path_m,
    )


def finding_of(record: FindingRecord) -> Finding:
    """A finding as it was written."""
    where = record.where
    place = None if where is None or where.x is None or where.y is None else (where.x, where.y)
    return Finding(
        code=record.code,
        severity=record.severity,
        message=record.message,
        advice=record.advice,
        value=record.value,
        limit=record.limit,
        stamp_ns=None if where is None or where.stamp is None else nanoseconds(where.stamp),
        place=place,
    )


def stay_of(record: StayRecord) -> Stay:
    """A stay as it was written."""
    return Stay(
        number=record.number,
        submap=record.submap,
        keyframes=numbers_of(record.keyframes),
        origin=record.origin,
        start_ns=nanoseconds(record.start),
        end_ns=nanoseconds(record.end),
    )


def break_of(record: BreakRecord) -> Break:
    """A break as it was written."""
    if record.position_m is None or record.heading_rad is None:
        return Break(record.keyframe)
    return Break(record.keyframe, (record.position_m, record.heading_rad))


def closure_of(closure: ClosureRecord) -> Closure:
    """A closure as it was written."""
    return Closure(
        new=closure.new,
        old=closure.old,
        xi=_or_nan(closure.xi),
        claims_new_by_old=_or_nan(closure.claims_new_by_old),
        claims_old_by_new=_or_nan(closure.claims_old_by_new),
        verified=closure.verified,
        merged=closure.accepted,
        score=_or_nan(closure.score),
        reason=closure.reason,
        old_from_new=None if closure.transform is None else Pose2(*closure.transform),
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _log_record(log: LogInfo) -> LogRecord:
    return LogRecord(
        name=log.name,
        start=None if log.start_ns is None else seconds(log.start_ns),
        end=None if log.end_ns is None else seconds(log.end_ns),
        scans=log.scans,
        keyframes=log.keyframes,
        path_m=None if log.path_m is None else rounded(log.path_m),
    )


def _stay_record(stay: Stay) -> StayRecord:
    return StayRecord(
        number=stay.number,
        submap=stay.submap,
        start=seconds(stay.start_ns),
        end=seconds(stay.end_ns),
        origin=stay.origin,
        keyframes=runs_of(stay.keyframes),
    )


def _break_record(each: Break) -> BreakRecord:
    position, heading = (rounded(value) for value in each.bridge or (math.nan, math.nan))
    return BreakRecord(keyframe=each.keyframe, position_m=position, heading_rad=heading)


def _quality_record(quality: Quality) -> QualityRecord:
    return QualityRecord.model_validate(plain(quality.as_dict()))


def _closure_record(closure: Closure, submap_of: Mapping[int, int]) -> ClosureRecord:
    found = closure.old_from_new
    return ClosureRecord(
        new=closure.new,
        old=closure.old,
        new_submap=submap_of.get(closure.new),
        old_submap=submap_of.get(closure.old),
        xi=rounded(closure.xi),
        claims_new_by_old=rounded(closure.claims_new_by_old),
        claims_old_by_new=rounded(closure.claims_old_by_new),
        verified=closure.verified,
        score=rounded(closure.score),
        accepted=closure.merged,
        reason=closure.reason,
        transform=None if found is None else transform(found),
    )

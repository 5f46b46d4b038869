"""The contents of topology.json that hold for the whole map: its key `graph`."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from specmap_cli.core.findings import Severity, Verdict
from specmap_cli.maps.schema_edits import EditsRecord
from specmap_cli.maps.schema_values import (
    Amount,
    Count,
    Number,
    Record,
    Span,
    Stamp,
    Transform,
)

SCHEMA_VERSION = 2


class LogRecord(Record):
    """A recording that the map was made of, or a finished grid, which has no stamps."""

    name: str = Field(description="name of the file, without directories")
    start: Stamp | None = Field(description="stamp of the first scan, seconds; null for a grid")
    end: Stamp | None = Field(description="stamp of the last scan, seconds; null for a grid")
    scans: Count = Field(description="number of its scans that were read")
    keyframes: Span | None = Field(
        description="first and last keyframe that it gave, rows of labels.csv; null where there "
        "are none or it is not known"
    )
    path_m: Amount | None = Field(
        None,
        description="metres driven in it, where the map keeps only some of its keyframes; null "
        "where it keeps all",
    )


class StayRecord(Record):
    """A piece of the way in which the robot saw a part of the map; closures compare such pieces."""

    number: Count = Field(description="what closures call it by")
    submap: Count = Field(description="id of the node that most of its keyframes are in")
    start: Stamp = Field(description="stamp of its first keyframe, seconds")
    end: Stamp = Field(description="stamp of its last keyframe, seconds")
    origin: Count = Field(description="the keyframe whose pose is the frame of the stay")
    keyframes: list[Span] = Field(
        min_length=1, description="runs [first, last] of its keyframes, rows of labels.csv"
    )


class BreakRecord(Record):
    """Tracking was lost before a keyframe, and restarted with it."""

    keyframe: Count = Field(description="the keyframe, a row of labels.csv")
    position_m: Number | None = Field(
        description="how far odometry may be off over the break, metres; null where the motion is "
        "a guess"
    )
    heading_rad: Number | None = Field(description="the same for the heading, radians")


class ClosureRecord(Record):
    """Two stays that loop closure compared."""

    new: Count = Field(description="number of the later stay")
    old: Count = Field(description="number of the earlier stay")
    new_submap: Count | None = Field(
        description="id of the node that `new` ended in; null where it is not known"
    )
    old_submap: Count | None = Field(
        description="id of the node that `old` ended in; null where it is not known"
    )
    xi: float | None = Field(description="eq. 5 of the paper: the product of the two claims")
    claims_new_by_old: float | None = Field(
        description="eq. 4: share of the scans of `new` that the classifier of `old` claims"
    )
    claims_old_by_new: float | None = Field(
        description="eq. 4: share of the scans of `old` that the classifier of `new` claims"
    )
    verified: bool = Field(description="whether the two grids match")
    score: float | None = Field(
        description="how well the grids match, 1 is perfect; null when they were not compared"
    )
    accepted: bool = Field(description="whether the two became one submap")
    reason: str = Field(description="why they did, or why not")
    transform: Transform | None = Field(
        description="[x, y, theta] of the frame of `new`, its `origin`, in that of `old`; null "
        "when not verified"
    )


class WhereRecord(Record):
    """When and where something was found."""

    stamp: Stamp | None = Field(description="seconds; null where it has no stamp")
    x: Number | None = Field(description="metres; null where it has no place")
    y: Number | None = Field(description="metres; null where it has no place")


class FindingRecord(Record):
    """Something that was found out about the map; docs/quality.md lists the codes."""

    code: str = Field(description="what was found, stable over versions")
    severity: Severity = Field(description="how grave it is")
    message: str = Field(description="the same in words")
    advice: str = Field(description="what to do about it")
    value: float | None = Field(description="what was measured; null where nothing was")
    limit: float | None = Field(description="what the value is compared with; null for nothing")
    where: WhereRecord | None = Field(description="null for what holds for the whole map")


class QualityRecord(Record):
    """What is thought of the map."""

    verdict: Verdict = Field(description="what the gravest of the findings makes of the map")
    findings: list[FindingRecord] = Field(description="all findings")


class TraversalRecord(Record):
    """The robot went from one submap to another, and its pose at that moment."""

    model_config = ConfigDict(populate_by_name=True)

    stamp: Stamp = Field(description="seconds")
    from_: Count = Field(alias="from", description="id of the node that the robot left")
    to: Count = Field(description="id of the node that it came to")
    x: Number = Field(description="of the robot, metres")
    y: Number = Field(description="of the robot, metres")
    theta: Number = Field(description="of the robot, radians")


class DoorRecord(Record):
    """A narrow passage between two submaps: narrower than the space on both sides of it."""

    id: Count = Field(description="what edges call it by; given afresh whenever a map is made")
    x: Number = Field(description="of its middle, metres")
    y: Number = Field(description="of its middle, metres")
    width_m: Amount = Field(description="clear width from wall to wall, metres")
    theta: Number = Field(
        description="direction of who goes through it from the first of `between` to the second, "
        "radians; its line stands across that"
    )
    between: tuple[Count, Count] = Field(description="ids of two nodes, the smaller one first")
    crossings: list[TraversalRecord] = Field(description="when the robot went through, in order")
    driven: bool = Field(description="whether it ever did; false: the door was only seen")
    forbidden: bool = Field(description="whether a person said that robots must not go through")


class GraphRecord(Record):
    """What holds for the whole map."""

    schema_version: Literal[2] = Field(description="the version of this format")
    frame: str = Field(description="the frame of all coordinates that have no other")
    next_id: Count = Field(description="smallest id that no node has ever had")
    logs: list[LogRecord] = Field(
        min_length=1, description="what the map was made of, in the order of the keyframes"
    )
    stays: list[StayRecord] = Field(description="by number")
    breaks: list[BreakRecord] = Field(description="where tracking restarted, in order")
    closures: list[ClosureRecord] = Field(
        description="all pairs of stays that were compared, in the order of the comparisons"
    )
    doors: list[DoorRecord] = Field(description="every door between two submaps, by id")
    robot_radius_m: Amount | None = Field(
        description="what the paths of edges keep off walls and off what nobody saw, metres; null "
        "where nobody looked for paths"
    )
    edits: EditsRecord = Field(description="what of edits.toml the map shows")
    quality: QualityRecord | None = Field(description="null where the map was not judged")

"""The contents of topology.json that tell which of a person's edits the map shows."""

from __future__ import annotations

from pydantic import Field

from specmap_cli.maps.schema_values import Count, Point, PropertyValue, Record, Span
from specmap_cli.topology.topological_map import SubmapKind


class SaidRecord(Record):
    """What a person said of a submap."""

    id: Count = Field(description="of the node")
    name: str | None = Field(description="null where nobody named it")
    kind: SubmapKind | None = Field(description="null where its shape says it")
    properties: dict[str, PropertyValue] = Field(description="those of the node")


class MergeRecord(Record):
    """One submap became part of another."""

    merge: tuple[Count, Count] = Field(description="[kept, gone]: ids of the two")
    keyframes: list[Span] = Field(
        description="runs [first, last] of the keyframes that came with it, rows of labels.csv"
    )
    known: Count = Field(description="number of keyframes that the map had then")


class SplitRecord(Record):
    """A submap was cut along a line."""

    split: Count = Field(description="id of the submap, and of what is left of the line")
    new: Count = Field(description="id of what is right of the line, seen along it")
    line: tuple[Point, Point] = Field(description="two places in the map, as a person gave them")
    fence: tuple[Point, Point] = Field(
        description="the line from border to border of the submap; no region reaches across it"
    )


class EditsRecord(Record):
    """Which of a person's edits the map shows."""

    submaps: list[SaidRecord] = Field(description="names, kinds and properties, by id")
    borders: list[MergeRecord | SplitRecord] = Field(
        description="merges and splits, in the order in which they were made"
    )

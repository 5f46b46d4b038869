"""The contents of compare.json: two maps against each other.

Lengths are metres, angles radians; places are in the frame of the old map.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from specmap_cli.core.json_values import Amount, Count, Measured, Number, Transform
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.topology.differences import Crossing, Obstacle
from specmap_cli.topology.identity import Identity


class MapFigures(Measured):
    """One of the two maps: what it is made of, and how large it is."""

    map: str = Field(description="as it was named on the command line")
    names: dict[Count, str] = Field(description="of the submaps")
    submaps: Count
    edges: Count
    keyframes: Count
    path_m: Amount = Field(description="driven from keyframe to keyframe")
    duration_s: Amount = Field(description="of its recordings, from first keyframe to last")
    area_m2: Amount = Field(description="of its submaps: their free cells")
    verdict: str | None = Field(description="what the map thinks of itself")


class AlignmentRecord(Measured):
    """Where the new map lies in the old one, and what that stands on.

    `submaps` of either map match under it, in `votes` pairs: a submap may match several of the
    other map. `rival` is the part of what speaks for it that speaks for the next best transform.
    `residual_m` is how far submaps lie off. By `longer_m` the stretch of the new map whose length
    was guessed is longer in the old one; what lies beyond it is not at `old_from_new`.
    """

    old_from_new: Transform
    votes: Count
    submaps: Count
    area_m2: Amount = Field(description="free in both maps")
    walls_m: Amount = Field(description="walls that agree")
    residual_m: Amount
    rival: float
    longer_m: Number = 0.0


class DoorsRecord(Measured):
    """Ways that were open and are blocked (`closed`), and the other way round (`opened`).

    A closed way is between submaps of the old map, an opened one between submaps of the new map.
    """

    closed: tuple[Crossing, ...]
    opened: tuple[Crossing, ...]


class ThingsRecord(Measured):
    """Walls and furniture that appeared, and that vanished."""

    appeared: tuple[Obstacle, ...]
    vanished: tuple[Obstacle, ...]


class ComparisonRecord(Measured):
    """The whole file; `identical`: the maps hold the same submaps and the same grid."""

    schema_version: Literal[1]
    old: MapFigures
    new: MapFigures
    identical: bool
    alignment: AlignmentRecord
    submaps: Identity
    doors: DoorsRecord
    things: ThingsRecord


SCHEMA = ModelSchema(ComparisonRecord, "comparison", 1, "specmap compare.json")

"""The contents of topology.json: node-link JSON that networkx reads as it is.

These models are the format. `topology.schema.json` beside this file is the same as JSON Schema, for
other tools. After a change of the models, `python -m specmap_cli.maps.schema` prints the new one.
Lengths are metres, angles radians, stamps seconds; everything is in the frame named by
`graph.frame` unless it says otherwise.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from specmap_cli.core.findings import Severity, Verdict
from specmap_cli.topology.topological_map import EdgeKind

SCHEMA_VERSION = 1
SCHEMA_FILE = Path(__file__).with_name("topology.schema.json")


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _inside(name: str) -> str:
    """Refuse a file name that leads out of the map directory."""
    parts = PurePosixPath(name).parts
    plain = name.isprintable() and "\\" not in name and ":" not in name
    if not parts or not plain or name.startswith("/") or ".." in parts:
        raise ValueError("must be a plain relative path inside the map directory")
    return name


def _within(limit: float) -> AfterValidator:
    """Refuse numbers beyond a limit: sums and products of them would overflow."""

    def check(value: Any) -> Any:
        if not abs(value) <= limit:
            raise ValueError(f"must be no larger than {limit:g}")
        return value

    return AfterValidator(check)


Number = Annotated[float, _within(1e9)]  # metres, square metres, radians: what fits on the earth
Amount = Annotated[float, Field(ge=0), _within(1e9)]  # as Number, never negative
Stamp = Annotated[float, _within(9.2e9)]  # seconds: as nanoseconds they fit into 64 bits
Point = tuple[Number, Number]
Transform = tuple[Number, Number, Number]
SubmapId = Annotated[int, Field(ge=0), _within(2**31 - 1)]
InnerPath = Annotated[str, AfterValidator(_inside)]


class LogRecord(_Record):
    """The recording the map was made of; stamps are null for a map cut from a finished grid."""

    name: str
    start: Stamp | None
    end: Stamp | None
    scans: int = Field(ge=0)


class ClosureRecord(_Record):
    """One considered pair of submaps; `old` and `new` may since have been merged away.

    `verified`: the grids match; `accepted`: `new` became part of `old`; `score` is null when the
    grids were not compared; `transform` is `new` in the frame of `old`.
    """

    new: SubmapId
    old: SubmapId
    xi: float | None
    claims_new_by_old: float | None
    claims_old_by_new: float | None
    verified: bool
    score: float | None
    accepted: bool
    reason: str
    transform: Transform | None


class WhereRecord(_Record):
    """When and where something was found; null where it has no stamp or no place."""

    stamp: Stamp | None
    x: Number | None
    y: Number | None


class FindingRecord(_Record):
    """Something that was found out about the map; docs/quality.md lists the codes."""

    code: str
    severity: Severity
    message: str
    advice: str
    value: float | None
    limit: float | None
    where: WhereRecord | None


class QualityRecord(_Record):
    """What is thought of the map: the gravest of the findings decides the verdict."""

    verdict: Verdict
    findings: list[FindingRecord]


class GraphRecord(_Record):
    """What holds for the whole map; `quality` is null where the map was not judged."""

    schema_version: Literal[1]
    frame: str
    log: LogRecord
    closures: list[ClosureRecord]
    quality: QualityRecord | None = None


class VisitRecord(_Record):
    """One stay of the robot in a submap."""

    start: Stamp
    end: Stamp


class NodeRecord(_Record):
    """One submap; x, y, theta are its frame, in which the grid of `image` is drawn."""

    id: SubmapId
    name: str
    x: Number
    y: Number
    theta: Number
    centroid: Point | None
    polygon: list[Point]
    area_m2: Amount
    scans: int = Field(ge=0)
    visits: list[VisitRecord]
    image: InnerPath


class TraversalRecord(_Record):
    """One crossing of an edge, and the pose of the robot at that moment."""

    model_config = ConfigDict(populate_by_name=True)

    stamp: Stamp
    from_: SubmapId = Field(alias="from")
    to: SubmapId
    x: Number
    y: Number
    theta: Number


class EdgeRecord(_Record):
    """A link between two submaps; x, y is where it is crossed, null when it never was.

    `distance_m` is the way from centroid to centroid through the crossing, `transform` the frame of
    `target` in the frame of `source`, `width_m` the width of a doorway where it is known.
    """

    source: SubmapId
    target: SubmapId
    kind: EdgeKind
    traversals: list[TraversalRecord]
    x: Number | None
    y: Number | None
    distance_m: Amount
    width_m: Amount | None
    transform: Transform


class TopologyRecord(_Record):
    """The whole file."""

    directed: Literal[False]
    multigraph: Literal[False]
    graph: GraphRecord
    nodes: list[NodeRecord]
    edges: list[EdgeRecord]


def json_schema() -> dict[str, Any]:
    """The models as JSON Schema (draft 2020-12)."""
    schema = TopologyRecord.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "specmap topology.json",
        **{key: value for key, value in schema.items() if key != "title"},
    }


def schema_text() -> str:
    """The text of `topology.schema.json`."""
    return json.dumps(json_schema(), indent=2, sort_keys=True) + "\n"


if __name__ == "__main__":
    sys.stdout.write(schema_text())

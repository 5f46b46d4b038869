"""Doors and ways as the records of topology.json, and back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.text import nanoseconds, rounded, seconds
from specmap_cli.maps.schema_graph import DoorRecord, TraversalRecord
from specmap_cli.maps.schema_values import Point, point, transform
from specmap_cli.topology.topological_map import Door, Edge, Traversal


def traversal_record(traversal: Traversal) -> TraversalRecord:
    """A traversal as it is written."""
    x, y, theta = transform(traversal.pose)
    return TraversalRecord(
        stamp=seconds(traversal.stamp_ns),
        from_=traversal.source,
        to=traversal.target,
        x=x,
        y=y,
        theta=theta,
    )


def traversal_of(record: TraversalRecord) -> Traversal:
    """A traversal as it was written."""
    pose = Pose2(record.x, record.y, record.theta)
    return Traversal(nanoseconds(record.stamp), record.from_, record.to, pose)


def door_record(door: Door) -> DoorRecord:
    """A door as it is written."""
    x, y, theta = transform((door.x, door.y, door.theta))
    return DoorRecord(
        id=door.id,
        x=x,
        y=y,
        width_m=rounded(door.width_m) or 0.0,
        theta=theta,
        between=door.between,
        crossings=[traversal_record(crossing) for crossing in door.crossings],
        driven=door.driven,
        forbidden=door.forbidden,
    )


def door_of(record: DoorRecord) -> Door:
    """A door as it was written."""
    return Door(
        id=record.id,
        x=record.x,
        y=record.y,
        width_m=record.width_m,
        theta=record.theta,
        between=record.between,
        crossings=tuple(traversal_of(crossing) for crossing in record.crossings),
        forbidden=record.forbidden,
    )


def way_fields(edge: Edge) -> dict[str, Any]:
    """The keys of an edge that say how to get along it."""
    return {
        "doors": list(edge.doors),
        "path": None if edge.path is None else [point(corner) for corner in edge.path],
        "length_m": written(edge.length_m),
        "clearance_m": written(edge.clearance_m),
    }


def written(value: float | None) -> float | None:
    """A number that may be unknown, as it is written."""
    return None if value is None else rounded(value)


def path_of(corners: Iterable[Point] | None) -> FloatArray | None:
    """(N, 2) the corners of a path as it was written."""
    return None if corners is None else np.array(list(corners), dtype=np.float64).reshape(-1, 2)

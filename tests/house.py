"""A small building: a corridor and two rooms, mapped without a robot."""

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.json_values import PropertyValue, runs_of
from specmap_cli.core.records import Closure, Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.maps.writing import MapResult, write_map
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import (
    Break,
    Edge,
    LogInfo,
    Stay,
    Submap,
    TopologicalMap,
    Traversal,
    Visit,
)

START_NS = 1_700_000_000_123_456_789
RESOLUTION = 0.1


def room_grid(width_m: float, height_m: float) -> GridMap:
    """A walled room around the origin of its frame, unknown around it."""
    width, height = round(width_m / RESOLUTION), round(height_m / RESOLUTION)
    cells = np.full((height + 6, width + 6), UNKNOWN, dtype=np.uint8)
    cells[2:-2, 2:-2] = OCCUPIED
    cells[3:-3, 3:-3] = FREE
    return GridMap(cells, RESOLUTION, (-width_m / 2 - 0.3, -height_m / 2 - 0.3))


def _submap(id_: int, frame: Pose2, size: tuple[float, float]) -> Submap:
    start = START_NS + id_ * 10_000_000_000
    return Submap(
        id=id_,
        map_from_submap=frame,
        keyframes=tuple(range(10 * id_, 10 * id_ + 10)),
        visits=(Visit(start, start + 9_000_000_000),),
        grid=room_grid(*size),
    )


def closure(old: int, new: int, **more: Any) -> Closure:
    """Two stays that are one place, though nothing was merged."""
    claims = {"xi": 0.2, "claims_new_by_old": 0.4, "claims_old_by_new": 0.5}
    verdict = {"verified": True, "merged": False, "score": 0.81, "reason": "grids match"}
    return Closure(new=new, old=old, **{**claims, **verdict, **more})


def stay(number: int, submap: int, keyframes: Iterable[int]) -> Stay:
    """A stay, a keyframe a second."""
    of = tuple(keyframes)
    start, end = (START_NS + k * 1_000_000_000 for k in (of[0], of[-1]))
    return Stay(
        number=number, submap=submap, runs=runs_of(of), origin=of[0], start_ns=start, end_ns=end
    )


def whole_of(submaps: Iterable[Submap]) -> GridMap:
    """The grids of submaps laid out in the map: occupied wins over free, free over unknown."""
    canvas = GridMap(np.full((180, 180), UNKNOWN, dtype=np.uint8), RESOLUTION, (-9.0, -9.0))
    places = canvas.centres_of(np.argwhere(canvas.cells == UNKNOWN))
    for submap in submaps:
        seen = submap.grid.values_at(submap.map_from_submap.inverse().apply(places))
        cells = canvas.cells.reshape(-1)
        cells[(seen == FREE) & (cells == UNKNOWN)] = FREE
        cells[seen == OCCUPIED] = OCCUPIED
    return canvas


@pytest.fixture
def result() -> MapResult:
    """Corridor 0, room 1 driven into, room 2 joined by a closure; 10 keyframes each."""
    noted: dict[str, PropertyValue] = {"floor": 2, "heated": True, "owner": "Ann", "rent": 9.5}
    left, right = Pose2(-3.0, 3.5, 0.3), Pose2(3.0, 3.5, -2.0)
    submaps = {
        0: _submap(0, Pose2(0.0, 0.0, 0.0), (12.0, 2.0)),
        1: replace(_submap(1, left, (3.0, 4.0)), properties=noted),
        2: _submap(2, right, (4.0, 3.0)),
    }
    crossing = Traversal(1_700_000_010_000_001_000, 0, 1, -3.0, 1.25, 1.5)
    edges = {
        (0, 1): Edge(
            source=0, target=1, kind="traversed", traversals=(crossing,), source_from_target=left
        ),
        (0, 2): Edge(source=0, target=2, kind="closure", source_from_target=right),
    }
    low: dict[str, Any] = {"xi": 0.02, "claims_new_by_old": 0.1, "claims_old_by_new": 0.2}
    closures = (
        closure(0, 3, merged=True, old_from_new=Pose2(0.1, 0.2, 0.01)),
        closure(1, 3, verified=False, score=math.nan, reason="claims too low", **low),
    )
    topology = TopologicalMap(
        submaps=submaps,
        edges=edges,
        closures=closures,
        stays=(
            stay(0, 0, (0, 1, 2, 3, 4, 8, 9)),
            stay(1, 1, range(10, 20)),
            stay(2, 2, range(20, 30)),
            stay(3, 0, (5, 6, 7)),
        ),
        breaks=(Break(20, 0.5, 0.05), Break(25)),
        next_id=5,
    )
    stamps = START_NS + np.arange(30) * 1_000_000_000
    way = [Pose2(0.08 * (k % 10) - 0.4, 0.1, 0.1 * k) for k in range(30)]
    poses = np.array([submaps[k // 10].map_from_submap @ at for k, at in enumerate(way)])
    labels = Labels(stamps_ns=stamps, poses=poses, submaps=np.repeat(np.arange(3), 10))
    return MapResult(
        topology=topology,
        regions=divide(whole_of(submaps.values()), labels),
        trajectory=Trajectory(stamps, poses),
        labels=labels,
        classifiers="{}\n",
        logs=(LogInfo("house.mcap", int(stamps[0]), int(stamps[-1]), 30, (0, 29)),),
        run={"config": Config().model_dump(), "seconds": {"write": 0.25}, "warnings": []},
        pose_graph="",
        overview=np.full((30, 40, 3), 200, dtype=np.uint8),
    )


@pytest.fixture
def house(tmp_path: Path, result: MapResult) -> Path:
    """Its map directory."""
    out = tmp_path / "house"
    out.mkdir()
    write_map(out, result)
    return out

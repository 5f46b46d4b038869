"""Doors, ways and anchors of maps, against the doors of plans and the cells of the maps.

Doors: how many there truly are between the submaps of a map, how many of these were found, how many
were reported, how many of them where the plan has no narrow place (false), how many where only its
furniture makes one (desks), and for how many the width is right to 0.10 m. Doors between rooms that
are one submap do not count. Ways: how many edges have one, each point of which keeps the robot's
radius off what is not free, how many say why not, how many do not keep it; anchors that keep radius
and margin.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.simulated.door_truth import TrueDoor, narrowest
from specmap_cli.core.geometry import FloatArray, Pose2, nearest_motion
from specmap_cli.core.settings import WaysConfig
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.topology.navigation import PLACE_MARGIN_M
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import Door, TopologicalMap

NEAR_M = 0.7  # from a door to the true one: walls are up to half a metre thick
WIDTH_M = 0.10
FALSE_WIDTH_M = 0.2  # what the plan has there may differ so much in width
POINTS_M = 0.01  # between the points of a way that are looked at


@dataclass(frozen=True, slots=True)
class DoorScores:
    """Counts of doors, edges and anchors."""

    true: int = 0
    found: int = 0
    reported: int = 0
    false: int = 0
    desks: int = 0
    width: int = 0
    edges: int = 0
    ways: int = 0
    too_wide: int = 0
    wrong: int = 0
    anchors: int = 0
    good: int = 0

    def __add__(self, other: DoorScores) -> DoorScores:
        return DoorScores(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __str__(self) -> str:
        return (
            f"doors {self.found} of {self.true}, {self.false} of {self.reported} false, "
            f"{self.desks} between furniture; ways {self.ways} of {self.edges - self.too_wide}, "
            f"{self.wrong} wrong; anchors {self.good} of {self.anchors}"
        )


@dataclass(frozen=True, slots=True)
class Truth:
    """The doors of the plan of a map, that plan with and without furniture, and where it lies."""

    doors: list[TrueDoor]
    plan: GridMap
    bare: GridMap
    map_from_plan: Pose2


def map_from_plan(stored: Map, truth: Path) -> Pose2:
    """Where the plan lies in the map: by the true poses of the keyframes."""
    true = read_tum(truth)
    keyframes, rows = associate(true.stamps_ns, stored.labels.stamps_ns)
    return nearest_motion(true.poses[rows, :2], stored.labels.poses[keyframes, :2])


def against(topology: TopologicalMap, regions: Regions, truth: Truth) -> DoorScores:
    """Doors against the true ones: a door is found where one is reported within NEAR_M."""
    plan_from_map = truth.map_from_plan.inverse()
    places = plan_from_map.apply(np.array([(d.x, d.y) for d in topology.doors]).reshape(-1, 2))
    true = found = width = 0
    matched = np.zeros(len(places), dtype=np.bool_)
    for door in truth.doors:
        away = np.linalg.norm(places - door.place, axis=1)
        matched |= away <= NEAR_M
        if door.counts and between_submaps(regions, truth.map_from_plan.apply(door.sides)):
            true += 1
            if away.min(initial=np.inf) <= NEAR_M:
                found += 1
                reported = topology.doors[int(np.argmin(away))]
                width += abs(reported.width_m - door.width_m) <= WIDTH_M
    unknown = [(p, d) for p, d, m in zip(places, topology.doors, matched, strict=True) if not m]
    odd = [(p, d) for p, d in unknown if not has(truth.bare, p, d)]
    false = sum(not has(truth.plan, place, door) for place, door in odd)
    return DoorScores(true, found, len(places), false, len(odd) - false, width)


def has(plan: GridMap, place: FloatArray, door: Door) -> bool:
    """Whether a plan has a narrow place of about the width of a door there."""
    return abs(narrowest(plan, place) - door.width_m) <= FALSE_WIDTH_M


def between_submaps(regions: Regions, sides: FloatArray) -> bool:
    """Whether both sides of a true door (2, 2) belong to submaps, and not to the same."""
    cells = regions.grid.cells_of(sides)
    if not regions.grid.inside(cells).all():
        return False
    one, other = regions.owner[tuple(cells.T)].tolist()
    return bool(one != other and min(one, other) >= 0)


def checked(topology: TopologicalMap, grid: GridMap) -> DoorScores:
    """Ways and anchors against the cells of the map, by another distance than theirs."""
    config = WaysConfig()
    away = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1]
    room = (away - 0.5) * grid.resolution
    edges = list(topology.edges.values())
    paths = [edge.path for edge in edges if edge.path is not None]
    kept = [least(room, grid, points_on(path)) >= config.robot_radius_m for path in paths]
    too_wide = sum(edge.path is None for edge in edges)
    anchors = [s.anchor for s in topology.submaps.values() if s.anchor is not None]
    kept_m = config.robot_radius_m + PLACE_MARGIN_M
    good = sum(least(room, grid, np.array([anchor])) >= kept_m - 1e-9 for anchor in anchors)
    return DoorScores(
        edges=len(edges),
        ways=sum(kept),
        too_wide=too_wide,
        wrong=len(kept) - sum(kept),
        anchors=len(anchors),
        good=good,
    )


def points_on(path: FloatArray) -> FloatArray:
    """Points (n, 2) along a path, close together."""
    pieces = []
    for a, b in pairwise(path):
        count = 2 + int(np.linalg.norm(b - a) / POINTS_M)
        pieces.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    return np.concatenate(pieces)


def least(room: FloatArray, grid: GridMap, points: FloatArray) -> float:
    """The least room (H, W) of the cells under some points (n, 2)."""
    return float(room[tuple(grid.cells_of(points).T)].min())

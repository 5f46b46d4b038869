"""A building of 300 rooms against one of 50: what a map costs, and how right it is.

The floor plans of $SPECMAP_DATA/rooms stand side by side, joined by corridors to those next to
them; where there are more rooms to have than plans, mirrored ones follow. A robot with odometry
tours the building once; another tour of 200 s is localised in its map. A label is right when a
keyframe of that submap was taken in sight of the scan and within a metre, or, where none was so
near, is the nearest one in sight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from benchmarks.cost.pairs import told
from benchmarks.data import RESOLUTION_M, plan, rooms_of
from benchmarks.localized import localized
from benchmarks.scoreboard.bench import Bench, build
from benchmarks.scoreboard.rows import Figures, Row
from benchmarks.scores import map_scores
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.evaluation.trajectories import associate, reference_errors
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap, cast_rays
from specmap_cli.maps.store import read_map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.simulation.tours import reachable_space
from specmap_cli.simulation.worlds import RoomTruth, World

PLANS = (
    *("Freiburg52_scan", "Freiburg79_scan", "lab_c_scan", "lab_intel", "office_a", "office_h"),
    *("office_e", "office_c", "lab_a_scan", "NLB"),
)
_GAP = 30  # cells between two plans, at the least
_CORRIDOR = 25  # cells
_JOINTS = 2  # corridors from a plan to those before it: there are ways round
_NEAR_M, _SIGHT_M = 1.0, 10.0  # of keyframes, from another scan
_TOUR = {"beams": 361, "rate_hz": 4.0, "speed_mps": 0.8, "spacing_m": 3.0}
_AGAIN_S = 200.0


@dataclass(frozen=True, slots=True)
class Building:
    """A plan and its rooms."""

    plan: GridMap
    rooms: RoomTruth


ROWS = (
    Row("scan", "300 rooms: processor time a scan, times 50 rooms", 1.3, 1.1, "less", ".2f"),
    Row("memory", "300 rooms: memory", better="less", form=",.0f", unit="MB"),
    Row("whole", "300 rooms: rooms in at most two submaps"),
    Row("ate", "300 rooms: ATE", better="less", form=".2f", unit="m"),
    Row("labels", "300 rooms: labels of another tour that are right"),
)


def measure(bench: Bench) -> Figures:
    """A small building and a large one."""
    with bench.scratch("scale") as folder:
        small_ms, _ = _built(building(50), folder)
        large = building(300)
        large_ms, memory_mb = _built(large, folder)
        stored, true = read_map(folder / "map"), read_tum(folder / "tour.tum")
        labelled, row = associate(true.stamps_ns, stored.labels.stamps_ns)
        found = map_scores(large.rooms, true.poses[row], stored.labels.submaps[labelled])
        error = reference_errors(read_tum(folder / "map" / "trajectory.tum"), true)
        right = _localized(large.plan, folder)
    return {
        "scan": large_ms / small_ms,
        "memory": memory_mb,
        "whole": found.whole,
        "ate": error.ate_m,
        "labels": right,
    }


def _built(made: Building, folder: Path) -> tuple[float, float]:
    """Build the map of a tour: milliseconds of processor time a scan, megabytes."""
    tour = simulate(made.plan, SimulationOptions(**_TOUR, seed=1), folder / "tour.mcap")
    cost = build(tour.log, folder / "map")
    print(f"{made.rooms.count} rooms, {tour.scans:,} scans: {told(cost)}", flush=True)
    return 1000.0 * cost.processor_s / tour.scans, cost.together_mb


def _localized(world: GridMap, folder: Path) -> float:
    """The share of right labels on another tour."""
    options = SimulationOptions(**_TOUR, seed=2, max_duration_s=_AGAIN_S)
    again = simulate(world, options, folder / "again.mcap")
    said = localized(read_map(folder / "map"), again.log, folder)
    assert said is not None, "the laser of the map is not refused"
    return float(np.mean(list(_right(said.filtered, read_tum(again.truth).poses, world, folder))))


def _right(labels: IntArray, places: FloatArray, world: GridMap, folder: Path) -> Iterator[bool]:
    """Whether each label (n,), NaN where unknown, is that of a keyframe near its true place."""
    stored, true = read_map(folder / "map"), read_tum(folder / "tour.tum")
    labelled, row = associate(true.stamps_ns, stored.labels.stamps_ns)
    submaps, spots = stored.labels.submaps[labelled], true.poses[row, :2]
    walls = world.obstacle_distance()
    around = cKDTree(spots).query_ball_point(places[:, :2], _SIGHT_M)
    for label, place, keyframes in zip(labels, places[:, :2], around, strict=True):
        away = spots[keyframes] - place
        metres, angles = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
        starts = np.tile(place, (len(away), 1))
        clear = cast_rays(walls, world, starts, angles, _SIGHT_M) >= metres
        reach_m = max(_NEAR_M, float(metres[clear].min(initial=np.inf)))
        near = clear & (metres <= min(reach_m, _SIGHT_M))
        yield bool(np.isin(label, submaps[keyframes][near]))


def building(count: int) -> Building:
    """The first plans that have `count` rooms together, or about as many."""
    return joined(list(_tiles(count)))


def _tiles(count: int) -> Iterator[Building]:
    """Plans until their rooms are as many as wanted, give or take half of the last one's."""
    rooms, number = 0, 0
    while True:
        name, mirrored = PLANS[number % len(PLANS)], number // len(PLANS) % 2 == 1
        turn = slice(None, None, -1 if mirrored else 1)
        cells, truth = plan(name).cells[:, turn], rooms_of(name).labels[:, turn]
        if rooms + int(truth.max()) // 2 > count:
            return
        yield Building(GridMap(cells, RESOLUTION_M), RoomTruth(truth, RESOLUTION_M))
        rooms, number = rooms + int(truth.max()), number + 1


def joined(tiles: Sequence[Building]) -> Building:
    """Plans in rows, each joined by corridors to those before it that are nearest."""
    corners, shape = _places([tile.plan.cells.shape for tile in tiles])
    cells = np.full(shape, OCCUPIED, dtype=np.uint8)
    rooms = np.zeros(shape, dtype=np.int32)
    grounds: list[FloatArray] = []
    for tile, (row, column) in zip(tiles, corners, strict=True):
        height, width = tile.plan.cells.shape
        part = np.s_[row : row + height, column : column + width]
        cells[part] = np.where(tile.plan.free, FREE, OCCUPIED)
        rooms[part] = np.where(tile.rooms.labels, tile.rooms.labels + rooms.max(), 0)
        space = reachable_space(World.of(tile.plan), 0.25, 0.8).points
        grounds.append(np.rint(space / RESOLUTION_M) + (column, row))
        for a, b in _joints(grounds):
            cv2.line(cells, a, b, FREE, _CORRIDOR)
    return Building(GridMap(cells, RESOLUTION_M), RoomTruth(rooms, RESOLUTION_M))


def _places(shapes: Sequence[tuple[int, ...]]) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Lower left cells of plans set in rows of about the width of the whole, and its shape."""
    wide = int(np.sqrt(sum((h + _GAP) * (w + _GAP) for h, w in shapes)))
    corners, row, column, tall, width = [], _GAP, _GAP, 0, 0
    for h, w in shapes:
        if column > wide:
            row, column, tall = row + tall + _GAP, _GAP, 0
        corners.append((row, column))
        column, tall, width = column + w + _GAP, max(tall, h), max(width, column + w + _GAP)
    return corners, (row + tall + _GAP, width)


def _joints(grounds: Sequence[FloatArray]) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Nearest cells (x, y) of the last plan's ground and those of the plans next to it."""
    new, pairs = grounds[-1], []
    for old in grounds[:-1]:
        distances, nearest = cKDTree(old).query(new)
        at = int(distances.argmin())
        a, b = new[at].astype(int).tolist(), old[int(nearest[at])].astype(int).tolist()
        pairs.append((float(distances[at]), (a[0], a[1]), (b[0], b[1])))
    for _, a, b in sorted(pairs)[:_JOINTS]:
        yield a, b

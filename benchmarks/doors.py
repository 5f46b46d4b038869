"""Doors, anchors and ways of maps: against the doors of plans, and against the cells of the maps.

    OMP_NUM_THREADS=1 python -m benchmarks.doors [--only plans tours logs]

Floor plans (as they are and furnished), maps of simulated tours through them, maps of real logs.
Doors: how many there truly are between the submaps of the map, how many of these were found, how
many were reported, how many of them where the plan has no narrow place (false), how many where only
its furniture makes one (desks), and for how many the width is right to 0.10 m. Doors between rooms
that are one submap do not count. Ways: how many edges have one, each
point of which keeps the robot's radius off what is not free, how many say why not, how many do not
keep it; anchors that keep radius and margin; processor seconds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.data import TRUTH, data_folder, log_file, plan, rooms_of
from benchmarks.door_truth import TrueDoor, narrowest, true_doors
from benchmarks.sample_tour import SAMPLE_LOG, SAMPLE_TRUTH, sample_rooms
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, nearest_motion
from specmap_cli.core.settings import Config, WaysConfig
from specmap_cli.evaluation.trajectories import associate, read_tum
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.segmentation.floorplan import segment_floorplan
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import Door, Submap, TopologicalMap

TOURS = ("Freiburg52_scan", "Freiburg79_scan", "Freiburg79_scan_furnitures", "lab_c_scan")
LOGS = ("fr079", "mit_csail", "fr079_3d")
NEAR_M = 0.7  # from a door to the true one: walls are up to half a metre thick
WIDTH_M = 0.10
FALSE_WIDTH_M = 0.2  # what the plan has there may differ so much in width
POINTS_M = 0.01  # between the points of a way that are looked at


@dataclass(frozen=True, slots=True)
class Row:
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
    seconds: float = 0.0

    def __add__(self, other: Row) -> Row:
        return Row(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@dataclass(frozen=True, slots=True)
class Truth:
    """The doors of the plan of a map, that plan with and without furniture, and where it lies."""

    doors: list[TrueDoor]
    plan: GridMap
    bare: GridMap
    map_from_plan: Pose2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=tuple(KINDS), default=tuple(KINDS))
    arguments = parser.parse_args()
    print(f"{'':34}" + "".join(f"{field.name:>9}" for field in fields(Row)))
    for kind in arguments.only:
        total = Row()
        for name, row in KINDS[kind]():
            print(line(f"{kind:6} {name}", row), flush=True)
            total += row
        print(line(f"{kind:6} all", total), shares(total), flush=True)


def line(name: str, row: Row) -> str:
    return f"{name:34}" + "".join(f"{round(value, 2):9}" for value in astuple(row))


def shares(row: Row) -> str:
    """What the figures of doors come to."""
    if not row.true:
        return ""
    return (
        f"  found {row.found / row.true:.3f}, false {row.false / row.reported:.3f}, "
        f"between furniture {row.desks / row.reported:.3f}, width {row.width / row.found:.3f}"
    )


def plans() -> Iterator[tuple[str, Row]]:
    """Each floor plan of the data, plain and furnished."""
    for file in sorted((data_folder() / "rooms").glob("*" + TRUTH)):
        bare = file.name.removesuffix(TRUTH)
        doors = true_doors(plan(bare), rooms_of(bare))
        for name in (bare, bare + "_furnitures"):
            grid, config = plan(name), Config()
            labels = segment_floorplan(grid, config.segmentation).segmentation.labels
            regions = Regions.of(grid, labels.astype(np.int64))
            yield name, scored(regions, Truth(doors, grid, plan(bare), Pose2(0.0, 0.0, 0.0)))


def tours() -> Iterator[tuple[str, Row]]:
    """The sample log, and tours through four plans."""
    sample = read_grid(Path("sample_logs/office.yaml"))
    with tempfile.TemporaryDirectory() as folder:
        doors = true_doors(sample, sample_rooms())
        plans_of_it = doors, sample, sample
        yield "sample_logs/office", of_log(SAMPLE_LOG, Path(folder), SAMPLE_TRUTH, *plans_of_it)
    for name in TOURS:
        bare = name.removesuffix("_furnitures")
        doors = true_doors(plan(bare), rooms_of(bare))
        options = SimulationOptions(beams=541, speed_mps=0.8, spacing_m=3.0, seed=3)
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "tour.mcap"
            made = simulate(plan(name), options, log)
            yield name, of_log(log, Path(folder), made.truth, doors, plan(name), plan(bare))


def logs() -> Iterator[tuple[str, Row]]:
    """Real logs, whose doors nobody measured."""
    for name in LOGS:
        with tempfile.TemporaryDirectory() as folder:
            build_map([log_file(name)], Path(folder) / "map")
            stored = read_map(Path(folder) / "map")
            yield name, checked(stored.topology, stored.map_grid)


KINDS = {"plans": plans, "tours": tours, "logs": logs}


def of_log(
    log: Path, folder: Path, truth: Path, doors: list[TrueDoor], driven: GridMap, bare: GridMap
) -> Row:
    """The figures of the map that is built of a log."""
    build_map([log], folder / "map")
    stored = read_map(folder / "map")
    placed = Truth(doors, driven, bare, map_from_plan(stored, truth))
    row = against(stored.topology, stored.regions, placed)
    return row + checked(stored.topology, stored.map_grid)


def map_from_plan(stored: StoredMap, truth: Path) -> Pose2:
    """Where the plan lies in the map: by the true poses of the keyframes."""
    true = read_tum(truth)
    keyframes, rows = associate(true.stamps_ns, stored.labels.stamps_ns)
    return nearest_motion(true.poses[rows, :2], stored.labels.poses[keyframes, :2])


def scored(regions: Regions, truth: Truth) -> Row:
    """The figures of a divided plan."""
    start = time.process_time()
    topology = with_ways(empty(regions), regions, WaysConfig(), kind="doorway")
    seconds = time.process_time() - start
    row = against(topology, regions, truth) + checked(topology, regions.grid)
    return row + Row(seconds=seconds)


def empty(regions: Regions) -> TopologicalMap:
    """The submaps of some regions, without an edge."""
    return TopologicalMap(
        submaps={
            id_: Submap(id=id_, map_from_submap=IDENTITY, grid=regions.grid)
            for id_ in regions.outlines
        }
    )


def against(topology: TopologicalMap, regions: Regions, truth: Truth) -> Row:
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
    return Row(true, found, len(places), false, len(odd) - false, width)


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


def checked(topology: TopologicalMap, grid: GridMap) -> Row:
    """Ways and anchors against the cells of the map, by another distance than theirs."""
    config = WaysConfig()
    away = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1]
    room = (away - 0.5) * grid.resolution
    edges = list(topology.edges.values())
    paths = [edge.path for edge in edges if edge.path is not None]
    kept = [least(room, grid, points_on(path)) >= config.robot_radius_m for path in paths]
    too_wide = sum(edge.path is None for edge in edges)
    anchors = [s.anchor for s in topology.submaps.values() if s.anchor is not None]
    kept_m = config.robot_radius_m + config.margin_m
    good = sum(least(room, grid, np.array([anchor])) >= kept_m - 1e-9 for anchor in anchors)
    return Row(
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


if __name__ == "__main__":
    main()

"""Whole maps of simulated tours, against the rooms, the doors and the poses that are true.

The sample office, two plans of Bormann et al. (ICRA 2016), and furnished random plans, each of
these with another laser (180 to 360 degrees, 4 to 30 m) and drift, one without odometry. A room is
whole in at most two submaps. A door driven through is found when it joins two submaps; invented is
a link between rooms that no door joins. Then random plans driven with depth cameras and odometry:
as planar scans of 58 to 110 degrees that reach 4 to 10 m, and as clouds with the floor in view, of
one camera and of several that are merged; and with lidars of 16 rings that spin while they drive.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.data import RESOLUTION_M, SAMPLES, plan, rooms_of
from benchmarks.making.buildings import BUILDINGS
from benchmarks.making.drawing import Drawing
from benchmarks.making.recordings import write
from benchmarks.making.spoiling import without_odometry
from benchmarks.scoreboard.bench import Bench, verdict_of
from benchmarks.scoreboard.rows import Figure, Figures, Row
from benchmarks.scores import MapScores, map_scores
from benchmarks.simulated.door_truth import true_doors
from benchmarks.simulated.doors import DoorScores, Truth, against, checked, map_from_plan
from benchmarks.simulated.plans import random_plan
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation.trajectories import associate, reference_errors
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import read_map
from specmap_cli.maps.text_files import read_tum, trajectory_text
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour, stamp_of
from specmap_cli.simulation.worlds import RoomTruth

TOURS = ("Freiburg79_scan_furnitures", "lab_c_scan")
RANDOM = (("office", 1001), ("ring", 1002), ("hall", 1003), ("flat", 1004))
DEPTH = tuple((kind, number) for number in (3301, 3302) for kind in BUILDINGS)
CLOUDS = tuple((kind, 5801) for kind in BUILDINGS)
CAMERA = {
    "beams": 240,
    "rings": 40,
    "vertical_fov_deg": 58.0,
    "laser_height_m": 0.4,
    "rate_hz": 5.0,
    "max_duration_s": 200.0,
}
SENSORS: dict[str, dict[str, float]] = {
    "camera": CAMERA,
    "merged": CAMERA | {"beams": 720, "field_of_view_deg": 240.0},  # three that see it together
    "lidar": {
        "beams": 720,
        "rings": 16,
        "field_of_view_deg": 360.0,
        "vertical_fov_deg": 30.0,
        "range_max_m": 30.0,
        "laser_height_m": 0.4,
        "rate_hz": 10.0,
        "sweep_s": 0.1,
        "speed_mps": 1.2,
        "max_duration_s": 200.0,
    },
}
_RIGHT_M = 0.3
_LAPS = SimulationOptions(beams=541, speed_mps=0.8, spacing_m=3.0, laps=2, seed=3)

ROWS = (
    Row("whole", "rooms in at most two submaps, 3 tours", 1.0),
    Row("recognised", "rooms recognised on the second lap, 3 tours"),
    Row("purity", "keyframes in the commonest room of their submap"),
    Row("links", "doors driven through that are links", 1.0),
    Row("invented", "links that no door makes", 0, 0, "less", ".0f"),
    Row("doors", "doors of the maps found", 0.95),
    Row("false_doors", "doors where the plan has none", 0, 0, "less", ".0f"),
    Row("ways_wrong", "ways that touch what is not free", 0, 0, "less", ".0f"),
    Row("ate", "the largest ATE, 3 tours", 0.1, None, "less", unit="m"),
    Row(
        "random_ate",
        "four random plans: the largest ATE of those with odometry",
        0.3,
        None,
        "less",
        unit="m",
    ),
    Row("random_links", "four random plans: doors driven through that are links", 0.95),
    Row("random_verdicts", "four random plans: verdicts that are right", 1.0),
    Row("depth_ate", "eight depth cameras: median ATE", 0.3, 0.15, "less", unit="m"),
    Row("depth_silent", "eight depth cameras: maps .3 m off called good", 0, 0, "less", ".0f"),
    Row(
        "cloud_ate",
        "eight clouds of depth cameras, four merged: median ATE",
        0.3,
        0.15,
        "less",
        unit="m",
    ),
    Row("cloud_silent", "eight clouds: maps .3 m off called good", 0, 0, "less", ".0f"),
    Row("lidar_ate", "four spinning lidars at 1.2 m/s: median ATE", 0.1, 0.05, "less", unit="m"),
    Row("lidar_silent", "four lidars: maps .3 m off called good", 0, 0, "less", ".0f"),
)


@dataclass(frozen=True, slots=True)
class Tour:
    """A recording of a plan with its truth, and the map that was built of it."""

    name: str
    map_: Path
    truth: Path
    driven: GridMap
    rooms: RoomTruth
    measured: bool = True


def measure(bench: Bench) -> Figures:
    """Build the map of every tour and score it."""
    print(
        "tour                           submaps whole recognised purity links invented ATE verdict"
    )
    scores, doors, off = list[MapScores](), DoorScores(), list[float]()
    for tour in drawn(bench):
        scores.append(scored(tour))
        off.append(error(tour))
        doors += doors_of(tour)
        print(line(tour, scores[-1], off[-1]), flush=True)
    print(doors)
    random_scores, random_off, right = list[MapScores](), list[float](), 0
    for tour in random_tours(bench):
        random_scores.append(scored(tour))
        off_m = error(tour)
        random_off += [off_m] if tour.measured else []
        right += (off_m <= _RIGHT_M) == (verdict_of(tour.map_) == "good")
        print(line(tour, random_scores[-1], off_m), flush=True)
    views = {"depth": depth_tours(bench), "cloud": cloud_tours(bench, ("camera", "merged"))}
    of_views: dict[str, float] = {}
    for what, tours in {**views, "lidar": cloud_tours(bench, ("lidar",))}.items():
        found = [(tour.name, error(tour), verdict_of(tour.map_)) for tour in tours]
        for name, off_m, told in found:
            print(f"{name:30} ATE {off_m:.3f} {told}", flush=True)
        of_views[f"{what}_ate"] = float(np.median([off_m for _, off_m, _ in found]))
        silent = [off_m > _RIGHT_M and told == "good" for _, off_m, told in found]
        of_views[f"{what}_silent"] = sum(silent)
    return {
        "whole": float(np.mean([one.whole for one in scores])),
        "recognised": float(np.mean([one.recognised for one in scores])),
        "purity": float(np.mean([one.purity for one in scores])),
        "links": _links(scores),
        "invented": sum(one.invented for one in scores),
        "doors": doors.found / max(1, doors.true),
        "false_doors": doors.false,
        "ways_wrong": doors.wrong,
        "ate": max(off),
        "random_ate": max(random_off),
        "random_links": _links(random_scores),
        "random_verdicts": right / len(RANDOM),
        **of_views,
    }


def _links(scores: list[MapScores]) -> Figure:
    found, doors = sum(one.found for one in scores), sum(one.doors for one in scores)
    return Figure(found / doors, note=f"{found} of {doors}")


def drawn(bench: Bench) -> Iterator[Tour]:
    """The sample office, and tours through plans drawn by hand."""
    sample = SAMPLES / "office.mcap"
    made = bench.simulated("office-sample", lambda log: log.symlink_to(sample))
    yield Tour(
        "sample office", made, sample.with_suffix(".tum"), plan("office"), rooms_of("office")
    )
    for name in TOURS:
        made = bench.simulated(f"{name}-laps", partial(simulate, plan(name), _LAPS))
        truth = bench.log(f"{name}-laps").with_suffix(".tum")
        yield Tour(name, made, truth, plan(name), rooms_of(name))


def random_tours(bench: Bench) -> Iterator[Tour]:
    """Tours through random plans by robots drawn at random; every fourth has no odometry."""
    for kind, number in RANDOM:
        drawing, measured = random_plan(kind, number, furnished=True), bool(number % 4)
        yield _toured(bench, f"{kind}-{number}", drawing, robot(kind, number), measured)


def depth_tours(bench: Bench) -> Iterator[Tour]:
    """Tours through random plans by robots with a depth camera."""
    for kind, number in DEPTH:
        drawing, options = random_plan(kind, number, furnished=True), depth_camera(kind, number)
        yield _toured(bench, f"depth-{kind}-{number}", drawing, options, measured=True)


def cloud_tours(bench: Bench, kinds: Sequence[str]) -> Iterator[Tour]:
    """Tours through random plans by robots with a sensor that sends clouds, floor and all."""
    for (building, number), kind in product(CLOUDS, kinds):
        drawing = random_plan(building, number, furnished=True)
        options = depth_camera(building, number).model_copy(update=SENSORS[kind])
        yield _toured(bench, f"{kind}-{building}-{number}", drawing, options, measured=True)


def _toured(
    bench: Bench, name: str, drawing: Drawing, options: SimulationOptions, measured: bool
) -> Tour:
    record = simulate if options.rings > 1 else partial(recorded, measured=measured)
    made = bench.simulated(name, partial(record, drawing.grid(), options))
    rooms = RoomTruth(drawing.labels + 1, RESOLUTION_M, drawing.grid().origin)
    truth = bench.log(name).with_suffix(".tum")
    return Tour(name, made, truth, drawing.grid(), rooms, measured)


def robot(kind: str, number: int) -> SimulationOptions:
    """The robot that drives through a random plan."""
    rng = np.random.default_rng([number, 2, list(BUILDINGS).index(kind)])
    return SimulationOptions(
        field_of_view_deg=float(rng.choice((180.0, 240.0, 270.0, 360.0))),
        beams=int(rng.choice((180, 360, 720, 1080))),
        range_max_m=float(rng.choice((4.0, 8.0, 10.0, 20.0, 30.0))),
        noise_m=float(rng.choice((0.005, 0.01, 0.02, 0.03))),
        odometry_drift=float(rng.choice((1.0, 2.0, 4.0))),
        rate_hz=5.0,
        speed_mps=0.8,
        spacing_m=3.0,
        max_duration_s=400.0,
        seed=number,
    )


def depth_camera(kind: str, number: int) -> SimulationOptions:
    """The robot with a depth camera that drives through a random plan."""
    rng = np.random.default_rng([number, 7, list(BUILDINGS).index(kind)])
    return SimulationOptions(
        field_of_view_deg=float(rng.choice((58.0, 70.0, 87.0, 110.0))),
        beams=int(rng.choice((320, 640))),
        range_max_m=float(rng.choice((4.0, 6.0, 8.0, 10.0))),
        noise_m=float(rng.choice((0.02, 0.03))),
        dropouts=0.05,
        odometry_drift=float(rng.choice((1.0, 2.0, 3.0))),
        rate_hz=float(rng.choice((5.0, 10.0))),
        speed_mps=float(rng.choice((0.25, 0.5, 0.8))),
        spacing_m=float(rng.choice((2.0, 3.0))),
        max_duration_s=400.0,
        seed=number,
    )


def recorded(grid: GridMap, options: SimulationOptions, log: Path, *, measured: bool) -> None:
    """The recording of a tour, with or without odometry, its true poses beside it."""
    tour = simulated_tour(grid, options)
    write((sweep for sweep, _ in tour.scans()), iter if measured else without_odometry, log)
    stamps = np.array([stamp_of(time) for time in tour.scan_times_s.tolist()])
    truth = Trajectory(stamps, tour.truth.at(tour.scan_times_s))
    log.with_suffix(".tum").write_text(trajectory_text(truth), encoding="ascii")


def scored(tour: Tour) -> MapScores:
    """The rooms of a plan against the submaps of its map."""
    labels, true = read_map(tour.map_).labels, read_tum(tour.truth)
    labelled, row = associate(true.stamps_ns, labels.stamps_ns)
    return map_scores(tour.rooms, true.poses[row], labels.submaps[labelled])


def error(tour: Tour) -> float:
    """The absolute error of the trajectory of a map."""
    found = read_tum(tour.map_ / "trajectory.tum")
    return reference_errors(found, read_tum(tour.truth)).ate_m


def doors_of(tour: Tour) -> DoorScores:
    """The doors and ways of a map against those of its plan."""
    stored = read_map(tour.map_)
    bare = plan(tour.name.removesuffix("_furnitures")) if tour.name in TOURS else tour.driven
    placed = Truth(
        true_doors(bare, tour.rooms), tour.driven, bare, map_from_plan(stored, tour.truth)
    )
    found = against(stored.topology, stored.regions, placed)
    return found + checked(stored.topology, stored.map_grid)


def line(tour: Tour, scores: MapScores, off_m: float) -> str:
    """One row for reading."""
    submaps = len(read_map(tour.map_).ids)
    return (
        f"{tour.name:30} {submaps:7} {scores.whole:5.2f} {scores.recognised:10.2f} "
        f"{scores.purity:6.3f} {scores.found:2}/{scores.doors:<2} {scores.invented:8} {off_m:.3f} "
        f"{verdict_of(tour.map_)}"
    )

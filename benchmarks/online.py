"""Splitting while the robot moves, on simulated tours with known rooms.

    OMP_NUM_THREADS=1 python -m benchmarks.online [--preset paper] [--plan NAME] [--quick]

A laser of 180 degrees and 8 m and one of 360 degrees and 20 m tour four plans of
$SPECMAP_DATA/rooms with drifting odometry; the poses are those of the front end. Homogeneity is of
submaps against rooms, completeness of submaps against visits of a room, and segments per visit
counts every region that was split off (specmap_cli/evaluation/scores.py). The milliseconds (of
processor time) are those of taking in a keyframe with a test, whatever the test entails; they are
given for the first and for the last third of a log as well, since they must not grow with it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data import plan, rooms_of
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.scores import visit_scores, visits_of
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.registration import FrontEnd
from specmap_cli.segmentation.online import OnlineSegmenter, Region
from specmap_cli.simulation.room_truth import RoomTruth
from specmap_cli.simulation.simulator import SimulationOptions, simulate_sweeps

PLANS = ("Freiburg79_scan", "Freiburg79_scan_furnitures", "office_a", "lab_c_scan")
LASERS = ((180.0, 361, 8.0), (360.0, 720, 20.0))


@dataclass(frozen=True, slots=True)
class Row:
    plan: str
    laser: str
    homogeneity: float
    completeness: float
    segments_per_visit: float
    submaps_per_room: float
    test_ms: float
    first_third_ms: float
    last_third_ms: float
    tests: int
    metres: float
    drift_m: float


@dataclass(frozen=True, slots=True)
class Tour:
    """Keyframes with their poses by the front end, and where they truly were."""

    store: KeyframeStore
    truth: FloatArray
    breaks: list[int]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--plan", choices=PLANS, help="only this plan")
    parser.add_argument("--quick", action="store_true", help="the first 300 s of every tour")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    config = load_config(preset=arguments.preset)
    plans = PLANS if arguments.plan is None else (arguments.plan,)
    rows = []
    for name, laser in ((name, laser) for name in plans for laser in LASERS):
        rows.append(measure(name, laser, config, 300.0 if arguments.quick else None))
        print(line(rows[-1]), flush=True)
    numbers = np.array([list(asdict(row).values())[2:] for row in rows])
    rows.append(Row("mean", "", *numbers.mean(axis=0).tolist()))
    print(line(rows[-1]))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


def measure(
    name: str, laser: tuple[float, int, float], config: Config, seconds: float | None
) -> Row:
    """Drive one tour, split it on line, and compare with the rooms."""
    degrees, beams, reach = laser
    options = SimulationOptions(
        field_of_view_deg=degrees, beams=beams, range_max_m=reach, max_duration_s=seconds, seed=1
    )
    tour = drive(plan(name), options, config)
    with tour.store:
        return score(name, f"{degrees:.0f} deg {reach:.0f} m", tour, rooms_of(name), config)


def drive(world: GridMap, options: SimulationOptions, config: Config) -> Tour:
    """Register a simulated tour and keep its keyframes."""
    store = KeyframeStore()
    selector, front_end = KeyframeSelector(config.keyframes), FrontEnd(config.registration)
    truth: list[Pose2] = []
    breaks: list[int] = []
    for sweep, pose in simulate_sweeps(world, options):
        scan = front_end.register(sweep)
        if scan.restarted:
            breaks.append(len(store))
        if selector.accepts(scan):
            store.append(scan)
            truth.append(pose)
    return Tour(store, np.array(truth), breaks)


def score(name: str, laser: str, tour: Tour, rooms: RoomTruth, config: Config) -> Row:
    """Split the tour and hold the outcome against the rooms it went through."""
    durations: list[float] = []
    regions = list(split(tour, config, durations))
    submap, region_of = labels_of(regions, len(tour.truth))
    room = rooms.at(tour.truth, reach_m=np.inf)
    steps = np.hypot(*np.diff(tour.truth[:, :2], axis=0, prepend=tour.truth[:1, :2]).T)
    visits = visits_of(room, steps)
    scores = visit_scores(rooms=room, visits=visits, submaps=submap, regions=region_of)
    third = max(1, len(durations) // 3)
    return Row(
        plan=name,
        laser=laser,
        homogeneity=scores.homogeneity,
        completeness=scores.completeness,
        segments_per_visit=scores.segments_per_visit,
        submaps_per_room=len(np.unique(submap)) / len(np.unique(room)),
        test_ms=1e3 * float(np.mean(durations)),
        first_third_ms=1e3 * float(np.mean(durations[:third])),
        last_third_ms=1e3 * float(np.mean(durations[-third:])),
        tests=len(durations),
        metres=float(steps.sum()),
        drift_m=drift(tour),
    )


def split(tour: Tour, config: Config, durations: list[float]) -> Iterator[Region]:
    """All regions of a tour; `durations` gets the processor seconds of keyframes with a test."""
    tested: list[bool] = []
    segmenter = OnlineSegmenter(
        config.segmentation, config.grid, tour.store, lambda *_: tested.append(True)
    )
    for keyframe in range(len(tour.truth)):
        if keyframe in tour.breaks:
            yield from segmenter.flush()
        tested.clear()
        start = time.process_time()
        yield from segmenter.add(keyframe)
        if tested:
            durations.append(time.process_time() - start)
    yield from segmenter.flush()


def labels_of(regions: list[Region], keyframes: int) -> tuple[np.ndarray, np.ndarray]:
    """The submap and the region (n,) of every keyframe."""
    submap, region_of = np.full((2, keyframes), -1)
    for region in regions:
        rows = list(region.keyframes)
        region_of[rows] = region.number
        submap[rows] = region.number if region.continues is None else region.continues
    return submap, region_of


def drift(tour: Tour) -> float:
    """How far the front end's last pose is from the true one, the first being the same, metres."""
    first, last = Pose2(*tour.truth[0]), Pose2(*tour.truth[-1])
    found = tour.store.pose(0).inverse() @ tour.store.pose(len(tour.truth) - 1)
    return (found.inverse() @ (first.inverse() @ last)).distance


def line(row: Row) -> str:
    """One row for reading."""
    return (
        f"{row.plan:27} {row.laser:13} homogeneity {row.homogeneity:.3f} completeness "
        f"{row.completeness:.3f} segments/visit {row.segments_per_visit:.2f} submaps/room "
        f"{row.submaps_per_room:.2f} test {row.test_ms:.1f} ms ({row.first_third_ms:.1f} first, "
        f"{row.last_third_ms:.1f} last third) {row.metres:.0f} m, drift {row.drift_m:.2f} m"
    )


if __name__ == "__main__":
    main()

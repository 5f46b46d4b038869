"""Splitting while the robot moves, on simulated tours with known rooms.

The poses are those of the front end, with drifting odometry. Homogeneity is of submaps against
rooms, completeness of submaps against visits of a room, and segments per visit counts every region
that was split off (benchmarks/scores.py). The milliseconds (of processor time) are
those of taking in a keyframe with a test, whatever the test entails.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.data import plan, rooms_of
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from benchmarks.scores import VisitScores, visit_scores, visits_of
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.registration import FrontEnd
from specmap_cli.segmentation.online import OnlineSegmenter, Region
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour
from specmap_cli.simulation.worlds import RoomTruth

CASES = (
    ("Freiburg79_scan_furnitures", 180.0, 361, 8.0),
    ("office_a", 360.0, 720, 20.0),
    ("lab_c_scan", 180.0, 361, 8.0),
)
LONGEST_S = 300.0

ROWS = (
    Row("homogeneity", "homogeneity, 3 tours", 0.95),
    Row("completeness", "completeness", 0.93),
    Row("segments", "segments per visit", 1.2, 1.0, "less", ".2f"),
    Row("test_ms", "a keyframe with a test", better="less", form=".1f", unit="ms"),
    Row("growth", "tests in the last third of a log against the first", 1.5, 1.0, "less", ".2f"),
)


@dataclass(frozen=True, slots=True)
class Tour:
    """Keyframes with their poses by the front end, and where they truly were."""

    store: KeyframeStore
    truth: FloatArray
    breaks: list[int]


def measure(_: Bench) -> Figures:
    """Drive every tour, split it on line, and compare with the rooms."""
    config, scores, times = load_config(), list[VisitScores](), list[list[float]]()
    for name, degrees, beams, reach in CASES:
        options = SimulationOptions(
            field_of_view_deg=degrees,
            beams=beams,
            range_max_m=reach,
            max_duration_s=LONGEST_S,
            seed=1,
        )
        tour = drive(plan(name), options, config)
        with tour.store:
            found, durations = scored(tour, rooms_of(name), config)
        scores.append(found)
        times.append(durations)
        print(f"{name:28} {degrees:3.0f} {found}  {len(durations)} tests", flush=True)
    thirds = [len(some) // 3 for some in times]
    first = np.concatenate([some[:n] for some, n in zip(times, thirds, strict=True)])
    last = np.concatenate([some[-n:] for some, n in zip(times, thirds, strict=True)])
    return {
        "homogeneity": float(np.mean([one.homogeneity for one in scores])),
        "completeness": float(np.mean([one.completeness for one in scores])),
        "segments": float(np.mean([one.segments_per_visit for one in scores])),
        "test_ms": Figure(1e3 * float(np.mean(np.concatenate(times)))),
        "growth": float(last.mean() / first.mean()),
    }


def drive(world: GridMap, options: SimulationOptions, config: Config) -> Tour:
    """Register a simulated tour and keep its keyframes."""
    store = KeyframeStore()
    selector, front_end = KeyframeSelector(config.keyframes), FrontEnd(config.registration)
    truth: list[Pose2] = []
    breaks: list[int] = []
    for sweep, pose in simulated_tour(world, options).scans():
        scan = front_end.register(sweep)
        if scan.restarted:
            breaks.append(len(store))
        if selector.accepts(scan):
            store.append(scan)
            truth.append(pose)
    return Tour(store, np.array(truth), breaks)


def scored(tour: Tour, rooms: RoomTruth, config: Config) -> tuple[VisitScores, list[float]]:
    """Split a tour and hold it against its rooms; the seconds of each keyframe with a test."""
    durations: list[float] = []
    submap, region = labels_of(list(split(tour, config, durations)), len(tour.truth))
    room = rooms.at(tour.truth, reach_m=np.inf)
    steps = np.hypot(*np.diff(tour.truth[:, :2], axis=0, prepend=tour.truth[:1, :2]).T)
    visits = visits_of(room, steps)
    return visit_scores(rooms=room, visits=visits, submaps=submap, regions=region), durations


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

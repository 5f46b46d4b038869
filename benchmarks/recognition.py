"""Table II of the paper, loop closures against truth, other tours, and what recognition costs.

    OMP_NUM_THREADS=1 python -m benchmarks.recognition [--only PART ...] [--draws N] [--quick]

Table II: a fifth of the keyframes is held out of the whole build of a real log, single raw scans.
After the first draw's row comes the mean of `--draws` of them.
Closures: the build's merges and transforms against poses of others' full SLAM (good to 5 cm, each
steadied by its neighbours); a region comes back when two fifths of its track lie within a metre of
an earlier one's, and the other way round. The last figure is what the same constraints differ by
when each is made of the one half of the scans and of the other half: the rest of the error is the
truth's. Revisits: the same on simulated tours, whose poses are
known exactly; merges are those before the layout's veto. Tours: a map from one simulated tour at
true poses, labels on another tour by another way, and on one through another building. Seconds are
of processor time.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.closure_truth import STEADY, judged, true_poses
from benchmarks.data import RESOLUTION_M, log_file, plan, rooms_of, truth_file
from benchmarks.hold_outs import LOGS, table2
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import Pose2, compose, invert
from specmap_cli.core.labels import neighbours
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.classification import classification_scores
from specmap_cli.grids.gridmap import GridMap, PackedGrid
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore, integrate_keyframes
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.build import explore, explore_log, map_log
from specmap_cli.pipelines.exploration import Exploration, Explored
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.recognition.closure.loop_closer import LoopCloser
from specmap_cli.recognition.closure.stay import Stay
from specmap_cli.recognition.features.sets import feature_names, scans_features
from specmap_cli.recognition.learning.training import train_localizer
from specmap_cli.recognition.localization.localizer import Localizer
from specmap_cli.registration.frontend import FrontEnd
from specmap_cli.simulation.room_truth import RoomTruth
from specmap_cli.simulation.simulator import SimulationOptions, simulate_sweeps

# Small buildings are driven through twice, so that there is something to find.
REVISITED = (
    ("lab_c_scan_furnitures", 2),
    ("lab_c_scan", 2),
    ("Freiburg52_scan_furnitures", 2),
    ("Freiburg79_scan_furnitures", 2),
    ("lab_intel", 2),
)
LONGEST_S = 1500.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    names = ("table2", "closures", "revisits", "tours", "cost")
    parser.add_argument("--only", nargs="+", choices=sorted(names), default=sorted(names))
    parser.add_argument("--draws", type=int, default=5, help="of held-out scans, for Table II")
    parser.add_argument("--quick", action="store_true", help="the smallest case of each, one draw")
    arguments = parser.parse_args()
    sections: dict[str, Callable[[bool], None]] = {
        "table2": partial(table2, draws=arguments.draws),
        "closures": closures,
        "revisits": revisits,
        "tours": tours,
        "cost": cost,
    }
    for name, run in sections.items():
        if name in arguments.only:
            run(arguments.quick)
            print()


def closures(quick: bool) -> None:
    print("closures          | submaps merges right | revisits found | constraints, error | halves")
    for name in LOGS[1:] if quick else LOGS:
        for preset in ("default",) if quick else ("default", "paper"):
            print(f"{name:<10}{preset:<8}| {_closures_of(name, preset)}", flush=True)


def _closures_of(name: str, preset: str) -> str:
    config = load_config(preset=preset)
    with KeyframeStore() as store:
        explored = _explored(name, config, store)
        truth = true_poses(truth_file(f"{name}_corrected.tum"), store)
        return str(judged(explored, store, truth, STEADY))


def revisits(quick: bool) -> None:
    print(
        "closures, simulated        | submaps merges right | revisits found | constraints | halves"
    )
    for name, laps in REVISITED[:1] if quick else REVISITED:
        for view in (360.0,) if quick else (180.0, 360.0):
            print(f"{name:<22}{view:4.0f} | {_revisits_of(name, view, laps)}", flush=True)


def _revisits_of(name: str, view: float, laps: int) -> str:
    """The closures of a tour that is registered as a log is, against its exact poses."""
    config, poses = load_config(), dict[int, Pose2]()
    options = tour_options(view, 0, laps=laps, max_duration_s=LONGEST_S)
    front_end = FrontEnd(config.registration)

    def scans() -> Iterator[PosedScan]:
        for sweep, pose in simulate_sweeps(plan(name), options):
            poses[sweep.stamp_ns] = pose
            yield front_end.register(sweep)

    with KeyframeStore() as store:
        exploration = Exploration(config, store, Stopwatch(), None)
        accepts = KeyframeSelector(config.keyframes).accepts
        explored = explore(scans(), exploration, accepts, Silent())
        return str(judged(explored, store, np.array([poses[s] for s in store.stamps_ns])))


def _explored(name: str, config: Config, store: KeyframeStore) -> Explored:
    with open_log(log_file(name)) as log:
        exploration = Exploration(config, store, Stopwatch(), None)
        accepts = KeyframeSelector(config.keyframes).accepts
        stream = SweepStream(log, config.log)
        return explore_log(stream, config, lambda: exploration, accepts, Silent())[0]


def tours(quick: bool) -> None:
    print("tours, new way             | raw recall precision | filtered | unknown: known foreign")
    cases = [("", 360.0), ("_furnitures", 180.0), ("_furnitures", 360.0)]
    for clutter, view in cases[:1] if quick else cases:
        print(f"Freiburg79{clutter:<12}{view:4.0f} | {_tour_row(clutter, view)}", flush=True)


def _tour_row(clutter: str, view: float) -> str:
    config = load_config()
    rooms = rooms_of("Freiburg79_scan")
    here, other = plan(f"Freiburg79_scan{clutter}"), plan(f"lab_c_scan{clutter}")
    first, again = tour_of(here, view, 0), tour_of(here, view, 11, spacing_m=2.6)
    fresh = localizer_of_tour(first, rooms, config)
    localizers = [fresh() for _ in range(2)]
    labels = [localizers[0].update(scan) for scan in again]
    truth = rooms.at(np.array([scan.map_from_base for scan in again]))
    ids = localizers[0].classifiers.ids
    raw = localizers[0].classifiers
    votes = raw.margins(scans_features([s.planar for s in again], raw.raw.feature_set))
    single = classification_scores(truth, np.array(ids)[votes.argmax(axis=1)], ids)
    filtered = classification_scores(truth, [label.filtered_submap for label in labels], ids)
    foreign = [localizers[1].update(scan) for scan in tour_of(other, view, 5)[:1500]]
    unknown = [np.mean([x.filtered_submap is None for x in part]) for part in (labels, foreign)]
    return (
        f"{single.recall:.3f} {single.precision:.3f} | {filtered.accuracy:.3f} | "
        f"{unknown[0]:.3f} {unknown[1]:.3f}"
    )


def tour_options(view: float, seed: int, **more: Any) -> SimulationOptions:
    """A tour with a laser that sees `view` degrees; a beam a degree if nothing else is said."""
    usual = {"field_of_view_deg": view, "beams": int(view), "rate_hz": 5.0, "seed": seed}
    return SimulationOptions(**(usual | more))


def tour_of(world: GridMap, view: float, seed: int, **more: Any) -> list[PosedScan]:
    """The scans of a tour at their true poses."""
    options = tour_options(view, seed, **more)
    return [
        PosedScan(
            index=s.index,
            stamp_ns=s.stamp_ns,
            map_from_base=pose,
            planar=s.planar,
            base_from_laser=s.base_from_laser,
        )
        for s, pose in simulate_sweeps(world, options)
    ]


def localizer_of_tour(
    tour: list[PosedScan], rooms: RoomTruth, config: Config
) -> Callable[[], Localizer]:
    """What makes localizers of the map of a tour, whose submaps are the rooms of the plan."""
    selector = KeyframeSelector(config.keyframes)
    with KeyframeStore() as store:
        for scan in tour:
            if selector.accepts(scan):
                store.append(scan)
        labels = rooms.at(store.poses)
        submaps = {int(i): np.flatnonzero(labels == i).tolist() for i in np.unique(labels) if i}
        grids: dict[int, GridMap] = {}
        frames = {i: Pose2(*store.poses[numbers[0]].tolist()) for i, numbers in submaps.items()}
        for i, numbers in submaps.items():
            track = compose(invert(store.poses[numbers[0]]), store.poses[numbers])
            grids[i] = integrate_keyframes(store, numbers, track, config.grid).snapshot()
        rng = np.random.default_rng(config.seed)
        trained = train_localizer(store, submaps, store.poses, grids, config, rng)
        tracks = {i: store.poses[numbers] for i, numbers in submaps.items()}
    driven = pairwise(labels.tolist())
    adjacency = neighbours(submaps, [(a, b) for a, b in driven if a in submaps and b in submaps])
    return lambda: Localizer(trained, adjacency, grids, config.localization, frames, tracks)


def cost(quick: bool) -> None:
    name = LOGS[1] if quick else LOGS[0]
    config = load_config()
    with open_log(log_file(name)) as log, KeyframeStore() as store:
        seconds = map_log(SweepStream(log, config.log), config, store, Silent()).seconds
    ours = seconds["recognition"] + seconds["training"]
    print(f"{name}: closing and training {ours:.1f} s of {sum(seconds.values()):.1f} s")
    print("  " + ", ".join(f"{stage} {value:.1f}" for stage, value in seconds.items()))
    _many_submaps(20 if quick else 300)


def _many_submaps(count: int) -> None:
    marks = closing_seconds(count, load_config())
    third = marks[count // 3] / (count // 3)
    print(
        f"{count} synthetic submaps: {marks[-1]:.1f} s in all, {1000 * third:.0f} ms a submap up "
        f"to the first third, the last took {1000 * (marks[-1] - marks[-2]):.0f} ms"
    )


def closing_seconds(count: int, config: Config, limit_s: float = math.inf) -> list[float]:
    """Processor seconds up to each of `count` submaps, of closing alone; at most some `limit_s`.

    They are synthetic, of 150 scans with features around their own centres.
    """
    rng = np.random.default_rng(0)
    width = len(feature_names(config.recognition.feature_set))
    loop = LoopCloser(config.recognition, rng)
    empty = PackedGrid.of(GridMap(np.full((4, 4), 2, dtype=np.uint8), RESOLUTION_M))
    started, marks = time.process_time(), []
    for number in range(count):
        features = rng.normal(rng.normal(0.0, 1.0, width), 0.7, (150, width))
        loop.consider(Stay(number=number, features=features, packed=empty, track=np.zeros((5, 3))))
        marks.append(time.process_time() - started)
        if marks[-1] > limit_s:
            break
    return marks


if __name__ == "__main__":
    main()

"""Table II of the paper, loop closures against truth, other tours, and what recognition costs.

    OMP_NUM_THREADS=1 python -m benchmarks.recognition [--only table2 closures tours cost] [--quick]

Table II: a fifth of the keyframes is held out of the whole build of a real log, single raw scans.
Closures: the build's merges and transforms against poses of others' full SLAM (good to 5 cm); a
region comes back when two fifths of its track lie within a metre of an earlier one's, and the other
way round. Tours: a map from one simulated tour at true poses, labels on another tour by another
way, and on one through another building. Seconds are of processor time.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.data import RESOLUTION_M, log_file, plan, rooms_of, truth_file
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle
from specmap_cli.core.labels import neighbours
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.classification import classification_scores
from specmap_cli.evaluation.protocols import HoldOut, hold_out
from specmap_cli.evaluation.trajectories import associate, read_tum
from specmap_cli.grids.gridmap import GridMap, PackedGrid
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore, integrate_keyframes
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.build import explore_log, map_log
from specmap_cli.pipelines.exploration import Exploration, Explored
from specmap_cli.pipelines.refutation import constraints_of
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.recognition.closure.loop_closer import LoopCloser
from specmap_cli.recognition.closure.stay import Stay
from specmap_cli.recognition.closure.verification import tracks_overlap
from specmap_cli.recognition.features.sets import feature_names, scans_features
from specmap_cli.recognition.learning.training import train_localizer
from specmap_cli.recognition.localization.localizer import Localizer
from specmap_cli.simulation.room_truth import RoomTruth
from specmap_cli.simulation.simulator import SimulationOptions, simulate_sweeps
from specmap_cli.topology.graph import submap_of_regions

LOGS = ("fr079", "mit_csail")
PAPER = {"fr079": (0.9728, 0.9818, 0.9089, 0.9212), "mit_csail": (0.9689, 0.9739, 0.83, 0.8458)}
REVISIT = 0.4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    sections = {"table2": table2, "closures": closures, "tours": tours, "cost": cost}
    parser.add_argument("--only", nargs="+", choices=sorted(sections), default=sorted(sections))
    parser.add_argument("--quick", action="store_true", help="the smallest case of each")
    arguments = parser.parse_args()
    for name, run in sections.items():
        if name in arguments.only:
            run(arguments.quick)
            print()


def table2(quick: bool) -> None:
    print("Table II         | training recall precision | test recall precision | filtered")
    for name in LOGS[1:] if quick else LOGS:
        row = PAPER[name]
        print(f"{name:<9} paper  | {row[0]:.3f} {row[1]:.3f} | {row[2]:.3f} {row[3]:.3f} |")
        for preset in ("default", "paper"):
            for options in (HoldOut(seed=0), HoldOut("blocks", seed=0)):
                if preset == "paper" and (quick or options.split == "blocks"):
                    continue
                result = hold_out([log_file(name)], load_config(preset=preset), options)
                print(
                    f"{name:<9} {preset} {options.split} | {result.train.recall:.3f} "
                    f"{result.train.precision:.3f} | {result.test.recall:.3f} "
                    f"{result.test.precision:.3f} | {result.filtered.accuracy:.3f} "
                    f"({len(result.test.ids)} submaps, {result.test.scans} scans)",
                    flush=True,
                )


def closures(quick: bool) -> None:
    print("closures          | submaps merges right | revisits found | constraints, wrong, error")
    for name in LOGS[1:] if quick else LOGS:
        for preset in ("default",) if quick else ("default", "paper"):
            print(f"{name:<10}{preset:<8}| {_closures_of(name, preset)}", flush=True)


def _closures_of(name: str, preset: str) -> str:
    config = load_config(preset=preset)
    with KeyframeStore() as store:
        explored = _explored(name, config, store)
        found = judged(explored, store, true_poses(truth_file(f"{name}_corrected.tum"), store))
    return (
        f"{found.regions} regions, {found.merges} merges, {found.right} right | "
        f"{found.found}/{found.revisits} | {found.constraints}, {found.wrong} wrong, "
        f"{found.error_cm:.1f} cm {found.error_deg:.2f} deg"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The closures of Algorithm 1 against the truth.

    `right` of the `merges` are of regions that share ground; `found` of the `revisits` were merged
    with a region of the same place. `wrong` of the `constraints` are off by more than 0.6 m or 7
    degrees; the errors are medians.
    """

    regions: int
    merges: int
    right: int
    found: int
    revisits: int
    constraints: int
    wrong: int
    error_cm: float
    error_deg: float


def true_poses(path: Path, store: KeyframeStore, *, of_laser: bool = True) -> FloatArray:
    """(n, 3) true poses of the base at all keyframes, NaN where none is given.

    A file of TUM poses is of the laser or of the base.
    """
    truth = read_tum(path)
    known, found = associate(truth.stamps_ns, np.array(store.stamps_ns), 5_000_000)
    poses = np.full((len(store), 3), np.nan)
    for keyframe, row in zip(known.tolist(), found.tolist(), strict=True):
        pose = Pose2(*truth.poses[row].tolist())
        poses[keyframe] = pose @ store.base_from_laser(keyframe).inverse() if of_laser else pose
    return poses


def judged(explored: Explored, store: KeyframeStore, poses: FloatArray) -> Judgement:
    """Hold the closures against true poses (n, 3) of all keyframes, NaN where not known."""
    known = np.isfinite(poses[:, 0])
    tracks = {
        region: poses[[k for k in keyframes if known[k]]]
        for region, keyframes in explored.regions.items()
        if known[list(keyframes)].any()
    }
    here = Pose2(0.0, 0.0, 0.0)
    overlap = {
        (a, b): tracks_overlap(tracks[a], tracks[b], here, 1.0)
        for a in tracks
        for b in tracks
        if a < b
    }
    merges = [c for c in explored.closures if c.merged]
    submap = submap_of_regions(explored.regions, [(c.old, c.new) for c in merges])
    back = [b for b in tracks if any(overlap[a, b] >= REVISIT for a in tracks if a < b)]
    errors = np.array(_constraint_errors(explored, store, poses)).reshape(-1, 2)
    median = np.median(errors, axis=0) if len(errors) else np.full(2, np.nan)
    return Judgement(
        regions=len(explored.regions),
        merges=len(merges),
        right=sum(_overlap(overlap, c.old, c.new) > 0.25 for c in merges),
        found=sum(
            any(submap[a] == submap[b] and overlap[a, b] >= REVISIT for a in tracks if a < b)
            for b in back
        ),
        revisits=len(back),
        constraints=len(errors),
        wrong=int(((errors[:, 0] > 0.6) | (errors[:, 1] > 7.0)).sum()),
        error_cm=100.0 * float(median[0]),
        error_deg=float(median[1]),
    )


def _overlap(overlap: dict[tuple[int, int], float], a: int, b: int) -> float:
    return overlap.get((min(a, b), max(a, b)), 0.0)


def _constraint_errors(
    explored: Explored, store: KeyframeStore, poses: FloatArray
) -> list[tuple[float, float]]:
    """Metres and degrees between each verified transform and the truth, at the keyframes joined."""
    errors = []
    settings = load_config().relaxation
    constraints = constraints_of(explored.closures, explored.regions, store, settings)
    for constraint in constraints.values():
        joined = poses[[constraint.source, constraint.target]]
        if not np.isfinite(joined).all():
            continue
        a, b = (Pose2(*pose) for pose in joined.tolist())
        off = (a.inverse() @ b).inverse() @ constraint.source_from_target
        errors.append((off.distance, abs(np.degrees(wrap_angle(off.theta)))))
    return errors


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


def tour_of(world: GridMap, view: float, seed: int, **more: Any) -> list[PosedScan]:
    """The scans of a tour at their true poses; a beam a degree if nothing else is said."""
    usual = {"field_of_view_deg": view, "beams": int(view), "rate_hz": 5.0, "seed": seed}
    options = SimulationOptions(**(usual | more))
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
    driven = pairwise(labels.tolist())
    adjacency = neighbours(submaps, [(a, b) for a, b in driven if a in submaps and b in submaps])
    return lambda: Localizer(trained, adjacency, grids, config.localization, frames)


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

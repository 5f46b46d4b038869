"""The sample log in cells of other sizes: revisits found, merges against the truth, self matching.

python -m benchmarks.resolutions [--cells 0.05 0.15 ...] [--set KEY=VALUE ...] [--merges]

A visit is a stay of the true path in a painted room; a revisit is one that is not the first. It is
found when the online submap of most of its keyframes is that of an earlier visit to the room. A
merge is right when both regions are in one room (a tenth of the keyframes of each, at least) and
its transform is within 0.6 m and 7 degrees of the truth. Then the submaps found in cells of 0.05 m
are drawn in cells from 0.02 to 0.25 m and matched: each with itself, and with itself drawn in
another frame. `--merges` lists the wrong merges.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.sample_tour import SAMPLE_LOG, SAMPLE_TRUTH, sample_rooms
from specmap_cli.cli.options import Settings
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle
from specmap_cli.core.labels import runs
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Closure, IntArray, PosedScan
from specmap_cli.core.settings import Config, GridConfig
from specmap_cli.evaluation.rooms import map_scores
from specmap_cli.evaluation.trajectories import associate, read_tum
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore, integrate_keyframes
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.build import explore
from specmap_cli.pipelines.exploration import Exploration, Explored, in_own_frame, online_labels
from specmap_cli.pipelines.finishing import finish
from specmap_cli.pipelines.learning import submaps_of
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.tracking import Tracking, track
from specmap_cli.pipelines.worker import ahead
from specmap_cli.recognition.closure.prepared import prepared
from specmap_cli.recognition.closure.verification import verify
from specmap_cli.topology.graph import settle_labels

USUAL_M = 0.05
CELLS_M = (0.05, 0.03, 0.06, 0.08, 0.12, 0.15, 0.25)
SELF_CELLS_M = (0.02, 0.03, 0.05, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2, 0.25)
WRONG_M, WRONG_RAD = 0.6, math.radians(7.0)  # of a transform, as in `benchmarks.recognition`
SELF_M, SELF_RAD = 0.1, 0.05  # of a submap matched with itself; a cell if that is more
LEAST_SHARE = 0.1  # of a region's keyframes: with fewer in a room it looks in through the door
OTHER_FRAME = Pose2(1.3, -0.7, 1.1)
BRIEF = ("recognition.rounds=5", "localization.augmentation=20")  # closures do not depend on these


@dataclass(frozen=True, slots=True, kw_only=True)
class Tour:
    """One build of the sample log, judged: `found` are the revisits that were recognised.

    Revisits are named by their first keyframes. `wrong` says of each merge that is wrong why.
    """

    regions: int
    submaps: int
    merges: int
    wrong: tuple[str, ...]
    revisits: frozenset[int]
    found: frozenset[int]
    purity: float


def registered(settings: list[str]) -> tuple[list[PosedScan], Tracking]:
    """The scans of the sample log as registered, which no cell size changes, and how it went."""
    config = config_of(USUAL_M, settings)
    with open_log(SAMPLE_LOG, config.log) as log:
        stream = SweepStream(log, config.log)
        with ahead(lambda: track(stream, config.registration)) as scans:
            posed = list(scans)
            return posed, scans.result


def config_of(cell_m: float, settings: list[str]) -> Config:
    """The settings of one build."""
    return Settings(assignments=[*BRIEF, f"grid.resolution_m={cell_m}", *settings]).load()


def build(
    scans: list[PosedScan], tracking: Tracking, config: Config, store: KeyframeStore
) -> tuple[Tour, IntArray]:
    """The map of registered scans, judged, and the final submap (n,) of each keyframe."""
    clock, accepts = Stopwatch(), KeyframeSelector(config.keyframes).accepts
    exploration = Exploration(config, store, clock, None)
    explored = explore(scans, exploration, accepts, Silent())
    done = finish(explored, tracking, config, store, Silent(), clock)
    merges = [closure for closure in done.topology.closures if closure.merged]
    return judged(explored, merges, store, len(done.topology.submaps)), done.labels.submaps


def judged(explored: Explored, merges: list[Closure], store: KeyframeStore, submaps: int) -> Tour:
    """What was explored, compared with the true poses and rooms."""
    truth = read_tum(SAMPLE_TRUTH)
    keyframes, rows = associate(truth.stamps_ns, np.array(store.stamps_ns, dtype=np.int64))
    poses = truth.poses[rows]
    assert len(keyframes) == len(store), "the sample has a true pose for every scan"
    labels = online_labels(explored.regions, merges, len(store))
    rooms = sample_rooms().at(poses).astype(np.int64)
    revisits, found = revisits_of(rooms, poses, labels)
    faults = [fault(merge, explored, rooms, poses) for merge in merges]
    return Tour(
        regions=len(explored.regions),
        submaps=submaps,
        merges=len(merges),
        wrong=tuple(why for why in faults if why),
        revisits=revisits,
        found=found,
        purity=map_scores(sample_rooms(), poses, labels).purity,
    )


def revisits_of(
    rooms: IntArray, poses: FloatArray, labels: IntArray
) -> tuple[frozenset[int], frozenset[int]]:
    """First keyframes of the revisits, and of those that are found.

    `rooms` (n,) true rooms of keyframes at true `poses` (n, 3), `labels` (n,) their submaps.
    """
    settled = settle_labels(rooms, poses, Config().segmentation.region_min_m)
    seen: dict[int, set[int]] = {}
    revisits: set[int] = set()
    found: set[int] = set()
    for start, end in runs(settled):
        room = int(settled[start])
        submap = int(np.bincount(labels[start:end]).argmax())
        if room and room in seen:
            revisits.add(start)
            found.update({start} if submap in seen[room] else ())
        seen.setdefault(room, set()).add(submap)
    return frozenset(revisits), frozenset(found)


def fault(merge: Closure, explored: Explored, rooms: IntArray, poses: FloatArray) -> str:
    """What is wrong with a merge; nothing when it is right."""
    old, new = (list(explored.regions[region]) for region in (merge.old, merge.new))
    there, here = rooms_in(rooms[old]), rooms_in(rooms[new])
    true = Pose2(*poses[old[0]].tolist()).inverse() @ Pose2(*poses[new[0]].tolist())
    assert merge.old_from_new is not None
    off = true.inverse() @ merge.old_from_new
    angle = abs(wrap_angle(off.theta))
    if there & here and off.distance <= WRONG_M and angle <= WRONG_RAD:
        return ""
    return (
        f"{merge.new} of rooms {sorted(here)} into {merge.old} of rooms {sorted(there)}, "
        f"{off.distance:.2f} m and {math.degrees(angle):.1f} degrees from the truth"
    )


def rooms_in(rooms: IntArray) -> set[int]:
    """The rooms that hold no small share of some keyframes, by their rooms (n,)."""
    counts = np.bincount(rooms)
    return set(np.flatnonzero(counts >= LEAST_SHARE * len(rooms)).tolist()) - {0}


def self_matches(store: KeyframeStore, submaps: Mapping[int, list[int]], cell_m: float) -> str:
    """How many submaps are matched with themselves rightly, as drawn and in another frame."""
    config = GridConfig(resolution_m=cell_m)
    right = [0, 0]
    for keyframes in submaps.values():
        track = in_own_frame(store, keyframes)
        turned = compose(invert(np.array(OTHER_FRAME)), track)
        old, other = (
            integrate_keyframes(store, keyframes, poses, config).snapshot()
            for poses in (track, turned)
        )
        right[0] += matches(old, old, Pose2(0.0, 0.0, 0.0))
        right[1] += matches(old, other, OTHER_FRAME)
    return f"{cell_m:6.2f} {right[0]:7}/{len(submaps)} {right[1]:7}/{len(submaps)}"


def matches(old: GridMap, new: GridMap, old_from_new: Pose2) -> bool:
    """Whether the match of two grids is the true `old_from_new`."""
    config = Config().recognition
    first, second = prepared(old, config), prepared(new, config)
    check = None if first is None or second is None else verify(first, second, config)
    if check is None:
        return False
    off = old_from_new.inverse() @ check.old_from_new
    return off.distance < max(SELF_M, old.resolution) and abs(off.theta) < SELF_RAD


def row(cell_m: float, tour: Tour, usual: Tour) -> str:
    """One line of the table."""
    again = len(tour.found & usual.found) / max(len(usual.found), 1)
    return (
        f"{cell_m:6.2f} {tour.regions:7} {tour.submaps:7} {tour.merges:6} "
        f"{tour.merges - len(tour.wrong):5} {len(tour.wrong):5} "
        f"{len(tour.found):5}/{len(tour.revisits):<3} {again:8.2f} {tour.purity:6.3f}"
    )


def table(cells_m: Iterable[float], settings: list[str], merges: bool) -> None:
    """Build in cells of the usual size first, then in the others, and print both tables."""
    print(
        f"{'cell m':>6} {'regions':>7} {'submaps':>7} {'merges':>6} {'right':>5} {'wrong':>5} "
        f"{'revisits':>9} {'of 0.05':>8} {'purity':>6}"
    )
    with KeyframeStore() as store:
        scans, tracking = registered(settings)
        usual, labels = build(scans, tracking, config_of(USUAL_M, settings), store)
        for cell_m in cells_m:
            config = config_of(cell_m, settings)
            with KeyframeStore() as other:
                same = cell_m == USUAL_M
                tour = usual if same else build(scans, tracking, config, other)[0]
            print(row(cell_m, tour, usual), flush=True)
            for line in tour.wrong if merges else ():
                print(f"       {line}")
        print(f"\n{'cell m':>6} {'itself':>10} {'turned':>10}")
        for cell_m in SELF_CELLS_M:
            print(self_matches(store, submaps_of(labels), cell_m), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", nargs="+", type=float, default=CELLS_M, metavar="METRES")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("--merges", action="store_true", help="list the wrong merges")
    arguments = parser.parse_args()
    table(arguments.cells, arguments.settings, arguments.merges)


if __name__ == "__main__":
    main()

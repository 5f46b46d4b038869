"""Trajectories on recorded logs, against ground truth and the published figures of other systems.

    python -m benchmarks.registration [--cuts] [--json FILE]

Every log of $SPECMAP_DATA/logs with a truth in $SPECMAP_DATA/truth, with and without odometry: the
front end alone, and after the layout (nearby passes only: no classifier takes part here). `--cuts`
adds the test of lost tracking: scans cut out at random places, odometry blind across the cut.
Speeds are scans per second of processor time of the front end alone; layouts are in seconds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.data import log_file, truth_file
from specmap_cli.core.geometry import Pose2, compose, invert
from specmap_cli.core.records import PosedScan, Sweep, Trajectory
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.evaluation.trajectories import (
    RelativeErrors,
    read_relations,
    read_tum,
    reference_errors,
    relation_errors,
)
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.layout.relaxation import Layout, corrected, relax
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.trajectory import TrajectoryRecorder
from specmap_cli.registration import FrontEnd

LOGS = ("fr079", "mit_csail", "fr079_3d")
CUT_LOGS = ("fr079", "mit_csail")
CUTS, CUT_SCANS, LEAD_IN, WATCHED = 15, 60, 200, 25

# mean translation error of all relations of fr079, metres, and mean rotation error, degrees
PUBLISHED = {
    "scan matching (Kuemmerle 2009)": "0.258",
    "graph mapping (Kuemmerle 2009)": "0.056",
    "Cartographer (Hess 2016)": "0.0452",
}


@dataclass(frozen=True, slots=True)
class Run:
    """What one log gave: trajectories of the base before and after the layout."""

    name: str
    odometry: bool
    tracked: Trajectory
    relaxed: Trajectory
    layout: Layout
    counts: dict[str, int]
    scans_per_s: float
    layout_s: float


@dataclass(frozen=True, slots=True)
class Row:
    log: str
    odometry: bool
    stage: str
    errors: str
    scans_per_s: int
    layout_s: float
    lost: int
    breaks: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cuts", action="store_true", help="also the test of lost tracking")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows = []
    for name in LOGS:
        for odometry in (True, False):
            run = register(name, odometry)
            rows += [row(run, "front end", run.tracked), row(run, "final", run.relaxed)]
    print(table(rows))
    print("\nPublished means on fr079, m: " + "; ".join(f"{k} {v}" for k, v in PUBLISHED.items()))
    cuts = [cut_test(name) for name in CUT_LOGS] if arguments.cuts else []
    for line in cuts:
        print(line)
    if arguments.json:
        text = json.dumps({"rows": [asdict(r) for r in rows], "cuts": cuts}, indent=1)
        arguments.json.write_text(text + "\n", encoding="utf-8")


def register(name: str, odometry: bool) -> Run:
    """Log -> front end -> keyframe store -> layout, as `build` does it."""
    config = Config(log=LogConfig(use_odometry=odometry))
    front_end, recorder = FrontEnd(config.registration), TrajectoryRecorder()
    selector, breaks, busy, scans = KeyframeSelector(config.keyframes), [], 0.0, 0

    def keep(scan: PosedScan) -> None:
        recorder.append(scan)
        if scan.restarted:
            breaks.append(len(store))
        if selector.accepts(scan):
            store.append(scan)

    with KeyframeStore() as store, open_log([log_file(name)]) as log:
        for sweep in SweepStream(log, config.log):
            start = time.process_time()
            settled = front_end.take(sweep)
            busy, scans = busy + time.process_time() - start, scans + 1
            for scan in settled:
                keep(scan)
        for scan in front_end.rest():
            keep(scan)
        tracked, start = recorder.trajectory(), time.process_time()
        layout = relax(store, [], breaks, config.relaxation)
        relaxed = corrected(tracked, store, layout)
        seconds = time.process_time() - start
    return Run(
        name, odometry, tracked, relaxed, layout, dict(front_end.counts), scans / busy, seconds
    )


def row(run: Run, stage: str, trajectory: Trajectory) -> Row:
    """The errors of one stage of a run as a line of the table."""
    return Row(
        run.name,
        run.odometry,
        stage,
        errors(run.name, trajectory),
        round(run.scans_per_s),
        round(run.layout_s, 2),
        run.counts["lost"],
        run.counts["breaks"],
    )


def errors(name: str, trajectory: Trajectory) -> str:
    """Relation errors where the log has relations, else errors against its reference poses."""
    relations = truth_file(f"{name}.relations")
    if relations.exists():
        found = relation_errors(trajectory, read_relations(relations))
        return f"{relative(found)}, {found.matched} of {found.total} relations"
    reference = read_tum(next(relations.parent.glob(f"{name}_*.tum")))
    score = reference_errors(trajectory, reference)
    parts = [
        f"RPE {length:g} m {value.translation_m.mean:.3f} m {value.rotation_deg.mean:.2f} deg"
        for length, value in score.relative.items()
    ]
    return f"{'; '.join(parts)}; ATE {score.ate_m:.3f}; end {score.end_m:.3f} m"


def relative(found: RelativeErrors) -> str:
    move, turn = found.translation_m, found.rotation_deg
    return (
        f"{move.mean:.4f} ± {move.std:.3f} m (median {move.median:.3f}, p95 {move.p95:.3f}), "
        f"{turn.mean:.2f} ± {turn.std:.2f} deg"
    )


def table(rows: Sequence[Row]) -> str:
    lines = [
        "| log | odometry | stage | errors | scans/s | layout s | lost | breaks |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        odometry = "yes" if r.odometry else "no"
        lines.append(
            f"| {r.log} | {odometry} | {r.stage} | {r.errors} | {r.scans_per_s} | {r.layout_s} "
            f"| {r.lost} | {r.breaks} |"
        )
    return "\n".join(lines)


def cut_test(name: str) -> str:
    """How many of the cuts through a log are noticed: a scan soon after is lost.

    Odometry stands still across the cut. A cut whose scans are placed rightly all the same (within
    0.5 m and 0.2 rad of the truth) needs no notice and is counted apart.
    """
    with open_log([log_file(name)]) as log:
        sweeps = list(SweepStream(log, LogConfig()))
    truth = read_tum(truth_file(f"{name}_corrected.tum"))
    rng = np.random.default_rng(0)
    places = np.arange(LEAD_IN + 50, len(sweeps) - CUT_SCANS - 90)
    noticed = right = 0
    for place in np.sort(rng.choice(places, CUTS, replace=False)).tolist():
        front_end = FrontEnd(Config().registration)
        before = [front_end.register(sweep) for sweep in sweeps[place - LEAD_IN : place]]
        resumed = place + CUT_SCANS
        blind = blinded(sweeps[resumed : resumed + WATCHED], sweeps[place - 1])
        after = [front_end.register(sweep) for sweep in blind]
        if any(scan.lost for scan in after):
            noticed += 1
        elif placed_rightly(before, after, truth):
            right += 1
    return f"{name}: {noticed} of {CUTS} cuts noticed, {right} more crossed at the right pose"


def blinded(sweeps: Iterable[Sweep], last: Sweep) -> list[Sweep]:
    """Sweeps whose odometry goes on from that of `last` as if nothing lay between."""
    moved, start = [], None
    for sweep in sweeps:
        assert sweep.odom_from_base is not None
        assert last.odom_from_base is not None
        start = start or sweep.odom_from_base.inverse()
        odometry = last.odom_from_base @ start @ sweep.odom_from_base
        moved.append(replace(sweep, odom_from_base=odometry))
    return moved


def placed_rightly(
    before: Sequence[PosedScan], after: Sequence[PosedScan], truth: Trajectory
) -> bool:
    """Whether the motion across a cut is that of the truth (poses of the laser)."""
    known = {int(stamp): pose for stamp, pose in zip(truth.stamps_ns, truth.poses, strict=True)}
    pairs = [
        [(known[s.stamp_ns // 1000 * 1000], s) for s in scans if s.stamp_ns // 1000 * 1000 in known]
        for scans in (before, after)
    ]
    if not pairs[0] or not pairs[1]:
        return False
    (true_start, start), (true_end, end) = pairs[0][-1], pairs[1][-1]
    true_motion = compose(invert(true_start), true_end)
    motion = start.map_from_laser.inverse() @ end.map_from_laser
    away = Pose2(*compose(invert(true_motion), np.array(motion)).tolist())
    return away.distance < 0.5 and abs(away.theta) < 0.2


if __name__ == "__main__":
    main()

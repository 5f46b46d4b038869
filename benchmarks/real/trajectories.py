"""Trajectories of finished maps of real recordings, against relations, poses, or themselves.

fr079 has true relations between poses (Kuemmerle et al. 2009): the mean error of all of them. Other
recordings have poses by others' SLAM: the absolute error (ATE) and the relative one (RPE, per metre
of path; Sturm et al. 2012). The odometry of fr101_sparse is right itself. `room_loop` and `ual` end
where they began: what was seen at the end is laid on what was seen at the start (laying.py), and
the distance is how far the walls lie apart. One drive is one draw: of `ual` it is the median of
five, the others with readings that err by 2 mm more, and of others the worst of five is told, too.
A depth camera in the place of a laser sees the 87 degrees ahead of it, and 6 m. Odometry that
hangs for five scans of fifty, as that of mit_csail does itself now and then, must be worth more
than none.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.data import recording, truth_file
from benchmarks.making import spoiling as s
from benchmarks.making.recordings import absolute, copied, own_odometry, recorded
from benchmarks.real.laying import Seen, passes
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation.trajectories import read_relations, reference_errors, relation_errors
from specmap_cli.maps.store import read_map
from specmap_cli.maps.text_files import read_tum

WITHOUT = "--no-odometry"
_OTHERS = "Cartographer .0452 (Hess 2016), graph mapping .056, scan matching .258 (Kuemmerle 2009)"
_NOISE_M, _SEEDS = 0.002, range(10, 14)  # of copies: others than was developed on
_DEPTH_CAMERA = s.narrowed(87.0, 6.0)
_LEAST_GAIN = 0.1  # of a view, by which it fits better elsewhere

ROWS = (
    Row("fr079", "fr079, relations", 0.031, 0.029, "less", ".4f", "m", _OTHERS),
    Row("fr079_worst", "fr079, the worst of five draws", None, None, "less", ".4f", "m"),
    Row("fr079_without", "fr079 without odometry, relations", 0.032, 0.030, "less", ".4f", "m"),
    Row("fr079_half", "fr079, a scan each 0.5 m, relations", 0.06, 0.035, "less", ".3f", "m"),
    Row("fr079_one", "fr079, a scan each metre, relations", 0.08, 0.04, "less", ".3f", "m"),
    Row("fr079_depth", "fr079 as by a depth camera, relations", None, None, "less", ".3f", "m"),
    Row("csail", "mit_csail, ATE", 0.075, 0.065, "less", ".3f", "m"),
    Row("csail_worst", "mit_csail, the worst of five draws", None, None, "less", ".3f", "m"),
    Row("csail_without", "mit_csail without odometry, ATE", 0.11, 0.09, "less", ".3f", "m"),
    Row("csail_depth", "mit_csail as by a depth camera, ATE", None, None, "less", ".3f", "m"),
    Row("csail_hung", "mit_csail, odometry hangs, ATE", 0.11, 0.075, "less", ".3f", "m"),
    Row("csail_rpe", "mit_csail, RPE of one metre", better="less", unit="m"),
    Row("fr079_3d", "fr079_3d, ATE", better="less", unit="m"),
    Row("fr079_3d_without", "fr079_3d without odometry, ATE", better="less", unit="m"),
    Row("fr101", "fr101_sparse, against its own odometry", 0.06, None, "less", unit="m"),
    Row("livox", "hall_livox, ATE", 0.5, None, "less", unit="m"),
    Row("room_loop", "room_loop, its end against its start", 0.05, 0.03, "less", ".2f", "m"),
    Row("ual", "ual (530 m outdoors), end on start, median of 5", 0.3, 0.1, "less", ".2f", "m"),
    Row("ual_worst", "ual, the worst of these", 0.3, 0.1, "less", ".2f", "m"),
    Row("lost", "scans lost in all of these", better="less", form=".0f"),
)


def measure(bench: Bench) -> Figures:
    """Hold the trajectory of each map against what is known of it."""
    relations = partial(_relations, truth_file("fr079.relations"))
    csail = partial(_poses, truth_file("mit_csail_corrected.tum"))
    in_space = partial(_poses, truth_file("fr079_3d_truth.tum"))
    maps: dict[str, tuple[Path, Callable[[Trajectory], float]]] = {
        "fr079": (bench.recorded("fr079"), relations),
        "fr079_without": (bench.recorded("fr079", WITHOUT), relations),
        "fr079_half": (thinned(bench, 0.5), relations),
        "fr079_one": (thinned(bench, 1.0), relations),
        "fr079_depth": (spoiled(bench, "fr079", "depth", _DEPTH_CAMERA), relations),
        "csail": (bench.recorded("mit_csail"), csail),
        "csail_without": (bench.recorded("mit_csail", WITHOUT), csail),
        "csail_depth": (spoiled(bench, "mit_csail", "depth", _DEPTH_CAMERA), csail),
        "csail_hung": (spoiled(bench, "mit_csail", "hung", s.hung_odometry(50, 5)), csail),
        "csail_rpe": (bench.recorded("mit_csail"), partial(csail, per_metre=True)),
        "fr079_3d": (bench.recorded("fr079_3d"), in_space),
        "fr079_3d_without": (bench.recorded("fr079_3d", WITHOUT), in_space),
        "fr101": (bench.recorded("fr101_sparse"), own_odometry(recording("fr101_sparse")).score),
        "livox": (
            bench.recorded("hall_livox"),
            absolute(read_tum(truth_file("hall_livox_truth.tum"))),
        ),
    }
    figures = {}
    for name, (map_, error) in maps.items():
        figures[name] = error(read_tum(map_ / "trajectory.tum"))
        print(f"{name:18} {figures[name]:.4f} m", flush=True)
    for name, recorded_, error in (("fr079", "fr079", relations), ("csail", "mit_csail", csail)):
        copies = (noisier(bench, recorded_, seed) for seed in _SEEDS)
        draws = [figures[name], *(error(read_tum(map_ / "trajectory.tum")) for map_ in copies)]
        figures[f"{name}_worst"] = max(draws)
        print(f"{name}, five draws: " + " ".join(f"{draw:.4f}" for draw in draws), flush=True)
    room_loop, ual = bench.recorded("room_loop"), bench.recorded("ual")
    lost = {map_: lost_in(map_) for map_ in (*(map_ for map_, _ in maps.values()), room_loop, ual)}
    off_m = [end_on_start(map_) for map_ in (ual, *(noisier(bench, "ual", k) for k in _SEEDS))]
    return {
        **figures,
        "room_loop": end_on_start(room_loop),
        "ual": float(np.median(off_m)),
        "ual_worst": max(off_m),
        "lost": sum(lost.values()),
    }


def thinned(bench: Bench, every_m: float) -> Path:
    """The map of fr079 with a scan each so many metres."""
    return spoiled(bench, "fr079", f"every-{every_m:g}-m", s.every_metres(every_m))


def spoiled(bench: Bench, name: str, how: str, spoil: s.Spoiling) -> Path:
    """The map of a real recording as it is spoiled."""
    return bench.simulated(f"{name}-{how}", partial(recorded, name, spoil))


def noisier(bench: Bench, name: str, seed: int) -> Path:
    """The map of a real recording with readings that err more."""
    make = partial(copied, name, s.noisy_ranges(_NOISE_M, seed))
    return bench.simulated(f"{name}-noisier-{seed}", make)


def _relations(path: Path, found: Trajectory) -> float:
    return relation_errors(found, read_relations(path)).translation_m.mean


def _poses(path: Path, found: Trajectory, *, per_metre: bool = False) -> float:
    errors = reference_errors(found, read_tum(path))
    return errors.relative[1.0].translation_m.mean if per_metre else errors.ate_m


def end_on_start(map_: Path) -> float:
    """Metres between the walls seen at the end and those seen at the start: the worst view."""
    seen = Seen(read_map(map_))
    off = [one.off_m if one.gain >= _LEAST_GAIN else 0.0 for one in passes(seen)]
    print(f"{map_.name:18} {len(off)} views twice, off by " + " ".join(f"{o:.2f}" for o in off))
    return float(np.max(off)) if off else float("nan")


def lost_in(map_: Path) -> int:
    """How many scans could not be registered."""
    run = json.loads((map_ / "run.json").read_text(encoding="utf-8"))
    return int(run["counts"]["lost"])

"""Evaluations from file names to figures: what `specmap evaluate` runs."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from specmap_cli.core.errors import LogError
from specmap_cli.core.geometry import Pose2, nearest_motion
from specmap_cli.core.progress import Progress
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.classification import score_lines
from specmap_cli.evaluation.protocols import (
    STAMP_REACH_NS,
    HoldOutResult,
    RevisitResult,
    revisit,
)
from specmap_cli.evaluation.semantic import HALLWAY, ROOM, SemanticResult
from specmap_cli.evaluation.trajectories import (
    ReferenceErrors,
    RelativeErrors,
    Spread,
    associate,
    read_tum,
)
from specmap_cli.maps.filenames import TOPOLOGY
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.localize import localize_log

# Mean distance between the true poses and those of the map from which they hardly belong together;
# a tenth of it is usual.
_FITTING_M = 0.5


def revisit_logs(
    first: str | Path,
    second: str | Path,
    references: tuple[str | Path, str | Path],
    config: Config,
    progress: Progress,
) -> RevisitResult:
    """Localise a second log in the map of a first and score it by given poses (Figure 6).

    `first` is a log, of which a map is built for the purpose, or a map directory. `references` are
    TUM files of both logs in one frame. Raises what `build_map` and `localize_log` raise.
    """
    first, second = Path(first), Path(second)
    if (first / TOPOLOGY).is_file():
        return _revisit_map(read_map(first, config.limits), second, references, config, progress)
    with tempfile.TemporaryDirectory(prefix="specmap-") as folder:
        build_map([first], Path(folder) / "map", config, progress=progress)
        stored = read_map(Path(folder) / "map")
        return _revisit_map(stored, second, references, config, progress)


def _revisit_map(
    stored: StoredMap,
    second: Path,
    references: tuple[str | Path, str | Path],
    config: Config,
    progress: Progress,
) -> RevisitResult:
    map_from_reference = _alignment(stored, references[0], progress)
    reference = read_tum(references[1])
    report = localize_log([second], stored, config, progress=progress)
    return revisit(
        [scan.label for scan in report.scans],
        reference,
        (stored.labels.poses, stored.labels.submaps),
        map_from_reference,
    )


def _alignment(stored: StoredMap, reference: str | Path, progress: Progress) -> Pose2:
    """The motion that takes the reference poses of the map's own log to the map."""
    given = read_tum(reference)
    joined, rows = associate(given.stamps_ns, stored.labels.stamps_ns, STAMP_REACH_NS)
    if len(joined) < 2:
        raise LogError(f"{reference}: no pose at the stamps of the map's keyframes: another log?")
    places, known = given.poses[rows, :2], stored.labels.poses[joined, :2]
    map_from_reference = nearest_motion(places, known)
    away = np.hypot(*(map_from_reference.apply(places) - known).T).mean()
    if away > _FITTING_M:
        progress.warn(
            f"{reference}: its poses are {away:.1f} m off the map on average: of another log, or "
            "is the map bent? the scores mean little"
        )
    return map_from_reference


def hold_out_lines(result: HoldOutResult) -> list[str]:
    """Table II: macro averages, the filtered labels beside them, and every submap."""
    lines = [f"{'':22} {'scans':>7} {'recall':>7} {'precision':>10}"]
    for name, scores in (
        ("training scans", result.train),
        ("held-out scans", result.test),
        ("held-out, filtered", result.filtered),
    ):
        lines.append(f"{name:22} {scores.scans:7,} {scores.recall:7.4f} {scores.precision:10.4f}")
    return [*lines, "", "held-out scans by submap", *score_lines(result.test)]


def revisit_lines(result: RevisitResult) -> list[str]:
    """Recall, precision and accuracy of raw and filtered labels."""
    lines = [f"{'':22} {'scans':>7} {'recall':>7} {'precision':>10} {'accuracy':>9}"]
    for name, scores in (("raw, single scans", result.raw), ("filtered", result.filtered)):
        lines.append(
            f"{name:22} {scores.scans:7,} {scores.recall:7.4f} {scores.precision:10.4f} "
            f"{scores.accuracy:9.4f}"
        )
    return lines


def semantic_lines(result: SemanticResult) -> list[str]:
    """Rooms and hallways by the baseline, and which borders of the map it can see."""
    recall = result.scores.recall_of
    return [
        f"{result.scores.scans:,} scans: rooms recognised {recall.get(ROOM, 0.0):.3f}, "
        f"hallways {recall.get(HALLWAY, 0.0):.3f}, all {result.scores.accuracy:.3f}",
        f"{result.borders} borders between submaps, {100 * result.borders_seen:.0f} % between "
        "a room and a hallway: no other can be seen",
    ]


def relation_lines(errors: RelativeErrors) -> list[str]:
    """Errors over all relations."""
    return [
        f"{errors.matched:,} of {errors.total:,} relations matched",
        *_spread_lines(errors.translation_m, errors.rotation_deg),
    ]


def reference_lines(errors: ReferenceErrors) -> list[str]:
    """Relative errors at each length of path, the absolute error, the error from end to end."""
    lines = [f"{errors.matched:,} of {errors.total:,} poses matched"]
    for length, relative in errors.relative.items():
        lines.append(f"relative errors over {length:g} m of path")
        lines += _spread_lines(relative.translation_m, relative.rotation_deg)
    lines.append(f"absolute error (rmse, aligned)  {errors.ate_m:.4f} m")
    lines.append(f"from first to last pose         {errors.end_m:.4f} m, {errors.end_deg:.3f} deg")
    return lines


def _spread_lines(translation: Spread, rotation: Spread) -> list[str]:
    return [
        f"  {name:14} mean {spread.mean:.4f}  std {spread.std:.4f}  median {spread.median:.4f}  "
        f"p95 {spread.p95:.4f}  max {spread.max:.4f}"
        for name, spread in (("translation m", translation), ("rotation deg", rotation))
    ]

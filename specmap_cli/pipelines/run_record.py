"""What a build tells about itself: `run.json`, and the summary that the command prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from specmap_cli.core.findings import Quality, summary
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.process import peak_memory_mb, versions
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.logs.selection import Selection
from specmap_cli.pipelines.finished_map import FinishedMap

SCHEMA_VERSION = 1  # of run.json: schemas/run.schema.json

# The counts that say what the map is; the others say what was read for it.
OF_THE_MAP = frozenset({"scans", "keyframes", "submaps", "edges", "merges", "path_m"})


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildReport:
    """What `build` did, for a person and for a machine: the map directory and its run.json.

    With `--like` a map `unapplied` tells which of a person's edits of it do not apply.
    """

    out: Path
    run: Mapping[str, Any]
    quality: Quality
    unapplied: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The counts, what is thought of the map, and the directory."""
        return {
            "out": str(self.out),
            **self.run["counts"],
            "unapplied": list(self.unapplied),
            "quality": self.run["quality"],
            "warnings": self.run["warnings"],
        }

    def lines(self) -> list[str]:
        """A summary: what makes the map doubtful or poor comes first."""
        counts = self.run["counts"]
        made = (
            f"{self.out}: {counted(counts['submaps'], 'submap')}, "
            f"{counted(counts['edges'], 'edge')}, "
            f"{counted(counts['merges'], 'revisit')} recognised; "
            f"{counted(counts['scans'], 'scan')} over "
            f"{counts['path_m']:.0f} m, {counts['lost']} lost"
        )
        return told(self.out, self.quality, made)


def told(out: Path, quality: Quality, *made: str) -> list[str]:
    """What a command that made a map says of it, `made` being its own lines.

    What makes the map doubtful or poor comes first.
    """
    verdict = quality.verdict
    trust = "" if verdict == "good" else f"{out}: this map is {verdict}: "
    return [
        *(trust + line for line in summary(quality.worst)),
        *made,
        *(["quality: good"] if verdict == "good" else []),
        f"look at {out / 'overview.png'}",
    ]


def run_record(
    inputs: Sequence[Path], selection: Selection | None, config: Config, finished: FinishedMap
) -> dict[str, Any]:
    """The contents of run.json; `selection` is of the log that was read, None where none was."""
    topology = finished.topology
    counts = {
        "scans": len(finished.trajectory.stamps_ns),
        "keyframes": len(finished.labels.stamps_ns),
        "submaps": len(topology.submaps),
        "edges": len(topology.edges),
        "doors": len(topology.doors),
        "merges": sum(closure.merged for closure in topology.closures),
        "path_m": round(finished.path_m, 3),
        **finished.counts,
    }
    return {
        "schema_version": SCHEMA_VERSION,
        "inputs": [path.name for path in inputs],
        "selection": None if selection is None else _selected(selection),
        "config": config.model_dump(),
        "versions": versions(),
        "counts": counts,
        "limits": {name: count for name, count in finished.limits.items() if count},
        "seconds": {name: round(value, 3) for name, value in finished.seconds.items()},
        "wall_s": round(finished.wall_s, 3),
        "memory_mb": peak_memory_mb(),
        "quality": finished.quality.as_dict(),
        "warnings": summary(finished.quality.warnings),
    }


def _selected(selection: Selection) -> dict[str, Any]:
    """Which topics and frames were read."""
    mounting = Pose2.from_matrix(selection.base_from_laser)
    return {
        "scan_topic": selection.scan_topic,
        "scan_type": selection.scan_type,
        "odometry": selection.odometry,
        "odom_topics": list(selection.odom_topics),
        "base_frame": selection.base_frame,
        "laser_frame": selection.laser_frame,
        "base_from_laser": [round(value, 6) for value in mounting],
        "height_band_m": selection.band_m,
    }

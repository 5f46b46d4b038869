"""What localisation found: a label a scan, as a summary, as CSV and as a picture."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.files import write_together
from specmap_cli.core.geometry import FloatArray, Pose2, step_lengths
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import counted, legible, stamp_text
from specmap_cli.grids.map_server import png_bytes
from specmap_cli.maps.store import StoredMap
from specmap_cli.recognition.localization.localizer import Label
from specmap_cli.recognition.localization.metric import Fix
from specmap_cli.topology.topological_map import default_name

HEADER = "stamp,submap,margin,runner_up,filtered_submap,name,filtered_probability,probability"
METRIC_HEADER = ",x,y,theta,score,var_x,cov_xy,cov_xtheta,var_y,cov_ytheta,var_theta"
_LEAP_M, _STEADY_SCANS = 0.5, 10  # a place that leaps and leaves within so many scans is wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizedScan:
    """The label of one scan, its place as registered, and within the map where it was matched."""

    label: Label
    track_from_base: Pose2
    fix: Fix | None = None

    @property
    def submap_from_base(self) -> Pose2 | None:
        """The pose in the submap of the filtered label, None where it is not known."""
        return None if self.fix is None else self.fix.pose

    @property
    def covariance(self) -> FloatArray | None:
        """(3, 3) of x, y and angle of that pose: square metres and radians."""
        return None if self.fix is None else self.fix.covariance

    @property
    def score(self) -> float:
        """How well the scan lies on walls there, in [0, 1]; NaN without a pose."""
        return math.nan if self.fix is None else self.fix.score


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationReport:
    """What `localize` found; `names` are those that a person gave to submaps of the map."""

    log: str
    scans: tuple[LocalizedScan, ...]
    warnings: tuple[str, ...]
    names: Mapping[int, str] = field(default_factory=dict)

    def name_of(self, submap: int | None) -> str:
        """What a submap is called; nothing for unknown."""
        return "" if submap is None else legible(self.names.get(submap, default_name(submap)))

    def as_dict(self) -> dict[str, Any]:
        """Counts of scans by label, raw and filtered; null is unknown."""
        raw, filtered = self._counts()
        return {
            "log": self.log,
            "scans": len(self.scans),
            "raw": {_name(key): raw[key] for key in sorted(raw, key=_order)},
            "filtered": {_name(key): filtered[key] for key in sorted(filtered, key=_order)},
            "agreement": self._agreement(),
            "names": {str(id_): name for id_, name in sorted(self.names.items())},
            "warnings": list(self.warnings),
        }

    def lines(self) -> list[str]:
        """A table of the submaps that were seen."""
        raw, filtered = self._counts()
        agreement = self._agreement()
        lines = [
            f"{self.log}: {counted(len(self.scans), 'scan')}, raw and filtered label agree on "
            f"{agreement:.1%}",
            f"{'submap':>8} {'raw':>8} {'filtered':>9}",
        ]
        for key in sorted({*raw, *filtered}, key=_order):
            name = f"  {self.name_of(key)}" if key in self.names else ""
            lines.append(f"{_name(key):>8} {raw[key]:8,} {filtered[key]:9,}{name}")
        return lines

    def _counts(self) -> tuple[Counter[int | None], Counter[int | None]]:
        raw = Counter(scan.label.submap for scan in self.scans)
        return raw, Counter(scan.label.filtered_submap for scan in self.scans)

    def _agreement(self) -> float:
        same = sum(scan.label.submap == scan.label.filtered_submap for scan in self.scans)
        return round(same / len(self.scans), 6)


def write_report(
    report: LocalizationReport,
    stored: StoredMap,
    *,
    metric: bool,
    csv: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Write the table and the picture that are asked for: both of them, or none.

    Raises UsageError when one cannot be written, MapError when the map is too damaged to be drawn.
    """
    contents: dict[Path, bytes] = {}
    if csv is not None:
        contents[csv] = table_of(report, metric).encode("utf-8")
    if plot is not None:
        contents[plot] = png_bytes(picture_of(report, stored, metric))
    write_together(contents)


def table_of(report: LocalizationReport, metric: bool) -> str:
    """CSV: one line a scan; an empty submap is unknown."""
    head = HEADER + METRIC_HEADER if metric else HEADER
    return csv_text(head.split(","), (_cells(report, scan, metric) for scan in report.scans))


def _cells(report: LocalizationReport, scan: LocalizedScan, metric: bool) -> list[Any]:
    """The cells of one scan; None where nothing is known."""
    label = scan.label
    return [
        stamp_text(label.stamp_ns),
        label.submap,
        f"{label.margin:.6f}",
        label.runner_up,
        label.filtered_submap,
        report.name_of(label.filtered_submap),
        f"{label.filtered_probability:.6f}",
        f"{label.probability:.6f}",
        *(_metric_cells(scan.fix) if metric else ()),
    ]


def _metric_cells(fix: Fix | None) -> list[str]:
    """The pose, its score and the upper triangle of its covariance; empty cells for none."""
    if fix is None:
        return [""] * METRIC_HEADER.count(",")
    pose = [f"{value:.6f}" for value in (*fix.pose, fix.score)]
    return pose + [f"{value:.4e}" for value in fix.covariance[np.triu_indices(3)].tolist()]


def picture_of(report: LocalizationReport, stored: StoredMap, metric: bool) -> NDArray[np.uint8]:
    """The predicted submap along the trajectory, over the map where scans were matched in it.

    The colours are those of the map's overview.
    """
    from specmap_cli.drawing.palette import colours_of  # slow to load, and seldom wanted
    from specmap_cli.drawing.predictions import render_labels

    submaps = np.array(
        [
            NO_SUBMAP if scan.label.filtered_submap is None else scan.label.filtered_submap
            for scan in report.scans
        ]
    )
    title = f"{report.log}: predicted submaps"
    if not metric:
        track = np.array([scan.track_from_base[:2] for scan in report.scans])
        fills = colours_of(stored.topology, stored.regions)
        return render_labels(track, submaps, title, fills=fills)
    places = _steady(np.array([_place(scan, stored) for scan in report.scans]), report.scans)
    ground = (stored.topology, stored.regions)
    return render_labels(places, submaps, title, map_with_regions=ground)


def _steady(places: FloatArray, scans: Sequence[LocalizedScan]) -> FloatArray:
    """Places (n, 2) without those that leap farther than the robot drove, both there and away.

    The first scan of a submap may match the wrong end of it; NaN marks what is left out.
    """
    track = np.array([scan.track_from_base[:2] for scan in scans])
    kept = np.flatnonzero(np.isfinite(places).all(axis=1))
    leaps = step_lengths(places[kept]) > step_lengths(track[kept]) + _LEAP_M
    runs = np.split(kept, np.flatnonzero(leaps) + 1)
    steady = places.copy()
    for run in runs:
        if len(run) < _STEADY_SCANS:
            steady[run] = math.nan
    return steady


def _place(scan: LocalizedScan, stored: StoredMap) -> FloatArray:
    """(2,) place of a matched scan in the map, NaN when it is not known."""
    if scan.fix is None:
        return np.array([math.nan, math.nan])
    pose = stored.topology.submaps[scan.fix.submap].map_from_submap @ scan.fix.pose
    return np.array([pose.x, pose.y])


def _name(submap: int | None) -> str:
    return "unknown" if submap is None else str(submap)


def _order(submap: int | None) -> tuple[bool, int]:
    return submap is None, -1 if submap is None else submap

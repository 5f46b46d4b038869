"""Another log against a finished map: in which submap was each scan taken? (Section IV-B)"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import InputError, LogError, Paths, paths_of
from specmap_cli.core.files import write_together
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted, csv_text, legible, stamp_text
from specmap_cli.grids.map_server import png_bytes
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.localizer import LocalizedScan, Localizer
from specmap_cli.recognition.localization.localizer import Where
from specmap_cli.topology.topological_map import default_name

_TELL_S = 10.0  # between lines while the place is not known: the whole map is searched then
_NO_MISFIT = (
    "an older map, which does not say how well its own scans fit its walls; known places are told "
    "from unknown by what is usual elsewhere: build it again"
)


@one_blas_thread()
def localize_log(
    logs: Paths,
    map_: Map | Path | str,
    config: Config | None = None,
    *,
    offline: bool = False,
    metric: bool = False,
    progress: Progress | None = None,
) -> LocalizationReport:
    """Label every scan of a recording with a submap of a stored map.

    `map_` is a map directory, or one that was read. Without `config` the settings are those the map
    was built with. `offline` smooths over the whole log instead of filtering; `metric` gives poses
    in the filtered submaps, of scans whose place is clear. Raises LogError for a recording without
    a usable scan, InputError when its laser cannot stand in for the map's, MapError for a damaged
    map.
    """
    progress = progress or Silent()
    given = paths_of(logs, "logs")
    stored = opened_map(map_, "map_", config)
    if stored.note:
        progress.note(stored.note)
    if stored.foreign_settings:
        foreign = ", ".join(stored.foreign_settings)
        progress.note(f"{stored.path}: built by another version; its settings left out: {foreign}")
    localizer = Localizer(stored, config, metric=metric)
    if localizer.config.localization.unknown and not localizer.knows_its_walls:
        progress.note(f"{stored.path}: {_NO_MISFIT}")
    with open_log(given, localizer.config.log) as log:
        stream = SweepStream(log, localizer.config.log)
        progress.note(stream.selection.note)
        progress.start("localising", stream.selection.topic.count)
        found, told = list[Where](), monotonic()
        try:
            for where in localizer.located(stream):
                found.append(where)
                progress.advance()
                if where.label.filtered_submap is None and monotonic() - told > _TELL_S:
                    progress.note(
                        f"{counted(len(found), 'scan')} so far, the place is not known now"
                    )
                    told = monotonic()
        except InputError as error:  # of a laser, which does not know whose it is
            raise error if error.where else error.within(log.name) from None
        if not found:
            raise LogError("no usable scan in it", "see `specmap info`", mark=";", where=log.name)
        warnings = (*stream.warnings, *localizer.warnings)
        for warning in warnings:
            progress.warn(warning)
        scans = localizer.told(found, offline=offline)
        name = legible(Path(log.name).name)
        return LocalizationReport(log=name, scans=scans, warnings=warnings, names=stored.names)


HEADER = "stamp,submap,margin,runner_up,filtered_submap,name,filtered_probability,probability"
METRIC_HEADER = (
    ",x,y,theta,score,var_x,cov_xy,cov_xtheta,var_y,cov_ytheta,var_theta,map_x,map_y,map_theta"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationReport:
    """What `localize` found; `names` are those that a person gave to submaps of the map."""

    log: str
    scans: tuple[LocalizedScan, ...]
    warnings: tuple[str, ...]
    names: Mapping[int, str] = field(default_factory=dict)

    @property
    def known(self) -> float:
        """Share of the scans that are from the map, by the filter."""
        return 1.0 - self._counts()[1][None] / len(self.scans)

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
            "known": round(self.known, 6),
            "names": {str(id_): name for id_, name in sorted(self.names.items())},
            "warnings": list(self.warnings),
        }

    def lines(self) -> list[str]:
        """A table of the submaps that were seen."""
        raw, filtered = self._counts()
        told = f"raw and filtered label agree on {self._agreement():.1%}"
        if not self.known:
            told = "none of them known: the map does not show this place"
        lines = [
            f"{self.log}: {counted(len(self.scans), 'scan')}, {told}",
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
    stored: Map,
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
    """The cells of one scan, None where nothing is known; those of its pose last if `metric`."""
    label, fix = scan.label, scan.fix
    pose, covariance = scan.submap_from_base, scan.covariance
    where = [""] * METRIC_HEADER.count(",") if metric else []
    if metric and fix is not None and pose is not None and covariance is not None:
        where = [f"{value:.6f}" for value in (*pose, fix.score)]
        where += [f"{value:.4e}" for value in covariance[np.triu_indices(3)].tolist()]
        where += [f"{value:.6f}" for value in fix.pose]
    return [
        stamp_text(label.stamp_ns),
        label.submap,
        f"{label.margin:.6f}",
        label.runner_up,
        label.filtered_submap,
        report.name_of(label.filtered_submap),
        f"{label.filtered_probability:.6f}",
        f"{label.probability:.6f}",
        *where,
    ]


def picture_of(report: LocalizationReport, stored: Map, metric: bool) -> NDArray[np.uint8]:
    """The predicted submap along the trajectory, over the map where scans were matched in it.

    The colours are those of the map's overview. Without a pose the way is as it was tracked.
    """
    from specmap_cli.drawing.overview import render_labels
    from specmap_cli.drawing.palette import colours_of  # slow to load, and seldom wanted

    metric = metric and any(scan.fix is not None for scan in report.scans)
    rooms = [scan.room for scan in report.scans]
    submaps = np.array([NO_SUBMAP if room is None else room for room in rooms])
    title = f"{report.log}: predicted submaps"
    if not metric:
        track = np.array([scan.track_from_base[:2] for scan in report.scans])
        fills = colours_of(stored.topology, stored.regions)
        return render_labels(track, submaps, title, fills=fills)
    ground = (stored.topology, stored.regions)
    return render_labels(_tracked(report.scans), submaps, title, map_with_regions=ground)


def _tracked(scans: Sequence[LocalizedScan]) -> FloatArray:
    """(n, 2) places in the map, led on from the last known pose or back from the first; or NaN."""
    places = np.full((len(scans), 2), math.nan)
    known = [k for k, scan in enumerate(scans) if scan.fix is not None]
    for k, scan in enumerate(scans):
        if known:
            last = scans[known[max(0, bisect_right(known, k) - 1)]]
            assert last.fix is not None
            motion = last.track_from_base.inverse() @ scan.track_from_base
            places[k] = (last.fix.pose @ motion)[:2]
    return places


def _name(submap: int | None) -> str:
    return "unknown" if submap is None else str(submap)


def _order(submap: int | None) -> tuple[bool, int]:
    return submap is None, -1 if submap is None else submap

"""Two maps of one building against each other: aligned by recognition, then what differs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.arguments import instance_of, path_of
from specmap_cli.core.errors import NOT_ALIGNED, NoResultError
from specmap_cli.core.geometry import IDENTITY
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import Config
from specmap_cli.core.text import to_json
from specmap_cli.drawing.comparison import render_comparison
from specmap_cli.grids.bent import Anchor, BentMotion
from specmap_cli.grids.map_server import write_png
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.pipelines.comparison_report import lines_of, record_of
from specmap_cli.pipelines.known_maps import align_maps
from specmap_cli.pipelines.localize import settings_for
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.topology.differences import Differences, differences

COMPARISON, SUMMARY, PICTURE = "compare.json", "summary.txt", "compare.png"
# Of a submap whose own place in the other map is believed: how well it fits, metres of wall, and
# their share; a room of which the other map saw but a wall slides along it.
_LEAST_FIT, _LEAST_WALLS_M, _LEAST_SHARE = 0.7, 5.0, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two stored maps, where the new one lies in the old one, and what differs."""

    old: StoredMap
    new: StoredMap
    alignment: Alignment
    old_from_new: BentMotion
    differences: Differences
    identical: bool

    @property
    def record(self) -> ComparisonRecord:
        """The same as it is written to compare.json."""
        maps = self.old, self.new
        return record_of(maps, self.alignment, self.differences, self.identical)

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        return self.record.model_dump()

    def lines(self) -> list[str]:
        """The same for a person."""
        return lines_of(self.record)


@one_blas_thread()
def compare_maps(
    old: StoredMap | Path | str,
    new: StoredMap | Path | str,
    config: Config | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """What differs between two maps, directories or read ones.

    Without `config` the settings are those that the old map was built with. Raises NoResultError
    when the maps cannot be aligned, MapError for a directory that is no map or damaged.
    """
    progress = progress or Silent()
    limits = None if config is None else config.limits
    one, other = opened_map(old, "old", limits), opened_map(new, "new", limits)
    if config is not None:
        instance_of(config, Config, "config")
    config = settings_for(one, {}) if config is None else config
    identical = _are_identical(one, other)
    progress.start("comparing", None)
    alignment = _found(one, other, identical, config)
    motion = _motion(alignment)
    tracks = one.labels.poses, other.labels.poses
    found = differences(one.regions, other.regions, tracks, motion)
    return Comparison(
        old=one,
        new=other,
        alignment=alignment,
        old_from_new=motion,
        differences=found,
        identical=identical,
    )


def write_comparison(
    comparison: Comparison,
    out: Path | str,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write summary, compare.json and the picture into a directory, complete or not at all.

    Raises UsageError for an output in the way.
    """
    picture = render_comparison(
        comparison.old.regions,
        comparison.new.regions,
        comparison.old_from_new,
        comparison.differences,
        (comparison.old.path.resolve().name, comparison.new.path.resolve().name),
    )
    with OutputDirectory(path_of(out, "out"), overwrite, progress, COMPARISON) as partial:
        summary = "\n".join(comparison.lines()) + "\n"
        (partial / SUMMARY).write_text(summary, encoding="utf-8")
        (partial / COMPARISON).write_text(to_json(comparison.as_dict()), encoding="utf-8")
        write_png(partial / PICTURE, picture)


def _are_identical(old: StoredMap, new: StoredMap) -> bool:
    """Whether two maps hold the same submaps and the same grid."""
    one, other = old.map_grid, new.map_grid
    return (
        old.record.text() == new.record.text()
        and one.origin == other.origin
        and one.resolution == other.resolution
        and np.array_equal(one.cells, other.cells)
    )


def _found(old: StoredMap, new: StoredMap, identical: bool, config: Config) -> Alignment:
    """Where the new map lies in the old one. Raises NoResultError when that is not sure."""
    alignment = align_maps(old, new, config)
    if alignment.old_from_new is None and not identical:
        raise NoResultError(
            f"{new.path}: not aligned with {old.path}: {alignment.reason}", code=NOT_ALIGNED
        )
    if alignment.old_from_new is None:  # it may fit in more than one way, but this one is right
        return Alignment(old_from_new=IDENTITY, reason="the maps are identical")
    return alignment


def _motion(alignment: Alignment) -> BentMotion:
    """The motion from the new map to the old one, as its submaps lie in it."""
    assert alignment.old_from_new is not None
    pieces = () if alignment.ground is None else alignment.ground.pieces
    anchors = tuple(
        Anchor(fit.centre, fit.old_from_new, fit.confirmed_m)
        for fit in pieces
        if fit.score >= _LEAST_FIT
        and fit.confirmed_m >= max(_LEAST_WALLS_M, _LEAST_SHARE * fit.walls_m)
    )
    return BentMotion(alignment.old_from_new, anchors)

"""Two maps of one building against each other: aligned by recognition, then what differs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from specmap_cli.core.errors import NOT_ALIGNED, NoResultError
from specmap_cli.core.geometry import IDENTITY, BentMotion
from specmap_cli.core.json_values import transform
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted, encodable, to_json
from specmap_cli.drawing.comparison import render_comparison
from specmap_cli.grids.map_server import write_png
from specmap_cli.maps.comparison import (
    AlignmentRecord,
    ComparisonRecord,
    DoorsRecord,
    MapFigures,
    ThingsRecord,
)
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.map_in_making import quality_of_stored
from specmap_cli.pipelines.overlaps import (
    GuessedStretch,
    aligned,
    stored_to_align,
    stretch_of_stored,
    told_m,
    with_other_lengths,
)
from specmap_cli.recognition.closure.alignment import Alignment, align, told_length
from specmap_cli.recognition.closure.common_ground import bent_motion
from specmap_cli.topology.differences import Crossing, Differences, Obstacle, differences
from specmap_cli.topology.topological_map import default_name

FILES = COMPARISON, SUMMARY, PICTURE = "compare.json", "summary.txt", "compare.png"


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two stored maps, where the new one lies in the old one, and what differs."""

    old: Map
    new: Map
    alignment: Alignment
    old_from_new: BentMotion
    differences: Differences
    identical: bool

    @property
    def record(self) -> ComparisonRecord:
        """The same as it is written to compare.json."""
        alignment, found = self.alignment, self.differences
        ground = alignment.ground
        assert alignment.old_from_new is not None
        return ComparisonRecord(
            schema_version=1,
            old=_figures(self.old),
            new=_figures(self.new),
            identical=self.identical,
            alignment=AlignmentRecord(
                old_from_new=transform(alignment.old_from_new),
                votes=len(alignment.joints),
                submaps=alignment.submaps,
                area_m2=alignment.area_m2,
                walls_m=0.0 if ground is None else ground.confirmed_m,
                residual_m=0.0 if ground is None else ground.residual_m,
                rival=alignment.rival,
                longer_m=alignment.longer_m,
            ),
            submaps=found.identity,
            doors=DoorsRecord(closed=found.closed, opened=found.opened),
            things=ThingsRecord(appeared=found.appeared, vanished=found.vanished),
        )


@one_blas_thread()
def compare_maps(
    old: Map | Path | str,
    new: Map | Path | str,
    config: Config | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """What differs between two maps, directories or read ones.

    The limits of `config` bound the files that are read. Raises NoResultError when the maps cannot
    be aligned, MapError for a directory that is no map or damaged.
    """
    progress = progress or Silent()
    one, other = opened_map(old, "old", config), opened_map(new, "new", config)
    grids = one.map_grid, other.map_grid
    identical = (
        one.record.text() == other.record.text()
        and grids[0].origin == grids[1].origin
        and grids[0].resolution == grids[1].resolution
        and np.array_equal(grids[0].cells, grids[1].cells)
    )
    progress.start("comparing", None)
    stretch = stretch_of_stored(other)
    alignment = _aligned(one, other, stretch)
    if alignment.old_from_new is None and not identical:
        raise NoResultError(
            f"not aligned with {one.path}: {alignment.reason}", where=other.path, code=NOT_ALIGNED
        )
    if alignment.old_from_new is None:  # it may fit in more than one way, but this one is right
        alignment = Alignment(old_from_new=IDENTITY, reason="the maps are identical")
    assert alignment.old_from_new is not None
    ground = alignment.ground
    fits = () if ground is None else (*ground.new, *ground.old)
    motion = bent_motion(alignment.old_from_new, fits)
    tracks = one.labels.poses, other.labels.poses
    if stretch is not None and alignment.longer_m:
        motion = stretch.motion(motion, tracks[1], alignment.longer_m)
    found = differences(one.regions, other.regions, tracks, motion)
    return Comparison(
        old=one,
        new=other,
        alignment=alignment,
        old_from_new=motion,
        differences=found,
        identical=identical,
    )


def write_comparison(comparison: Comparison, directory: Path) -> None:
    """Write summary, compare.json and the picture into a `result_directory` of `FILES`."""
    picture = render_comparison(
        comparison.old.regions,
        comparison.new.regions,
        comparison.old_from_new,
        comparison.differences,
        (comparison.old.path.resolve().name, comparison.new.path.resolve().name),
    )
    summary = "\n".join(lines_of(comparison.record)) + "\n"
    (directory / SUMMARY).write_text(summary, encoding="utf-8")
    (directory / COMPARISON).write_text(to_json(comparison.record.model_dump()), encoding="utf-8")
    write_png(directory / PICTURE, picture)


def _aligned(old: Map, new: Map, stretch: GuessedStretch | None) -> Alignment:
    """Where one stored map lies in another; a stretch of the new one may be longer or shorter."""
    given = stored_to_align(old), stored_to_align(new)
    if stretch is None:
        return align(*given)
    off_m = told_m(quality_of_stored(old).findings)
    with new.scans() as store:
        return aligned(*given, with_other_lengths(stretch, off_m, store, new.labels, new.config))


def _figures(stored: Map) -> MapFigures:
    return MapFigures(
        map=encodable(str(stored.path)),
        names={id_: room.name for id_, room in stored.rooms.items()},
        submaps=len(stored.rooms),
        edges=len(stored.record.edges),
        keyframes=len(stored.labels.stamps_ns),
        path_m=stored.driven_m,
        duration_s=stored.duration_s,
        area_m2=stored.record.area_m2,
        verdict=stored.verdict,
    )


def lines_of(record: ComparisonRecord, called: tuple[str, str] | None = None) -> list[str]:
    """A comparison in words; the old and the new map are `called` so, by default by their paths."""
    old, new = called or (record.old.map, record.new.map)
    if record.identical:
        return [f"{new}: identical to {old}"]
    at, doors, things = record.alignment, record.doors, record.things
    changes = [*doors.closed, *doors.opened, *things.appeared, *things.vanished]
    return [
        f"{new} against {old}: "
        f"aligned by {counted(at.submaps, 'submap')} of either map, "
        f"{at.area_m2:.0f} m2 are in both, off by {at.residual_m:.2f} m{told_length(at.longer_m)}",
        *_of_submaps(record),
        *(f"way closed: {_where(door, record.old.names)}" for door in doors.closed),
        *(
            f"way opened: {_where(door, record.new.names)}, by the ids of the new map"
            for door in doors.opened
        ),
        *_of_things("appeared", things.appeared, record.old.names),
        *_of_things("vanished", things.vanished, record.old.names),
        *([] if changes or record.submaps.gone else ["the building: no change found"]),
        f"driven: {record.old.path_m:.0f} m, then {record.new.path_m:.0f} m; submaps: "
        f"{record.old.submaps}, then {record.new.submaps}; area: "
        f"{record.old.area_m2:.0f} m2, then {record.new.area_m2:.0f} m2",
    ]


def _of_submaps(record: ComparisonRecord) -> list[str]:
    """What became of the submaps: all that are the same in one line, the others by id."""
    submaps, old, new = record.submaps, record.old.names, record.new.names
    lines = [f"submaps: {len(submaps.same)} the same"]
    for what, ids, names in (
        ("new", submaps.new, new),
        ("gone", submaps.gone, old),
        ("not seen again", submaps.unseen, old),
    ):
        if ids:
            lines.append(f"submaps {what}: {_listed(ids, names)}")
    for split in submaps.split:
        lines.append(f"submap {_listed([split.old], old)} is now {_listed(split.new, new)}")
    for merge in submaps.merged:
        lines.append(f"submaps {_listed(merge.old, old)} are now {_listed([merge.new], new)}")
    before, after = _listed(submaps.redrawn_old, old), _listed(submaps.redrawn_new, new)
    if before and after:
        lines.append(f"submaps divided otherwise: {before}, now {after}")
    elif before or after:
        which = "old" if before else "new"
        lines.append(f"submaps divided otherwise, in the {which} map alone: {before or after}")
    return lines


def _where(door: Crossing, names: Mapping[int, str]) -> str:
    a, b = (_listed([id_], names) for id_ in door.between)
    return f"{door.width_m:.1f} m wide, between {a} and {b}, at ({door.x:.1f}, {door.y:.1f})"


def _of_things(what: str, things: Sequence[Obstacle], names: Mapping[int, str]) -> list[str]:
    return [
        f"{what}: {one.length_m:.1f} m x {one.width_m:.1f} m at ({one.x:.1f}, {one.y:.1f})"
        + ("" if one.old_submap is None else f", in {_listed([one.old_submap], names)}")
        for one in things
    ]


def _listed(ids: Iterable[int], names: Mapping[int, str]) -> str:
    """Ids with the names that a person gave: a submap's own name is `submap` and its id."""
    return ", ".join(
        f"{id_} ({names[id_]})" if names[id_] != default_name(id_) else str(id_) for id_ in ids
    )

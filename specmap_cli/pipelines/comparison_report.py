"""A comparison of two maps as a record and in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from specmap_cli.core.json_values import point, transform
from specmap_cli.core.text import counted, encodable
from specmap_cli.maps.comparison import (
    SCHEMA_VERSION,
    AlignmentRecord,
    ComparisonRecord,
    DoorRecord,
    DoorsRecord,
    MapFigures,
    MergeRecord,
    SplitRecord,
    SubmapsRecord,
    ThingRecord,
    ThingsRecord,
)
from specmap_cli.maps.store import StoredMap
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.topology.differences import Crossing, Differences, PlacedThing
from specmap_cli.topology.identity import Identity
from specmap_cli.topology.topological_map import default_name, driven_m, starts_of


def record_of(
    maps: tuple[StoredMap, StoredMap], alignment: Alignment, found: Differences, identical: bool
) -> ComparisonRecord:
    """The contents of compare.json for an old and a new map, which were aligned."""
    old, new = map(_figures, maps)
    return ComparisonRecord(
        schema_version=SCHEMA_VERSION,
        old=old,
        new=new,
        identical=identical,
        alignment=_alignment(alignment),
        submaps=_submaps(found.identity),
        doors=DoorsRecord(
            closed=[_door(way) for way in found.closed], opened=[_door(way) for way in found.opened]
        ),
        things=ThingsRecord(
            appeared=[_thing(one) for one in found.appeared],
            vanished=[_thing(one) for one in found.vanished],
        ),
    )


def _figures(stored: StoredMap) -> MapFigures:
    labels, quality = stored.labels, stored.record.graph.quality
    return MapFigures(
        map=encodable(str(stored.path)),
        names={node.id: node.name for node in stored.record.nodes},
        submaps=len(stored.record.nodes),
        edges=len(stored.record.edges),
        keyframes=len(labels.stamps_ns),
        path_m=driven_m(stored.logs, labels),
        duration_s=labels.duration_s(starts_of(stored.logs)),
        area_m2=stored.map_grid.free_area_m2,
        verdict=None if quality is None else quality.verdict,
    )


def lines_of(record: ComparisonRecord) -> list[str]:
    """A comparison in words."""
    if record.identical:
        return [f"{record.new.map}: identical to {record.old.map}"]
    at = record.alignment
    return [
        f"{record.new.map} against {record.old.map}: "
        f"aligned by {counted(at.submaps, 'submap')} of either map, "
        f"{at.area_m2:.0f} m2 are in both, off by {at.residual_m:.2f} m",
        *_of_submaps(record),
        *_of_doors(record),
        *_of_things("appeared", record.things.appeared, record.old.names),
        *_of_things("vanished", record.things.vanished, record.old.names),
        *([] if _changes(record) else ["the building: no change found"]),
        f"driven: {record.old.path_m:.0f} m, then {record.new.path_m:.0f} m; submaps: "
        f"{record.old.submaps}, then {record.new.submaps}; free cells: "
        f"{record.old.area_m2:.0f} m2, then {record.new.area_m2:.0f} m2",
    ]


def _changes(record: ComparisonRecord) -> bool:
    doors, things = record.doors, record.things
    return bool(doors.closed or doors.opened or things.appeared or things.vanished) or bool(
        record.submaps.gone
    )


def _alignment(alignment: Alignment) -> AlignmentRecord:
    ground = alignment.ground
    assert alignment.old_from_new is not None
    return AlignmentRecord(
        old_from_new=transform(alignment.old_from_new),
        votes=alignment.votes,
        submaps=alignment.party,
        area_m2=alignment.area_m2,
        walls_m=0.0 if ground is None else ground.confirmed_m,
        residual_m=0.0 if ground is None else ground.residual_m,
        rival=alignment.rival,
    )


def _submaps(identity: Identity) -> SubmapsRecord:
    return SubmapsRecord(
        same=identity.same,
        split=[SplitRecord(old=old, new=list(new)) for old, new in identity.splits.items()],
        merged=[MergeRecord(old=list(old), new=new) for new, old in identity.merges.items()],
        new=list(identity.added),
        unseen=list(identity.unseen),
        gone=list(identity.gone),
        redrawn_old=list(identity.redrawn[0]),
        redrawn_new=list(identity.redrawn[1]),
    )


def _door(way: Crossing) -> DoorRecord:
    x, y = way.place.tolist()
    return DoorRecord(between=way.between, x=x, y=y, width_m=way.width_m)


def _thing(one: PlacedThing) -> ThingRecord:
    thing = one.thing
    x, y = thing.centre.tolist()
    return ThingRecord(
        x=x,
        y=y,
        length_m=thing.length_m,
        width_m=thing.width_m,
        area_m2=thing.area_m2,
        corners=[point(corner) for corner in thing.corners],
        old_submap=one.old_submap,
        new_submap=one.new_submap,
    )


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
    if submaps.redrawn_old or submaps.redrawn_new:
        before, after = _listed(submaps.redrawn_old, old), _listed(submaps.redrawn_new, new)
        lines.append(f"submaps divided otherwise: {before or 'none'}, now {after or 'none'}")
    return lines


def _of_doors(record: ComparisonRecord) -> list[str]:
    return [
        *(f"way closed: {_where(door, record.old.names)}" for door in record.doors.closed),
        *(
            f"way opened: {_where(door, record.new.names)}, by the ids of the new map"
            for door in record.doors.opened
        ),
    ]


def _where(door: DoorRecord, names: Mapping[int, str]) -> str:
    a, b = (_listed([id_], names) for id_ in door.between)
    return f"{door.width_m:.1f} m wide, between {a} and {b}, at ({door.x:.1f}, {door.y:.1f})"


def _of_things(what: str, things: Sequence[ThingRecord], names: Mapping[int, str]) -> list[str]:
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

"""What a person decided about a map: asked for, read, and made to hold.

Edits are names, kinds and properties of submaps, moved borders, and forbidden doors. One that does
not apply is told and stays in edits.toml: the submap may come back.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.records import Labels
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import GridMap, Piece
from specmap_cli.maps import filenames
from specmap_cli.maps.edits import (
    EDITS,
    Change,
    Edits,
    ForbidEdit,
    MergeEdit,
    SplitEdit,
    SubmapEdit,
    borders_in,
    read_edits,
    said_in,
)
from specmap_cli.maps.store import Map
from specmap_cli.topology.identity import Redrawn, redrawn
from specmap_cli.topology.navigation import Shut, shut_by, with_detours, with_shut
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import (
    BorderEdit,
    Said,
    Split,
    TopologicalMap,
    default_name,
)

_REQUESTED = replace(EDITS, error=UsageError, advice=": see `specmap edit --help`")


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestedEdits:
    """Edits to be made: of submaps by id, then `changes` as in edits.toml, in order.

    A name that is empty, and a property that is None, are taken back; `forget` are submaps of which
    all is taken back. `undo` are numbers of changes that were made before, from 1.
    """

    names: Mapping[int, str] = field(default_factory=dict)
    kinds: Mapping[int, str] = field(default_factory=dict)
    properties: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    forget: tuple[int, ...] = ()
    changes: tuple[Mapping[str, Any], ...] = ()
    undo: tuple[int, ...] = ()

    @property
    def submaps(self) -> list[int]:
        """The submaps of which something is said, ascending."""
        return sorted({*self.names, *self.kinds, *self.properties})


def with_requested(edits: Edits, requested: RequestedEdits) -> Edits:
    """The edits with what is asked for. Raises UsageError for what can be no edit."""
    undone = [change for n, change in enumerate(edits.changes, start=1) if n in requested.undo]
    joined = {change.new for change in undone if isinstance(change, SplitEdit)}
    gone = joined.union(requested.forget)
    submaps: dict[int, Any] = {
        id_: edit.model_dump() for id_, edit in edits.submaps.items() if id_ not in gone
    }
    for id_ in requested.submaps:
        said = submaps[id_] = dict(submaps.get(id_, {}))
        properties = {**said.get("properties", {}), **requested.properties.get(id_, {})}
        said["properties"] = {key: value for key, value in properties.items() if value is not None}
        if id_ in requested.names:
            said["name"] = requested.names[id_] or None
        if id_ in requested.kinds:
            said["kind"] = requested.kinds[id_]
    stay = [change.model_dump() for change in _not_undone(edits, requested.undo)]
    changes = [*stay, *requested.changes]
    return _saying(_REQUESTED.value({"submaps": submaps, "changes": changes}, "edit: "))


def _not_undone(edits: Edits, undo: Collection[int]) -> list[Change]:
    """The changes that stay. A door forbidden for a part stays so for the whole it was cut from."""
    for number in undo:
        if not 1 <= number <= len(edits.changes):
            known = counted(len(edits.changes), "change")
            raise UsageError(
                f"there is no such change: edits.toml has {known}", where=f"--undo {number}"
            )
    kept: list[Change] = []
    was: dict[int, tuple[int, ...]] = {}
    for number, change in enumerate(edits.changes, start=1):
        if number not in undo and isinstance(change, ForbidEdit):
            one, other = (was.get(end, (end,)) for end in change.forbid)
            pairs = [(a, b) for a in one for b in other if a != b]
            kept += [ForbidEdit(forbid=pair, at=change.at) for pair in pairs]
        elif number not in undo:
            kept.append(change)
        elif isinstance(change, SplitEdit) and change.new is not None:
            was[change.new] = (change.split,)
        elif isinstance(change, MergeEdit):
            was[change.merge[0]] = change.merge
    return kept


@dataclass(frozen=True, slots=True)
class Drawn(Redrawn):
    """Keyframes with the borders of `edits`, in which each split that was made has its new id."""

    edits: Edits = field(default_factory=Edits)


def edits_of_stored(stored: Map) -> Edits:
    """The edits.toml of a map, with the names and properties written into topology.json by hand.

    Raises MapError when the file is damaged, and when it is gone though the map shows edits.
    """
    edits = read_edits(stored.path, stored.limits)
    record = stored.record.graph.edits
    path = stored.path / filenames.EDITS
    if (record.submaps or record.borders) and not path.exists():
        raise MapError(
            "is missing, but the map shows edits",
            "put it back, or make it an empty file to undo them",
            where=path,
        )
    shown = {each.id: each for each in record.submaps}
    submaps = {id_: edit.model_dump() for id_, edit in edits.submaps.items()}
    for node in stored.record.nodes:
        said = submaps.setdefault(node.id, SubmapEdit().model_dump())
        before = shown.get(node.id, Said(node.id))
        name = "" if node.name == default_name(node.id) else node.name
        if name != (before.name or "") == (said["name"] or ""):
            said["name"] = name or None
        if node.properties != before.properties and said["properties"] == before.properties:
            said["properties"] = node.properties
    there = {"submaps": submaps, "changes": edits.changes}
    return _saying(EDITS.value(there, f"{stored.path / filenames.TOPOLOGY}: "))


def _saying(edits: Edits) -> Edits:
    """The edits without submaps of which nothing is said."""
    said = {id_: edit for id_, edit in edits.submaps.items() if edit != SubmapEdit()}
    return Edits(submaps=said, changes=edits.changes)


def drawn(
    whole: GridMap,
    labels: Labels,
    borders: Sequence[BorderEdit],
    edits: Edits,
    next_id: int,
    rooms: Collection[Piece] | None,
) -> Drawn:
    """The keyframes with the borders that the edits ask for, instead of those that they have."""
    places = [n for n, change in enumerate(edits.changes) if not isinstance(change, ForbidEdit)]
    found = redrawn(whole, labels, borders, borders_in(edits), next_id, rooms)
    skipped = {places[place]: why for place, why in found.skipped.items()}
    changes, said = list(edits.changes), dict(edits.submaps)
    made = [place for place in places if place not in skipped]
    for place, border in zip(made, found.borders, strict=True):
        change = changes[place]
        if isinstance(change, SplitEdit) and isinstance(border, Split) and border.new is not None:
            changes[place] = SplitEdit(split=change.split, line=change.line, new=border.new)
            if change.new is None and change.split in said:  # half a room is as slow as the whole
                own = {**said[change.split].model_dump(), "name": None}
                said.setdefault(border.new, SubmapEdit(**own))
    numbered = _saying(Edits(submaps=said, changes=tuple(changes)))
    return Drawn(found.submaps, found.borders, found.next_id, skipped, numbered)


def named(
    topology: TopologicalMap, regions: Regions, edits: Edits, skipped: Mapping[int, str]
) -> tuple[TopologicalMap, tuple[str, ...]]:
    """The map with names, kinds, properties and forbidden links, and what does not apply, in words.

    `topology` and its `regions` have the borders of the edits; `skipped` are the changes that could
    not be made. Ways lead round forbidden doors.
    """
    said = said_in(edits)
    shown = {each.id: each for each in said if each.id in topology.submaps}
    submaps = {}
    for id_, submap in topology.submaps.items():
        own = shown.get(id_, Said(id_))
        submaps[id_] = replace(
            submap, name=own.name or "", kind=own.kind, properties=own.properties
        )
    shut, made = Shut(), 0
    refused = dict(skipped)  # why a change does not apply, by its place
    for place, change in enumerate(edits.changes):
        if isinstance(change, ForbidEdit):
            later = topology.borders[made:]  # made after it was said
            found = shut_by(topology, change.forbid, change.at, later)
            if isinstance(found, str):
                refused[place] = found
            else:
                shut |= found
        elif place not in skipped:
            made += 1
    topology = with_detours(topology, regions, shut.doors)
    told = [
        f"submaps.{each.id}: there is no submap {each.id}" for each in said if each.id not in shown
    ]
    told += [f"{number_of(place)}: {reason}" for place, reason in sorted(refused.items())]
    allowed = with_shut(topology, shut)
    return replace(allowed, submaps=submaps, said=tuple(shown.values())), tuple(told)


def number_of(place: int) -> str:
    """What a change is called by its place in the list."""
    return f"changes, number {place + 1}"

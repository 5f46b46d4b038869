"""What a person decided, made to hold in a map: borders, names, kinds, properties, forbidden doors.

An edit that does not apply is told and stays in edits.toml: the submap may come back.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from specmap_cli.core.errors import MapError
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps import filenames
from specmap_cli.maps.edits import (
    Edits,
    ForbidEdit,
    SplitEdit,
    SubmapEdit,
    borders_in,
    read_edits,
    said_in,
)
from specmap_cli.maps.store import StoredMap
from specmap_cli.topology.navigation import Forbidden, Shut, shut_by, with_detours, with_shut
from specmap_cli.topology.redrawing import redrawn
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import (
    BorderEdit,
    Said,
    Split,
    TopologicalMap,
    default_name,
)


@dataclass(frozen=True, slots=True)
class Drawn:
    """Keyframes with the borders of some edits: `submaps` (n,), and the `borders` that were made.

    In `edits` every split that was made has the id of its new submap. `skipped` says why a change
    could not be made, by its place in the list.
    """

    submaps: IntArray
    borders: tuple[BorderEdit, ...]
    next_id: int
    edits: Edits
    skipped: Mapping[int, str] = field(default_factory=dict)


def edits_of_stored(stored: StoredMap) -> Edits:
    """The edits.toml of a map, with the names and properties written into topology.json by hand.

    Raises MapError when the file is damaged, and when it is gone though the map shows edits.
    """
    edits = read_edits(stored.path, stored.limits)
    record = stored.record.graph.edits
    path = stored.path / filenames.EDITS
    if (record.submaps or record.borders) and not path.exists():
        raise MapError(
            f"{path}: is missing, but the map shows edits: put it back, or make it an empty file "
            "to undo them"
        )
    shown = {each.id: each for each in record.submaps}
    submaps = dict(edits.submaps)
    for node in stored.record.nodes:
        by_hand, before = submaps.get(node.id, SubmapEdit()), shown.get(node.id, Said(node.id))
        name = "" if node.name == default_name(node.id) else node.name
        if name != (before.name or "") == (by_hand.name or ""):
            by_hand = by_hand.model_copy(update={"name": name or None})
        if node.properties != before.properties and by_hand.properties == before.properties:
            by_hand = by_hand.model_copy(update={"properties": node.properties})
        submaps[node.id] = by_hand
    return edits.model_copy(
        update={"submaps": {id_: edit for id_, edit in submaps.items() if edit != SubmapEdit()}}
    )


def drawn(
    whole: GridMap, labels: Labels, borders: Sequence[BorderEdit], edits: Edits, next_id: int
) -> Drawn:
    """The keyframes with the borders that the edits ask for, instead of those that they have."""
    places = [n for n, change in enumerate(edits.changes) if not isinstance(change, ForbidEdit)]
    found = redrawn(whole, labels, borders, borders_in(edits), next_id)
    skipped = {places[place]: why for place, why in found.skipped.items()}
    made = dict(zip([n for n in places if n not in skipped], found.borders, strict=True))
    changes = tuple(_with_id(change, made.get(n)) for n, change in enumerate(edits.changes))
    numbered = edits.model_copy(update={"changes": changes})
    return Drawn(found.submaps, found.borders, found.next_id, numbered, skipped)


def named(
    topology: TopologicalMap, regions: Regions | None, edits: Edits, skipped: Mapping[int, str]
) -> tuple[TopologicalMap, tuple[str, ...]]:
    """The map with names, kinds, properties and forbidden links, and what does not apply, in words.

    `topology` and its `regions` have the borders of the edits; `skipped` are the changes that could
    not be made. Where the regions are known ways lead round forbidden doors.
    """
    said = said_in(edits)
    shown = {each.id: each for each in said if each.id in topology.submaps}
    submaps = {}
    for id_, submap in topology.submaps.items():
        own = shown.get(id_, Said(id_))
        submaps[id_] = replace(
            submap, name=own.name or "", kind=own.kind, properties=own.properties
        )
    allowed, unlinked = _forbidden(topology, regions, edits, skipped)
    told = [
        f"submaps.{each.id}: there is no submap {each.id}" for each in said if each.id not in shown
    ]
    why = sorted({**skipped, **unlinked}.items())
    told += [f"{number_of(place)}: {reason}" for place, reason in why]
    return replace(allowed, submaps=submaps, said=tuple(shown.values())), tuple(told)


def number_of(place: int) -> str:
    """What a change is called by its place in the list."""
    return f"changes, number {place + 1}"


def tell_unapplied(unapplied: Sequence[str], progress: Progress) -> None:
    """Note the edits that do not apply."""
    for line in unapplied:
        progress.note(f"{filenames.EDITS}: not applied: {line}")


def _with_id(change: object, made: BorderEdit | None) -> object:
    """A change; a split that was made has the id of the new submap."""
    if isinstance(change, SplitEdit) and isinstance(made, Split):
        return change.model_copy(update={"new": made.new})
    return change


def _forbidden(
    topology: TopologicalMap, regions: Regions | None, edits: Edits, skipped: Mapping[int, str]
) -> tuple[TopologicalMap, dict[int, str]]:
    """The map with its forbidden doors and links, and why a change forbids none, by its place."""
    shut = Shut()
    unlinked: dict[int, str] = {}
    for place, wish in _wishes(edits, topology.borders, skipped):
        found = shut_by(topology, wish)
        if isinstance(found, str):
            unlinked[place] = found
        else:
            shut |= found
    if regions is not None:
        topology = with_detours(topology, regions, shut.doors)
    return with_shut(topology, shut), unlinked


def _wishes(
    edits: Edits, borders: Sequence[BorderEdit], skipped: Mapping[int, str]
) -> Iterator[tuple[int, Forbidden]]:
    """What is forbidden, with the borders that were made after it was said."""
    made = 0
    for place, change in enumerate(edits.changes):
        if isinstance(change, ForbidEdit):
            yield place, Forbidden(change.forbid, change.at, tuple(borders[made:]))
        elif place not in skipped:
            made += 1

"""What a person asks to be edited, added to what was decided before."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from specmap_cli.core.errors import UsageError
from specmap_cli.core.text import counted
from specmap_cli.maps.edits import (
    EDITS,
    Change,
    Edits,
    ForbidEdit,
    MergeEdit,
    SplitEdit,
    SubmapEdit,
)

_WISHED = replace(EDITS, error=UsageError, advice=": see `specmap edit --help`")


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
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


def with_wishes(edits: Edits, wishes: Wishes) -> Edits:
    """The edits with what is asked for. Raises UsageError for what can be no edit."""
    submaps: dict[int, Any] = {
        id_: edit.model_dump() for id_, edit in edits.submaps.items() if id_ not in wishes.forget
    }
    for id_ in wishes.submaps:
        submaps[id_] = _said(submaps.get(id_, {}), id_, wishes)
    stay = [change.model_dump() for change in _not_undone(edits, wishes.undo)]
    changes = [*stay, *wishes.changes]
    found = _WISHED.value({"submaps": submaps, "changes": changes}, "edit: ")
    said = {id_: edit for id_, edit in found.submaps.items() if edit != SubmapEdit()}
    return found.model_copy(update={"submaps": said})


def _said(before: Mapping[str, Any], id_: int, wishes: Wishes) -> dict[str, Any]:
    """What is said of one submap."""
    properties = {**before.get("properties", {}), **wishes.properties.get(id_, {})}
    said = {
        **before,
        "properties": {key: value for key, value in properties.items() if value is not None},
    }
    if id_ in wishes.names:
        said["name"] = wishes.names[id_] or None
    if id_ in wishes.kinds:
        said["kind"] = wishes.kinds[id_]
    return said


def _not_undone(edits: Edits, undo: Collection[int]) -> list[Change]:
    """The changes that stay. A door forbidden for a part stays so for the whole it was cut from."""
    for number in undo:
        if not 1 <= number <= len(edits.changes):
            known = counted(len(edits.changes), "change")
            raise UsageError(f"--undo {number}: there is no such change: edits.toml has {known}")
    kept: list[Change] = []
    was: dict[int, tuple[int, ...]] = {}
    for number, change in enumerate(edits.changes, start=1):
        if number not in undo:
            kept += _renamed(change, was)
        elif isinstance(change, SplitEdit) and change.new is not None:
            was[change.new] = (change.split,)
        elif isinstance(change, MergeEdit):
            was[change.merge[0]] = change.merge
    return kept


def _renamed(change: Change, was: Mapping[int, tuple[int, ...]]) -> list[Change]:
    """A change that stays when others before it are undone, where it forbids a door."""
    if not isinstance(change, ForbidEdit):
        return [change]
    one, other = (was.get(end, (end,)) for end in change.forbid)
    pairs = [(a, b) for a in one for b in other if a != b]
    return [change.model_copy(update={"forbid": pair}) for pair in pairs]

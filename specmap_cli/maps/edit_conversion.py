"""A person's edits as the records of topology.json, and back; and as borders to be made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from specmap_cli.maps.edits import Change, Edits, ForbidEdit, MergeEdit, SubmapEdit
from specmap_cli.maps.schema_edits import EditsRecord, MergeRecord, SaidRecord, SplitRecord
from specmap_cli.maps.schema_values import Span, point
from specmap_cli.topology.borders import Border, Line, Merge, Split
from specmap_cli.topology.topological_map import Said


def edits_record(said: Mapping[int, Said], borders: Sequence[Border]) -> EditsRecord:
    """What of a person's edits a map shows."""
    return EditsRecord(
        submaps=[_said_record(id_, said[id_]) for id_ in sorted(said) if said[id_] != Said()],
        borders=[_border_record(border) for border in borders],
    )


def said_of(record: EditsRecord) -> dict[int, Said]:
    """What a person said of the submaps."""
    return {
        each.id: Said(each.name or "", each.kind, dict(each.properties)) for each in record.submaps
    }


def borders_of(record: EditsRecord) -> tuple[Border, ...]:
    """The borders that were made."""
    return tuple(_border(each) for each in record.borders)


def fences_in(record: EditsRecord) -> list[Line]:
    """The lines that no region of the map reaches across."""
    return [each.fence for each in record.borders if isinstance(each, SplitRecord)]


def said_in(edits: Edits) -> dict[int, Said]:
    """What edits.toml says of the submaps."""
    return {
        id_: Said(edit.name or "", edit.kind, dict(edit.properties))
        for id_, edit in edits.submaps.items()
        if edit != SubmapEdit()
    }


def borders_in(changes: Iterable[Change]) -> list[Border]:
    """The borders that edits.toml asks for, to the decimals that a map keeps."""
    return [_wished(change) for change in changes if not isinstance(change, ForbidEdit)]


def _wished(change: Change) -> Border:
    if isinstance(change, MergeEdit):
        return Merge(*change.merge)
    assert not isinstance(change, ForbidEdit)
    return Split(change.split, _line(change.line), change.new)


def _line(ends: Line) -> Line:
    one, other = ends
    return point(one), point(other)


def _said_record(id_: int, said: Said) -> SaidRecord:
    return SaidRecord(
        id=id_, name=said.name or None, kind=said.kind, properties=dict(said.properties)
    )


def _border_record(border: Border) -> MergeRecord | SplitRecord:
    """Raises ValueError for a border that was not made."""
    if isinstance(border, Merge):
        return MergeRecord(
            merge=(border.kept, border.gone),
            keyframes=runs_of(border.keyframes),
            known=border.known,
        )
    if border.new is None or border.fence is None:
        raise ValueError("a border that was not made cannot be kept")
    return SplitRecord(
        split=border.submap, new=border.new, line=_line(border.line), fence=_line(border.fence)
    )


def _border(record: MergeRecord | SplitRecord) -> Border:
    if isinstance(record, MergeRecord):
        return Merge(*record.merge, keyframes=numbers_of(record.keyframes), known=record.known)
    return Split(record.split, record.line, record.new, record.fence)


def runs_of(keyframes: Sequence[int]) -> list[Span]:
    """Ascending numbers as runs [first, last]."""
    numbers = np.array(keyframes, dtype=np.int64)
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs if len(run)]


def numbers_of(runs: Iterable[Span]) -> tuple[int, ...]:
    """The numbers in runs [first, last]."""
    return tuple(number for first, last in runs for number in range(first, last + 1))

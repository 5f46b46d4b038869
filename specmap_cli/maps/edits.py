"""edits.toml: what a person decided about a map, read, checked and written.

The tables `[submaps.ID]` hold names, kinds and properties; `[[changes]]` are merges, splits and
forbidden doors, in the order in which they are made. docs/edit.md shows the file. What did not
change stays as a person wrote it, comments and all.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
)

from specmap_cli.core.errors import MapError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.json_values import PropertyValue, Record, point
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.toml import Keys, TomlFormat, toml_value
from specmap_cli.maps import filenames
from specmap_cli.topology.topological_map import BorderEdit, Merge, Said, Split, SubmapKind

_LONGEST_NAME = 80  # characters: what a badge, a row of a table and a legend can show
_SHORTEST_LINE_M = 0.1
_LAST_ID = 999_999_999
_MOST = 1e9  # metres on the earth, and numbers that stay exact


def _one_line(text: str) -> str:
    """Refuse a name that could not be shown in a table."""
    if not text.strip() or text != text.strip() or not text.isprintable():
        raise ValueError("must be one line of printable characters, not blank at either end")
    if len(text) > _LONGEST_NAME:
        raise ValueError(f"must have {_LONGEST_NAME} characters at the most")
    return text


def _value(value: Any) -> Any:
    """Refuse what is no value of a property."""
    if isinstance(value, str):
        if any("\ud800" <= letter <= "\udfff" for letter in value):
            raise ValueError("must be text that can be written as UTF-8")
    elif not isinstance(value, bool) and not _is_number(value):
        raise ValueError(f"must be a string, true, false, or a number up to {_MOST:g}")
    return value


def _by_id(tables: Any) -> Any:
    """The tables of submaps by number."""
    if not isinstance(tables, Mapping):
        raise ValueError("must be tables such as [submaps.3]")
    for key in tables:
        if not _is_id(key) and re.fullmatch(r"0|[1-9]\d{0,8}", str(key)) is None:
            raise ValueError(f"{key!r:.60} is no id of a submap: expected a number, as in 3")
    return {int(key): table for key, table in tables.items()}


def _pair(value: Any) -> Any:
    """Refuse what are no two submaps."""
    if not isinstance(value, (list, tuple)) or len(value) != 2 or not all(map(_is_id, value)):
        raise ValueError("must be the ids of two submaps, as in [3, 4]")
    if value[0] == value[1]:
        raise ValueError("must be two different submaps")
    return value


def _place(value: Any) -> Any:
    """Refuse what is no place in the map."""
    if not isinstance(value, (list, tuple)) or len(value) != 2 or not all(map(_is_number, value)):
        raise ValueError("must be a place in metres, as in [1.5, 2.0]")
    return value


def _line(value: Any) -> Any:
    """Refuse what are no two places with something between them."""
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise ValueError("must be two places, as in [[1.5, 2.0], [1.5, 6.0]]")
    one, other = map(_place, value)
    if math.dist(one, other) < _SHORTEST_LINE_M:
        raise ValueError(f"must be two places {_SHORTEST_LINE_M:g} m apart or more")
    return value


def _is_id(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _LAST_ID


def _is_number(value: Any) -> bool:
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return known and abs(value) <= _MOST  # false for NaN as well


def _id(value: Any) -> Any:
    """Refuse what cannot be an id of a submap."""
    if not _is_id(value):
        raise ValueError("must be the id of a submap, as in 3")
    return value


Id = Annotated[int, BeforeValidator(_id)]
Place = tuple[float, float]
Pair = Annotated[tuple[int, int], BeforeValidator(_pair)]
Spot = Annotated[Place, BeforeValidator(_place)]
CutLine = Annotated[tuple[Place, Place], BeforeValidator(_line)]
Name = Annotated[str, AfterValidator(_one_line)]
Properties = dict[Name, Annotated[PropertyValue, BeforeValidator(_value)]]


class SubmapEdit(Record):
    """What a person said of a submap."""

    name: Name | None = None
    kind: SubmapKind | None = None
    properties: Properties = Field(default_factory=dict)


class MergeEdit(Record):
    """The second submap becomes part of the first one."""

    merge: Pair


class SplitEdit(Record):
    """A submap is cut along a line: what is right of it becomes the submap `new`."""

    split: Id
    line: CutLine
    new: Id | None = None


class ForbidEdit(Record):
    """Robots must not go from one submap to the other: nowhere, or not at a place."""

    forbid: Pair
    at: Spot | None = None


_KINDS: Mapping[str, type[Record]] = {"merge": MergeEdit, "split": SplitEdit, "forbid": ForbidEdit}


def _kind_of(change: Any) -> str | None:
    """Which of the changes a table is, None for none of them or several."""
    if isinstance(change, Record):
        return next(kind for kind, record in _KINDS.items() if isinstance(change, record))
    found = [kind for kind in _KINDS if isinstance(change, Mapping) and kind in change]
    return found[0] if len(found) == 1 else None


Change = Annotated[
    Annotated[MergeEdit, Tag("merge")]
    | Annotated[SplitEdit, Tag("split")]
    | Annotated[ForbidEdit, Tag("forbid")],
    Discriminator(
        _kind_of,
        custom_error_type="change",
        custom_error_message="must have one of the keys merge, split and forbid",
    ),
]


class Edits(Record):
    """Everything that a person decided about a map."""

    submaps: Annotated[dict[int, SubmapEdit], BeforeValidator(_by_id)] = Field(default_factory=dict)
    changes: tuple[Change, ...] = ()


def in_words(change: Change) -> str:
    """A change for a person, as an order."""
    if isinstance(change, MergeEdit):
        return f"merge {change.merge[1]} into {change.merge[0]}"
    if isinstance(change, SplitEdit):
        (x1, y1), (x2, y2) = change.line
        made = "" if change.new is None else f", the right of it is {change.new}"
        return f"split {change.split} from {x1:g}, {y1:g} to {x2:g}, {y2:g}{made}"
    where = "" if change.at is None else f" at {change.at[0]:g}, {change.at[1]:g}"
    return f"forbid the way between {change.forbid[0]} and {change.forbid[1]}{where}"


def said_in(edits: Edits) -> tuple[Said, ...]:
    """What is said of the submaps, by id, as a map keeps it."""
    return tuple(
        Said(id_, edit.name, edit.kind, dict(edit.properties))
        for id_, edit in sorted(edits.submaps.items())
        if edit != SubmapEdit()
    )


def borders_in(edits: Edits) -> list[BorderEdit]:
    """The borders that are asked for, to the decimals that a map keeps."""
    return [_requested(change) for change in edits.changes if not isinstance(change, ForbidEdit)]


def _requested(change: MergeEdit | SplitEdit) -> BorderEdit:
    if isinstance(change, MergeEdit):
        return Merge(change.merge)
    one, other = change.line
    return Split(submap=change.split, line=(point(one), point(other)), new=change.new)


def read_edits(directory: Path, limits: LimitsConfig | None = None) -> Edits:
    """The edits.toml of a map directory, without any where there is none.

    Raises MapError in one line.
    """
    return EDITS.of_text(edits_text(directory, limits), f"{directory / filenames.EDITS}: ")


def edits_text(directory: Path, limits: LimitsConfig | None = None) -> str:
    """The text of the edits.toml of a map directory; empty where there is none."""
    most_mb = (LimitsConfig() if limits is None else limits).text_max_mb
    read = partial(read_bytes, most_mb=most_mb, setting="limits.text_max_mb")
    return EDITS.text(directory / filenames.EDITS, read, missing="")


def _named(place: Keys) -> tuple[str, Sequence[str]]:
    """A key as a person finds it, and the keys that stand beside it: changes count from 1."""
    if place[0] != "changes" or len(place) < 2:
        beside = SubmapEdit if len(place) > 1 else Edits
        return ".".join(str(part) for part in place), list(beside.model_fields)
    number = f"changes, number {int(place[1]) + 1}"
    if len(place) < 4:
        return number, []
    return f"{number}: {place[3]}", list(_KINDS[str(place[2])].model_fields)


EDITS = TomlFormat(
    model=Edits,
    error=MapError,
    advice=": correct it, or see docs/edit.md",
    plainly={
        "model_type": "must be a table",
        "dict_type": "must be a table",
        "tuple_type": "must be tables such as [[changes]]",
    },
    named=_named,
)


HEAD = "# What a person decided about this map: `specmap edit` writes this, and so may you.\n"

_TABLE = re.compile(r"^[ \t]*\[", re.MULTILINE)
_COMMENTS = re.compile(r"(?:^[ \t]*#[^\n]*\n)+\Z", re.MULTILINE)


def written(edits: Edits, before: str = "") -> str:
    """The text of some edits, from the text `before` of earlier ones.

    A table that says the same as before is kept to the letter; one that is changed is written anew;
    new ones come last. Where a person's way of writing does not allow that, all is written anew.
    Empty as long as nothing was ever decided.
    """
    if edits == Edits() and not before:
        return ""
    kept = _kept(edits, before)
    return kept if kept is not None else _anew(edits)


def _anew(edits: Edits) -> str:
    """All tables in order: the submaps by id, then the changes."""
    tables = [_submap(id_, edit) for id_, edit in sorted(edits.submaps.items()) if _says(edit)]
    return "\n".join([HEAD, *tables, *(_change(change) for change in edits.changes)])


def _kept(edits: Edits, before: str) -> str | None:
    """The text with its unchanged tables, None where it cannot be taken apart."""
    pieces = list(_pieces(before))
    try:
        parts = [EDITS.of_text(piece) for piece in pieces]
    except MapError:  # a string over several lines, of which one begins as a table does
        return None
    waiting = {id_: edit for id_, edit in edits.submaps.items() if _says(edit)}
    changes = list(edits.changes)
    lines = []
    for piece, part in zip(pieces, parts, strict=True):
        lines.append(_piece(piece, part, waiting, changes))
    added = [_submap(id_, edit) for id_, edit in sorted(waiting.items())]
    added += [_change(change) for change in changes]
    text = "\n".join(["".join(lines).rstrip("\n") + "\n", *added]) if added else "".join(lines)
    return text if before.strip() and _says_the_same(text, edits) else None


def _piece(piece: str, part: Edits, waiting: dict[int, SubmapEdit], changes: list[Change]) -> str:
    """One table of the text as it is to be; what it says is taken from what is `waiting`."""
    if not part.submaps and not part.changes:
        return piece
    for id_, edit in part.submaps.items():
        wanted = waiting.pop(id_, None)
        if wanted is None:
            return ""
        if wanted != edit:
            return _comments(piece) + _submap(id_, wanted) + "\n"
    for change in part.changes:
        if change not in changes:
            return ""
        changes.remove(change)
    return piece


def _pieces(text: str) -> Iterator[str]:
    """The text before the first table, and each table with the comments right above it."""
    starts = [0]
    for match in _TABLE.finditer(text):
        above = _COMMENTS.search(text, 0, match.start())
        starts.append(match.start() if above is None else above.start())
    for start, end in zip(starts, [*starts[1:], len(text)], strict=True):
        yield text[start:end]


def _comments(piece: str) -> str:
    """The comments above a table."""
    return piece[: max(0, next(_TABLE.finditer(piece)).start())]


def _says_the_same(text: str, edits: Edits) -> bool:
    """Whether a text is TOML that says what the edits say."""
    try:
        found = EDITS.of_text(text)
    except MapError:
        return False
    said = {id_: edit for id_, edit in edits.submaps.items() if _says(edit)}
    there = {id_: edit for id_, edit in found.submaps.items() if _says(edit)}
    return there == said and found.changes == edits.changes


def _says(edit: SubmapEdit) -> bool:
    return edit != SubmapEdit()


def _submap(id_: int, edit: SubmapEdit) -> str:
    """The table of one submap."""
    said = {"name": edit.name, "kind": edit.kind, "properties": edit.properties or None}
    lines = [f"{key} = {toml_value(value)}" for key, value in said.items() if value is not None]
    return "\n".join([f"[submaps.{id_}]", *lines]) + "\n"


def _change(change: Change) -> str:
    """The table of one change."""
    said = change.model_dump(exclude_none=True)
    lines = [f"{key} = {toml_value(value)}" for key, value in said.items()]
    return "\n".join(["[[changes]]", *lines]) + "\n"

"""edits.toml: what a person decided about a map, read, checked and written.

The tables `[submaps.ID]` hold names, kinds and properties; `[[changes]]` are merges, splits and
forbidden doors, in the order in which they are made. docs/edit.md shows the file. What did not
change stays as a person wrote it, comments and all.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from specmap_cli.core.errors import MapError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.json_values import PropertyValue, Record, point
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import quoted
from specmap_cli.core.toml import Keys, TomlFormat, toml_value
from specmap_cli.maps import filenames
from specmap_cli.topology.topological_map import BorderEdit, Merge, Said, Split, SubmapKind

_LONGEST_NAME = 80  # characters: what a badge, a row of a table and a legend can show
_SHORTEST_LINE_M = 0.1
_LAST_ID = 999_999_999
_SURROGATE = re.compile("[\ud800-\udfff]")
_MOST = 1e9  # metres on the earth, and numbers that stay exact


def _one_line(text: str) -> str:
    """Refuse a name that could not be shown in a table."""
    if not text.strip() or text != text.strip() or not text.isprintable():
        raise ValueError("must be one line of printable characters, not blank at either end")
    if len(text) > _LONGEST_NAME:
        raise ValueError(f"must have {_LONGEST_NAME} characters at the most")
    return text


def _by_id(tables: Any) -> Any:
    """The tables of submaps by number."""
    if not isinstance(tables, Mapping):
        raise ValueError("must be tables such as [submaps.3]")
    for key in tables:
        if not _is_id(key) and re.fullmatch(r"0|[1-9]\d{0,8}", str(key)) is None:
            raise ValueError(f"{quoted(key)} is no id of a submap: expected a number, as in 3")
    return {int(key): table for key, table in tables.items()}


def _is_id(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _LAST_ID


def _is_number(value: Any) -> bool:
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return known and abs(value) <= _MOST  # false for NaN as well


def _is_two(value: Any, fits: Callable[[Any], bool] = lambda _: True) -> bool:
    return isinstance(value, (list, tuple)) and len(value) == 2 and all(map(fits, value))


def _is_place(value: Any) -> bool:
    return _is_two(value, _is_number)


def _must(fits: Callable[[Any], bool], told: str) -> BeforeValidator:
    """A validator that refuses what does not fit. Of several the last one looks first."""

    def check(value: Any) -> Any:
        if not fits(value):
            raise ValueError(f"must be {told}")
        return value

    return BeforeValidator(check)


Id = Annotated[int, _must(_is_id, "the id of a submap, as in 3")]
Place = tuple[float, float]
Spot = Annotated[Place, _must(_is_place, "a place in metres, as in [1.5, 2.0]")]
Pair = Annotated[
    tuple[int, int],
    _must(lambda pair: pair[0] != pair[1], "two different submaps"),
    _must(lambda value: _is_two(value, _is_id), "the ids of two submaps, as in [3, 4]"),
]
CutLine = Annotated[
    tuple[Place, Place],
    _must(
        lambda line: math.dist(*line) >= _SHORTEST_LINE_M,
        f"two places {_SHORTEST_LINE_M:g} m apart or more",
    ),
    _must(lambda line: all(map(_is_place, line)), "a place in metres, as in [1.5, 2.0]"),
    _must(_is_two, "two places, as in [[1.5, 2.0], [1.5, 6.0]]"),
]
Name = Annotated[str, AfterValidator(_one_line)]
Property = Annotated[
    PropertyValue,
    _must(
        lambda value: isinstance(value, (str, bool)) or _is_number(value),
        f"a string, true, false, or a number up to {_MOST:g}",
    ),
    _must(
        lambda value: not isinstance(value, str) or _SURROGATE.search(value) is None,
        "text that can be written as UTF-8",
    ),
]


class SubmapEdit(Record):
    """What a person said of a submap."""

    name: Name | None = None
    kind: SubmapKind | None = None
    properties: dict[Name, Property] = Field(default_factory=dict)


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
        for id_, edit in _with_words(edits).items()
    )


def _with_words(edits: Edits) -> dict[int, SubmapEdit]:
    """The submaps of which something is said, by id."""
    return {id_: edit for id_, edit in sorted(edits.submaps.items()) if edit != SubmapEdit()}


def borders_in(edits: Edits) -> list[BorderEdit]:
    """The borders that are asked for, to the decimals that a map keeps."""
    borders: list[BorderEdit] = []
    for change in edits.changes:
        if isinstance(change, MergeEdit):
            borders.append(Merge(change.merge))
        elif isinstance(change, SplitEdit):
            one, other = change.line
            line = point(one), point(other)
            borders.append(Split(submap=change.split, line=line, new=change.new))
    return borders


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
    with suppress(MapError):  # a string over several lines, of which one begins as a table does
        kept = _kept(edits, before)
        found = EDITS.of_text(kept)
        same = said_in(found) == said_in(edits) and found.changes == edits.changes
        if same and before.strip():
            return kept
    return "\n".join([HEAD, *_tables(_with_words(edits), edits.changes)])


def _kept(edits: Edits, before: str) -> str:
    """The text with its unchanged tables; MapError where it cannot be taken apart."""
    starts = [0]  # of the text before the first table, and of each with the comments right above
    for match in _TABLE.finditer(before):
        above = _COMMENTS.search(before, 0, match.start())
        starts.append(match.start() if above is None else above.start())
    waiting, changes, text = _with_words(edits), list(edits.changes), ""
    for start, end in pairwise([*starts, len(before)]):
        text += _piece(before[start:end], waiting, changes)
    added = _tables(waiting, changes)
    return "\n".join([text.rstrip("\n") + "\n", *added]) if added else text


def _piece(piece: str, waiting: dict[int, SubmapEdit], changes: list[Change]) -> str:
    """One table of the text as it is to be; what it says is taken from what is `waiting`."""
    part = EDITS.of_text(piece)
    for id_, edit in part.submaps.items():
        wanted = waiting.pop(id_, None)
        if wanted is None:
            return ""
        if wanted != edit:
            comments = piece[: next(_TABLE.finditer(piece)).start()]
            return comments + _tables({id_: wanted}, ())[0] + "\n"
    for change in part.changes:
        if change not in changes:
            return ""
        changes.remove(change)
    return piece


def _tables(submaps: Mapping[int, SubmapEdit], changes: Sequence[Change]) -> list[str]:
    """The tables of submaps, then of changes, in order."""
    tables: list[tuple[str, Record]] = [
        *((f"[submaps.{id_}]", edit) for id_, edit in sorted(submaps.items())),
        *(("[[changes]]", change) for change in changes),
    ]
    texts = []
    for head, table in tables:
        said = table.model_dump(exclude_none=True).items()
        lines = [f"{key} = {toml_value(value)}" for key, value in said if value != {}]
        texts.append("\n".join([head, *lines]) + "\n")
    return texts

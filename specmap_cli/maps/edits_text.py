"""edits.toml written: what did not change stays as a person wrote it, comments and all."""

from __future__ import annotations

import re
from collections.abc import Iterator

from specmap_cli.core.errors import MapError
from specmap_cli.core.toml import toml_value
from specmap_cli.maps.edits import EDITS, Change, Edits, SubmapEdit

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

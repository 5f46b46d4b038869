"""`specmap edit`: what a person decides about a map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from specmap_cli.cli.options import (
    Bounds,
    Common,
    MapDirectory,
    Overwrite,
    keep_inputs,
    option,
    output,
    uses_of,
)
from specmap_cli.core.errors import UsageError

if TYPE_CHECKING:
    from specmap_cli.pipelines.edits import RequestedEdits


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What is said of submaps, and what is changed of borders and ways."""

    rename: Annotated[
        list[str] | None, option('Name a submap; "" takes the name back.', metavar="ID NAME")
    ] = None
    kind: Annotated[
        list[str] | None, option("Say what it is: room, corridor or hall.", metavar="ID KIND")
    ] = None
    set_property: Annotated[
        list[str] | None,
        option(
            "Note something: text, a number, true or false; KEY= takes it back.",
            metavar="ID KEY=VALUE",
        ),
    ] = None
    forget: Annotated[
        list[int] | None, option("Take back name, kind and properties of a submap.", metavar="ID")
    ] = None
    merge: Annotated[
        list[str] | None, option("Make the second submap a part of the first.", metavar="ID ID")
    ] = None
    split: Annotated[
        list[str] | None,
        option(
            "Cut a submap along a line; what is right of it, seen from the first point, gets "
            "a new id.",
            metavar="ID X1,Y1,X2,Y2",
        ),
    ] = None
    forbid_door: Annotated[
        list[str] | None, option("Robots must not go from one to the other.", metavar="ID ID")
    ] = None
    at: Annotated[
        list[str] | None,
        option("Place of the forbidden door, once for each --forbid-door.", metavar="X,Y"),
    ] = None
    undo: Annotated[
        list[int] | None,
        option("Take back a change by its number in edits.toml.", metavar="NUMBER"),
    ] = None


def edit(
    map_: MapDirectory,
    out: Annotated[
        Path | None, output("Map directory to write; without it MAP itself is changed.")
    ] = None,
    overwrite: Overwrite = False,
    *,
    said: Said,
    settings: Bounds,
    common: Common,
) -> None:
    """Name submaps, move borders, forbid doors.

    What is decided is kept in MAP/edits.toml, which may be edited by hand, too: without options the
    file is made to hold. Updates and rebuilds with --like do so, too. MAP is replaced, complete or
    not at all; with -o it stays as it is. A map whose borders change is made anew with the settings
    that it was built with; of those given here only the section `limits` counts.

    \b
    specmap edit map --rename 3 Kitchen --kind 3 room --set-property 3 floor=2
    specmap edit map --merge 3 4 --split 5 1.5,2,1.5,6 -o map2
    specmap edit map --forbid-door 3 5 --at 1.5,2.0
    """
    from specmap_cli.exports.routes import misnoted
    from specmap_cli.pipelines.edit import edit_map

    requested = _requested(said)
    if out is not None and out.resolve() != map_.resolve():
        keep_inputs([out], [map_])
        if map_.resolve() in out.resolve().parents:
            raise UsageError(f"is inside the map {map_}", "choose another place", where=out)
    stored = settings.read(map_)
    with common.progress() as progress:
        report = edit_map(stored, requested, out, overwrite=overwrite, progress=progress)
        if requested.properties:
            for line in misnoted(settings.read(report.out).record):
                progress.warn(line)
    common.show(report.as_dict(), report.lines())


def _requested(said: Said) -> RequestedEdits:
    """What the options ask for. Raises UsageError for one that cannot be read."""
    from specmap_cli.core.toml import value_of
    from specmap_cli.pipelines.edits import RequestedEdits

    properties: dict[int, dict[str, Any]] = {}
    for id_, assignment in uses_of("--set-property", said.set_property, "ID KEY=VALUE"):
        key, separator, text = (part.strip() for part in assignment.partition("="))
        if not separator or not key:
            raise UsageError(
                hint="expected KEY=VALUE, such as floor=2", where=f"--set-property {assignment}"
            )
        # a value that is no TOML is text, an empty one takes the property back
        value = value_of(text) if text else None
        properties.setdefault(_id("--set-property", id_), {})[key] = value
    return RequestedEdits(
        names={_id("--rename", i): name for i, name in uses_of("--rename", said.rename, "ID NAME")},
        kinds={_id("--kind", i): kind for i, kind in uses_of("--kind", said.kind, "ID KIND")},
        properties=properties,
        forget=tuple(said.forget or ()),
        changes=tuple(_changes(said)),
        undo=tuple(said.undo or ()),
    )


def _changes(said: Said) -> Iterator[dict[str, Any]]:
    """The changes, as in edits.toml: merges, then splits, then forbidden doors."""
    for ids in uses_of("--merge", said.merge, "ID ID"):
        yield {"merge": [_id("--merge", id_) for id_ in ids]}
    for id_, line in uses_of("--split", said.split, "ID X1,Y1,X2,Y2"):
        x1, y1, x2, y2 = _numbers("--split", line, "X1,Y1,X2,Y2")
        yield {"split": _id("--split", id_), "line": [[x1, y1], [x2, y2]]}
    doors, places = said.forbid_door or [], said.at or []
    if places and len(places) != len(doors):
        raise UsageError(hint="give it once for each --forbid-door, or not at all", where="--at")
    for number, ids in enumerate(uses_of("--forbid-door", doors, "ID ID")):
        at = {"at": _numbers("--at", places[number], "X,Y")} if places else {}
        yield {"forbid": [_id("--forbid-door", id_) for id_ in ids], **at}


def _id(option: str, text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise UsageError(hint="expected the id of a submap, such as 3", where=f"{option} {text}")
    return int(text)


def _numbers(option: str, text: str, names: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(names.split(",")):
        hint = f"expected {names} in metres, separated by commas"
        raise UsageError(hint=hint, where=f"{option} {text}")
    return numbers

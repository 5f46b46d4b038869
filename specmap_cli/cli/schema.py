"""`specmap schema`: the JSON Schemas of what the program prints and writes."""

from __future__ import annotations

from typing import Annotated

import typer

from specmap_cli.cli.options import Common

Name = Annotated[
    str | None,
    typer.Argument(metavar="NAME", help="One of those listed without a name.", show_default=False),
]


def schema(name: Name = None, *, common: Common) -> None:
    """Print a JSON Schema, or list those that there are.

    There is one of what each command prints with --json, by the name of the command; one of an
    error; and one of each JSON file in a map. The last number of its $id is the schema_version of
    what it describes: it changes when a program that reads it would have to.

    \b
    specmap schema
    specmap schema build > build.schema.json
    """
    import json

    from specmap_cli.cli.streams import print_text
    from specmap_cli.core.schemas import read_schema, schema_names

    if name is not None:
        print_text(json.dumps(read_schema(name), indent=2, sort_keys=True) + "\n")
        return
    entries = []
    for each in schema_names():
        found = read_schema(each)
        entries.append({"name": each, "id": found["$id"], "title": found["title"]})
    lines = [f"{entry['name']:<12} {entry['title']}" for entry in entries]
    common.show({"schemas": entries}, lines)

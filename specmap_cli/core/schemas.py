"""Every JSON Schema of the package by its name: what commands print, and what files hold.

A schema is a file `NAME.schema.json` of the package: in `schemas/`, or beside the models that make
it, which are the format. That of the settings is made from the settings themselves. The `$id` of
each ends with its version, which is the `schema_version` of what it describes.

What a field means stands below it in the source of its class, which is `Described`.
"""

from __future__ import annotations

import ast
import inspect
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, GetJsonSchemaHandler

from specmap_cli.core.errors import UsageError

PACKAGE = Path(__file__).parents[1]
ENDING = ".schema.json"
DRAFT = "https://json-schema.org/draft/2020-12/schema"
SETTINGS = "config"  # what `config` prints
_OF_COMMANDS = {"compare": "comparison"}  # what prints a file that has another name


class Described:
    """The base of a model, or of a dataclass in one, whose JSON Schema says what fields mean."""

    __slots__ = ()

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: GetJsonSchemaHandler) -> Any:
        made = handler(schema)
        found = handler.resolve_ref_schema(made)
        found["description"] = inspect.getdoc(cls)
        for part, text in zip(found["properties"].values(), meanings(cls).values(), strict=True):
            part |= {"description": text} if text else {}
        return made


def meanings(kind: type) -> dict[str, str]:
    """What each field of a class means, in a line; empty where nothing stands below it."""
    found: dict[str, str] = {}
    last = ""
    for part in ast.parse(inspect.getsource(kind)).body[0].body:  # type: ignore[attr-defined]
        match part:
            case ast.AnnAssign(target=ast.Name(id=last)):
                found[last] = ""
            case ast.Expr(value=ast.Constant(value=str(text))) if last:
                found[last] = " ".join(text.split())
    return found


@dataclass(frozen=True, slots=True)
class ModelSchema:
    """The JSON Schema that a model makes, for other tools: a file of the package holds the same.

    `version` is the `schema_version` of what it describes.
    """

    model: type[BaseModel]
    name: str
    version: int
    title: str

    def document(self) -> dict[str, Any]:
        """The schema (draft 2020-12); its definitions are called by their titles."""
        made = self.model.model_json_schema()
        parts = made.pop("$defs", {})
        titles = {name: part.get("title", name) for name, part in parts.items()}
        if parts:
            made["$defs"] = {titles[name]: part for name, part in parts.items()}
        text = json.dumps(made)
        for name, title in titles.items():
            text = text.replace(f'"#/$defs/{name}"', f'"#/$defs/{title}"')
        head = {"$schema": DRAFT, "$id": f"urn:specmap:{self.name}:{self.version}"}
        return {**head, **json.loads(text), "title": self.title}

    def text(self) -> str:
        """The text of `NAME.schema.json`."""
        return json.dumps(self.document(), indent=2, sort_keys=True) + "\n"


def schema_names() -> list[str]:
    """All names, sorted."""
    return sorted([*schema_files(), SETTINGS])


def schema_files() -> dict[str, Path]:
    """The files of the package by name."""
    return {path.name.removesuffix(ENDING): path for path in PACKAGE.rglob(f"*{ENDING}")}


def read_schema(name: str) -> dict[str, Any]:
    """A schema (draft 2020-12). Raises UsageError for a name that there is none of."""
    if name == SETTINGS:
        from specmap_cli.core.settings import Config  # which stands on this module

        return ModelSchema(Config, SETTINGS, 1, "specmap config").document()
    name, files = _OF_COMMANDS.get(name, name), schema_files()
    if name not in files:
        raise UsageError(f"no schema {name!r}", f"choose from {', '.join(schema_names())}")
    found: dict[str, Any] = json.loads(files[name].read_text(encoding="utf-8"))
    return found

"""What the fields of a class mean: the text below each of them in the source."""

from __future__ import annotations

import ast
import inspect
from typing import Any

from pydantic import GetJsonSchemaHandler


class Described:
    """The base of a model, or of a dataclass in one, whose JSON Schema has these texts."""

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

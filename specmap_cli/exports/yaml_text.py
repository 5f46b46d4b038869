"""YAML of plain values in block style, such that readers of YAML 1.1 and 1.2 agree on it.

Text is always quoted, so that no word is taken for a number or for true. Numbers have a point and
no exponent: YAML 1.1 takes 1e-05 for text.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from specmap_cli.core.text import decimal, encodable


def yaml_text(value: dict[str, Any]) -> str:
    """A mapping as a document; its values are mappings, lists, text, numbers and booleans."""
    return "".join(f"{line}\n" for line in _mapping(value))


def _mapping(value: dict[str, Any]) -> Iterator[str]:
    for key, inner in value.items():
        if isinstance(inner, dict | list) and inner:
            yield f"{key}:"
            yield from _indented(inner)
        else:
            yield f"{key}: {_scalar(inner)}"


def _indented(value: dict[str, Any] | list[Any]) -> Iterator[str]:
    """A mapping or a list, further in than its key."""
    lines = _mapping(value) if isinstance(value, dict) else _items(value)
    yield from (f"  {line}" for line in lines)


def _items(value: list[dict[str, Any]]) -> Iterator[str]:
    for item in value:
        first, *others = _mapping(item)
        yield f"- {first}"
        yield from (f"  {line}" for line in others)


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return decimal(value)
    if isinstance(value, str):
        return f'"{"".join(map(_character, encodable(value)))}"'
    return json.dumps(value)  # a whole number, an empty list or mapping


def _character(character: str) -> str:
    """A character between double quotes."""
    if character in '"\\':
        return f"\\{character}"
    return character if character.isprintable() else f"\\U{ord(character):08x}"

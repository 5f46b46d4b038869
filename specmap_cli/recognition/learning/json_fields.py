"""Reading classifiers back from JSON: every value is checked, every refusal is one line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from specmap_cli.core.errors import MapError


def refuse(where: str, what: str) -> MapError:
    """The error for an entry that makes no sense."""
    return MapError(f"{where}: {what};", "build the map again", where="classifiers")


def field(entry: Any, key: str, choices: Mapping[Any, Any], where: str) -> Any:
    """`choices[entry[key]]`, refusing a missing key and a value that is no choice."""
    value = _value(entry, key, where)
    if isinstance(value, bool) or not isinstance(value, (str, int)) or value not in choices:
        raise refuse(where, f"{key!r} is {value!r}, which is not known")
    return choices[value]


def text(entry: Any, key: str, where: str) -> str:
    """The text `entry[key]`."""
    value = _value(entry, key, where)
    if not isinstance(value, str):
        raise refuse(where, f"{key!r} is {value!r}, which is no text")
    return value


def number(entry: Any, key: str, where: str) -> float:
    """The finite number `entry[key]`."""
    return _finite(_value(entry, key, where), key, where)


def numbers(entry: Any, key: str, count: int, where: str) -> list[float]:
    """The list of `count` finite numbers `entry[key]`."""
    values = _value(entry, key, where)
    if not isinstance(values, list) or len(values) != count:
        raise refuse(where, f"{key!r} is no list of {count} numbers")
    return [_finite(value, key, where) for value in values]


def objects(entry: Any, key: str, where: str = "classifier") -> list[Any]:
    """The list `entry[key]`."""
    values = _value(entry, key, where)
    if not isinstance(values, list):
        raise refuse(where, f"{key!r} is no list")
    return values


def mapping(entry: Any, key: str, where: str = "file") -> dict[str, Any]:
    """The object `entry[key]`."""
    value = _value(entry, key, where)
    if not isinstance(value, dict):
        raise refuse(where, f"{key!r} is no object")
    return value


def _value(entry: Any, key: str, where: str) -> Any:
    if not isinstance(entry, Mapping):
        raise refuse(where, "is no object")
    if key not in entry:
        raise refuse(where, f"{key!r} is missing")
    return entry[key]


def _finite(value: Any, key: str, where: str) -> float:
    try:
        finite = not isinstance(value, bool) and math.isfinite(value)
    except (TypeError, OverflowError):  # text, a list; a whole number beyond all floats
        finite = False
    if not finite:
        raise refuse(where, f"{key!r} holds {value!r:.60}, which is no finite number")
    return float(value)

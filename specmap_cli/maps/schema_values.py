"""What the records of JSON files are made of: bounded numbers, places, paths that stay inside.

Values are checked here, where they enter, so that sums and products of them cannot overflow later.
They are written with at most six decimals.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from specmap_cli.core.text import rounded


class Record(BaseModel):
    """A part of a JSON file: no key may be missing or unknown."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _inside(name: str) -> str:
    """Refuse a file name that leads out of the map directory."""
    parts = PurePosixPath(name).parts
    plain = name.isprintable() and "\\" not in name and ":" not in name
    if not parts or not plain or name.startswith("/") or ".." in parts:
        raise ValueError("must be a plain relative path inside the map directory")
    return name


def _within(limit: float) -> AfterValidator:
    """Refuse numbers beyond a limit."""

    def check(value: Any) -> Any:
        if not abs(value) <= limit:
            raise ValueError(f"must be no larger than {limit:g}")
        return value

    return AfterValidator(check)


Number = Annotated[float, _within(1e9)]  # metres, square metres, radians: what fits on the earth
Amount = Annotated[float, Field(ge=0), _within(1e9)]  # as Number, never negative
Stamp = Annotated[float, _within(9.2e9)]  # seconds: as nanoseconds they fit into 64 bits
Point = tuple[Number, Number]
Transform = tuple[Number, Number, Number]
Count = Annotated[int, Field(ge=0), _within(2**31 - 1)]  # and whatever is numbered from 0
Span = tuple[Count, Count]  # the first and the last of a run
InnerPath = Annotated[str, AfterValidator(_inside)]
PropertyValue = bool | Annotated[int, _within(1e9)] | Number | str


def point(place: Iterable[float]) -> Point:
    """A place as it is written."""
    x, y = _numbers(place)
    return x, y


def transform(pose: Iterable[float]) -> Transform:
    """A pose as it is written."""
    x, y, theta = _numbers(pose)
    return x, y, theta


def _numbers(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(rounded(float(value)) or 0.0 for value in values)

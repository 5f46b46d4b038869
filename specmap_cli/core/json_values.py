"""What the parts of JSON files are made of: bounded numbers, places, paths that stay inside.

Values are checked here, where they enter, so that sums and products of them cannot overflow later.
They are written with at most six decimals. A part that the program works with is a `Value`, a
frozen dataclass whose fields say how they stand in JSON; one that is only read and written may be
a `Record`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    TypeAdapter,
    field_validator,
)

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.schemas import Described
from specmap_cli.core.text import nanoseconds, rounded, seconds


class Record(BaseModel):
    """A part of a JSON file: no key may be missing or unknown."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Measured(Record):
    """A record of what was measured: its numbers have six decimals at the most."""

    @field_validator("*")
    @classmethod
    def _to_six_decimals(cls, value: Any) -> Any:
        return rounded(value) if isinstance(value, float) else value


def titled(title: str) -> ConfigDict:
    """How a `Value` is read, and what its schema calls it."""
    return ConfigDict(extra="forbid", allow_inf_nan=False, title=title)


class Value(Described):
    """A part of a JSON file that the program works with: the base of frozen dataclasses.

    The program makes one as any dataclass, unchecked. One that is read is checked, and no key may
    be missing or unknown: defaults are for the program, but for those named in `may_lack`.
    """

    __slots__ = ()
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid",
        allow_inf_nan=False,
        model_title_generator=lambda kind: f"{kind.__name__}Record",
    )
    may_lack: ClassVar[frozenset[str]] = frozenset()

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine, as it stands in JSON."""
        written = TypeAdapter(type(self)).dump_python(self, mode="json", by_alias=True)
        return dict(written)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        found = handler(source)
        for field in found["schema"]["fields"]:
            if field["schema"]["type"] == "default" and field["name"] not in cls.may_lack:
                field["schema"] = field["schema"]["schema"]
        return found


@dataclass(frozen=True, slots=True)
class Written:
    """How a field of a `Value` stands in JSON: as a value of type `form`, with the ways between.

    `read` makes the field from a checked value of that type, `write` the other way round.
    """

    form: Any
    read: Callable[[Any], Any] = lambda value: value
    write: Callable[[Any], Any] = lambda value: value

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> Any:
        way_back = PlainSerializer(self.write, return_type=Any)
        return handler.generate_schema(Annotated[self.form, AfterValidator(self.read), way_back])


class Unchanging(dict[str, Any]):
    """An object of a JSON file that a program may read, and not change."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError("what was read of a map cannot be changed")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type[Unchanging], tuple[dict[str, Any]]]:
        return Unchanging, (dict(self),)


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

# As the program has them, and as JSON does: nanoseconds as seconds, NaN as null.
StampNs = Annotated[int, Written(Stamp, nanoseconds, seconds)]
Motion = Annotated[Pose2, Written(Transform, lambda motion: Pose2(*motion), list)]
Corners = Annotated[
    FloatArray,  # (N, 2)
    Written(
        list[Point],
        lambda corners: np.array(corners, dtype=np.float64).reshape(-1, 2),
        np.ndarray.tolist,
    ),
]
MaybeNan = Annotated[
    float, Written(float | None, lambda value: math.nan if value is None else value, rounded)
]


def point(place: Iterable[float]) -> Point:
    """A place as it is written."""
    x, y = (rounded(float(value)) or 0.0 for value in place)
    return x, y


def transform(pose: Iterable[float]) -> Transform:
    """A pose as it is written."""
    x, y, theta = (rounded(float(value)) or 0.0 for value in pose)
    return x, y, theta


def part_of(document: Any, name: str) -> dict[str, Any]:
    """An object in a document that a person may have changed; an empty one for anything else."""
    found = document.get(name) if isinstance(document, dict) else None
    return found if isinstance(found, dict) else {}


def runs_of(numbers: Sequence[int]) -> tuple[Span, ...]:
    """Ascending numbers as runs [first, last]."""
    all_ = np.array(numbers, dtype=np.int64)
    runs = np.split(all_, np.flatnonzero(np.diff(all_) > 1) + 1)
    return tuple((int(run[0]), int(run[-1])) for run in runs if len(run))

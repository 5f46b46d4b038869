"""Values that say in their fields how they stand in JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, TypeAdapter, ValidationError

from specmap_cli.core import json_values
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.json_values import Count, Measured, Number, Value, runs_of


@dataclass(frozen=True, slots=True)
class Leg(Value):
    """A piece of a way."""

    may_lack = frozenset({"note"})

    start_ns: Annotated[json_values.StampNs, Field(alias="start", description="seconds")]
    motion: json_values.Motion | None = None
    path: json_values.Corners | None = None
    doubt: json_values.MaybeNan = math.nan
    note: str | None = None


LEGS: TypeAdapter[Leg] = TypeAdapter(Leg)
FULL = {
    "start": 1.5,
    "motion": [1.0, 2.0, 0.5],
    "path": [[0.0, 0.0], [1.0, 2.0]],
    "doubt": 0.25,
    "note": "n",
}


def test_a_value_is_read_and_written_by_itself() -> None:
    leg = LEGS.validate_python(FULL)
    assert (leg.start_ns, leg.motion, leg.doubt) == (1_500_000_000, Pose2(1.0, 2.0, 0.5), 0.25)
    assert leg.path is not None
    np.testing.assert_array_equal(leg.path, [[0.0, 0.0], [1.0, 2.0]])
    assert leg.as_dict() == FULL
    bare = Leg(7_000_000_000)
    assert bare.as_dict() == dict.fromkeys(FULL) | {"start": 7.0}
    assert math.isnan(LEGS.validate_python(bare.as_dict()).doubt)


def test_what_is_read_is_whole_and_holds_nothing_else() -> None:
    for key in FULL:
        rest = {name: value for name, value in FULL.items() if name != key}
        if key == "note":
            assert LEGS.validate_python(rest).note is None
            continue
        with pytest.raises(ValidationError, match=key):
            LEGS.validate_python(rest)
    with pytest.raises(ValidationError, match="odd"):
        LEGS.validate_python(FULL | {"odd": 1})
    with pytest.raises(ValidationError, match="finite"):
        LEGS.validate_python(FULL | {"start": math.nan})
    with pytest.raises(ValidationError, match="no larger than"):
        LEGS.validate_python(FULL | {"path": [[0.0, 1e12]]})


def test_what_was_measured_has_six_decimals() -> None:
    class Found(Measured):
        """Two numbers."""

        metres: Number
        count: Count

    assert Found(metres=1.23456789, count=3).model_dump() == {"metres": 1.234568, "count": 3}


@given(st.sets(st.integers(0, 60)))
def test_numbers_are_kept_as_runs(numbers: set[int]) -> None:
    ascending = tuple(sorted(numbers))
    runs = runs_of(ascending)
    assert [n for first, last in runs for n in range(first, last + 1)] == list(ascending)

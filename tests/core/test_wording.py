"""What a validation finds is told in our words, whatever pydantic calls it."""

import re
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from specmap_cli.core.text import first_finding

_THEIRS = re.compile(r"Input|Field required|Value error|valid |unable|permitted|instance|should")


class _Inner(BaseModel):
    name: str


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid")

    share: float = Field(0.5, ge=0.1, lt=1)
    count: int = Field(1, gt=0, le=9)
    limit: float = Field(1.0, allow_inf_nan=False)
    on: bool = False
    kind: Literal["room", "hall"] = "room"
    pair: tuple[int, int] = (0, 1)
    many: Annotated[list[_Inner], Field(min_length=1, max_length=2)] = [_Inner(name="a")]
    code: str = Field("a", pattern="^[a-z]$")

    @field_validator("limit")
    @classmethod
    def _even(cls, value: float) -> float:
        if value == 7.0:
            raise ValueError("seven is taken")
        return value


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"share": 0.0}, "share: must be 0.1 or more"),
        ({"share": 1}, "share: must be less than 1"),
        ({"share": "much"}, "share: must be a number"),
        ({"share": []}, "share: must be a number"),
        ({"count": 0}, "count: must be more than 0"),
        ({"count": 10}, "count: must be 9 or less"),
        ({"count": 1.5}, "count: must be a whole number"),
        ({"count": "1e"}, "count: must be a whole number"),
        ({"count": None}, "count: must be a whole number"),
        ({"limit": float("nan")}, "limit: must be a finite number"),
        ({"limit": 7.0}, "limit: seven is taken"),
        ({"on": "perhaps"}, "on: must be true or false"),
        ({"on": {}}, "on: must be true or false"),
        ({"kind": "cellar"}, "kind: must be 'room' or 'hall'"),
        ({"pair": 3}, "pair: must be a list"),
        ({"pair": [1]}, "pair.1: is missing"),
        ({"pair": [1, 2, 3]}, "pair: must have 2 entries or fewer"),
        ({"many": []}, "many: must have 1 entries or more"),
        ({"many": {}}, "many: must be a list"),
        ({"many": [{}]}, "many.0.name: is missing"),
        ({"many": [{"name": 3}]}, "many.0.name: must be text"),
        ({"many": ["x"]}, "many.0: must be a table"),
        ({"code": "A"}, "code: must fit the pattern ^[a-z]$"),
        ({"cuont": 1}, "cuont: is unknown"),
        ({"x" * 99: 1}, "x" * 60 + ": is unknown"),
    ],
)
def test_each_finding_has_our_words(values: dict[str, Any], told: str) -> None:
    with pytest.raises(ValidationError) as caught:
        _Model.model_validate(values)
    said = first_finding(caught.value)
    assert said == told
    assert not _THEIRS.search(said)


def test_a_finding_of_the_whole_has_no_key() -> None:
    with pytest.raises(ValidationError) as caught:
        _Model.model_validate(3)
    assert first_finding(caught.value) == "must be a table"

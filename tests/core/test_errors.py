"""The error tree, as its docstring draws it."""

from __future__ import annotations

import inspect
import re

import pytest

from specmap_cli.core import errors


def tree() -> dict[str, type[errors.SpecmapError]]:
    return {
        name: kind
        for name, kind in inspect.getmembers(errors, inspect.isclass)
        if issubclass(kind, errors.SpecmapError)
    }


def test_every_error_is_drawn_and_has_an_honest_exit_code() -> None:
    assert errors.__doc__ is not None
    drawn = re.findall(r"(\w+Error)\b(?: +(\d))?", errors.__doc__)
    codes = {name: int(code) for name, code in drawn if code}
    assert {name for name, _ in drawn} >= set(tree())
    for name, code in codes.items():
        assert tree()[name].exit_code == code
    for name, kind in tree().items():
        assert kind.exit_code in {1, 2, 3, 4}, name


@pytest.mark.parametrize("kind", [errors.LogError, errors.MapError])
def test_what_cannot_be_read_is_an_input_error(kind: type[errors.SpecmapError]) -> None:
    assert issubclass(kind, errors.InputError)
    assert kind("log.mcap: empty").exit_code == 3

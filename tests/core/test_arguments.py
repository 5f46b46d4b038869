"""Arguments of the wrong type are told at once, by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from specmap_cli.core.arguments import instance_of, path_of, paths_of


@pytest.mark.parametrize("value", ["a/b", Path("a/b")])
def test_a_path_may_be_text(value: str | Path) -> None:
    assert path_of(value, "out") == Path("a/b")
    assert paths_of(value, "logs") == [Path("a/b")]
    assert paths_of([value, "c"], "logs") == [Path("a/b"), Path("c")]
    assert paths_of((), "logs") == []


@pytest.mark.parametrize("value", [None, 3, 2.5, b"bytes", {"a": 1}, {"a"}, object()])
def test_what_is_no_path_is_named(value: Any) -> None:
    with pytest.raises(TypeError, match=r"^out: expected a path \(str or Path\), found "):
        path_of(value, "out")
    with pytest.raises(TypeError, match=r"^logs: expected a path"):
        paths_of(value, "logs")


def test_one_wrong_path_among_several_is_refused() -> None:
    with pytest.raises(TypeError, match=r"^logs: expected a path \(str or Path\), found 7$"):
        paths_of(["a", 7], "logs")


def test_an_instance_is_handed_back_and_anything_else_is_refused() -> None:
    assert instance_of(3, int, "count") == 3
    with pytest.raises(TypeError, match=r"^count: expected int, found 'three'$"):
        instance_of("three", int, "count")


def test_a_long_value_is_cut_in_the_message() -> None:
    with pytest.raises(TypeError) as caught:
        path_of(list(range(1000)), "out")
    assert len(str(caught.value)) < 120

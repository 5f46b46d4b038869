"""What other packages add is found by their entry points; what is wrong with it is one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.plugins import with_plugins
from tests.plugins import install

GROUP = "specmap.test"


def test_without_plugins_the_table_is_the_built_in_one() -> None:
    assert with_plugins(GROUP, {"a": 1}) == {"a": 1}


def test_plugins_follow_the_built_in_ones_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, GROUP, {"z": "Z", "b": "B"}, "Z, B = 26, 2")
    assert list(with_plugins(GROUP, {"m": 13}).items()) == [("m", 13), ("b", 2), ("z", 26)]


def test_a_name_taken_twice_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, GROUP, {"a": "A"}, "A = 1")
    with pytest.raises(UsageError, match=r"^package stranger_\d+: offers 'a' in specmap\.test"):
        with_plugins(GROUP, {"a": 0})


@pytest.mark.parametrize(
    ("code", "words"),
    [("1 / 0", "ZeroDivisionError"), ("", "AttributeError"), ("import no_such", "no_such")],
)
def test_a_plugin_that_cannot_be_loaded_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, words: str
) -> None:
    install(tmp_path, monkeypatch, GROUP, {"new": "New"}, code)
    with pytest.raises(UsageError, match=words) as caught:
        with_plugins(GROUP, {})
    assert "\n" not in str(caught.value)
    assert "mend or remove the package" in str(caught.value)

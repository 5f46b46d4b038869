"""What other packages add is found by their entry points; what is wrong with it is one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.plugins import with_plugins
from tests.plugins import install

GROUP = "specmap.test"


def test_plugins_follow_the_built_in_ones_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert with_plugins(GROUP, {"m": 13}) == {"m": 13}, "there is none"
    install(tmp_path, monkeypatch, GROUP, {"z": "Z", "b": "B"}, "Z, B = 26, 2")
    assert list(with_plugins(GROUP, {"m": 13}).items()) == [("m", 13), ("b", 2), ("z", 26)]


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("taken", "New = 1", r"^package stranger_\d+: offers 'taken' in specmap\.test"),
        ("new", "1 / 0", "ZeroDivisionError.*mend or remove the package"),
        ("new", "", "AttributeError.*mend or remove the package"),
        ("new", "import no_such", "no_such.*mend or remove the package"),
    ],
)
def test_a_plugin_that_cannot_be_taken_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: str, words: str
) -> None:
    install(tmp_path, monkeypatch, GROUP, {name: "New"}, code)
    with pytest.raises(UsageError, match=words) as caught:
        with_plugins(GROUP, {"taken": 0})
    assert "\n" not in str(caught.value)

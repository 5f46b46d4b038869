"""Two commands on one map at the same time: `python -m fuzz.pairs` tries hundreds of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz.pairs import Bench, try_pair
from tests.flats import Mapped


@pytest.mark.parametrize("kinds", [("edit", "property"), ("update", "edit"), ("report", "edit")])
def test_two_commands_on_one_map_lose_nothing(
    kinds: tuple[str, str], first_tour: Mapped, second_tour: Mapped, tmp_path: Path
) -> None:
    faults, ends = try_pair(Bench(first_tour.map, second_tour.log.log, tmp_path), kinds, 0.5)
    assert faults == []
    assert 0 in ends


def test_a_lost_name_is_noticed(
    first_tour: Mapped, second_tour: Mapped, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As it was lost when commands did not look whether the map had changed meanwhile."""
    bench = Bench(first_tour.map, second_tour.log.log, tmp_path)
    monkeypatch.setattr(Bench, "command", lambda *_: ["check", str(tmp_path / "map")])
    faults, ends = try_pair(bench, ("edit", "check"), 0.0)
    assert ends == [0, 0]
    assert faults == ["lost: the name Kitchen"]

"""What became of borders: shares of floor that both maps saw, and who has the rest."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.topology.identity import border_changes
from specmap_cli.topology.regions import NOBODY, Regions


def divided(*rows: str, seen: int = 60) -> Regions:
    """Cells of a metre, ten of them a letter: a and b are submaps 0 and 1, a dot is nobody's."""
    owner = np.array([[NOBODY if c == "." else ord(c) - ord("a") for c in row] for row in rows])
    owner = np.kron(owner, np.ones((10, 10), dtype=np.int64))
    cells = np.where(np.arange(owner.shape[1]) < seen, FREE, UNKNOWN)
    cells = np.broadcast_to(cells, owner.shape).astype(np.uint8)
    return Regions.of(GridMap(np.ascontiguousarray(cells), 1.0), np.where(cells == FREE, owner, -1))


def test_the_same_map_has_the_same_borders() -> None:
    whole = divided("aab", ".bb")
    for change, m2 in zip(border_changes(whole, whole), (200.0, 300.0), strict=True):
        assert (change.iou, change.was_m2) == (1.0, m2)
        assert not change.given
        assert not change.taken


def test_what_went_to_others_and_came_from_them_is_told() -> None:
    first, second = border_changes(divided("aaab", "..bb"), divided("aacb", "aabb"))
    assert first.iou == pytest.approx(2 / 5)
    assert dict(first.given) == {2: 100.0}
    assert dict(first.taken) == {NOBODY: 200.0}
    assert (second.iou, dict(second.given), dict(second.taken)) == (1.0, {}, {})


def test_floor_that_only_one_map_saw_does_not_count() -> None:
    (change,) = border_changes(divided("aa"), divided("aa", seen=10))
    assert (change.iou, change.was_m2) == (1.0, 100.0)


def test_a_submap_without_a_cell_left_is_told() -> None:
    first, _ = border_changes(divided("ab"), divided("bb"))
    assert (first.submap, first.iou, dict(first.given)) == (0, 0.0, {1: 100.0})

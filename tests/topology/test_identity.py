"""Which submap is which, and what became of borders: counted over what both maps saw."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.identity import Divided, Identity, United, border_changes, identify
from specmap_cli.topology.regions import NOBODY, Regions

CELL_M = 0.1


def regions(picture: str) -> Regions:
    """A metre a letter: a digit owns its floor, `#` is wall, `.` floor of nobody, else unknown."""
    rows = picture.split()[::-1]
    owner = np.array([[int(c) if c.isdigit() else NOBODY for c in row] for row in rows])
    states = {"#": OCCUPIED, " ": UNKNOWN, "?": UNKNOWN}
    cells = np.array([[states.get(c, FREE) for c in row] for row in rows], dtype=np.uint8)
    return Regions.of(GridMap(_finer(cells), CELL_M), _finer(owner))


def _finer(cells: NDArray[Any]) -> NDArray[Any]:
    side = round(1.0 / CELL_M)
    return np.kron(cells, np.ones((side, side), dtype=cells.dtype))


HOUSE = """
#########
#000#111#
#000#111#
#2222222#
#########
"""


NOTHING: dict[str, Any] = {
    each.name: () for each in dataclasses.fields(Identity) if each.name != "same"
}


def same_of(identity: Identity) -> dict[int, int]:
    return {pair.old: pair.new for pair in identity.same}


def test_a_map_is_the_same_as_itself() -> None:
    found = identify(regions(HOUSE), regions(HOUSE), IDENTITY)
    assert same_of(found) == {0: 0, 1: 1, 2: 2}
    assert all(pair.iou == pytest.approx(1.0) for pair in found.same)
    assert found == Identity(same=found.same, **NOTHING)


def test_other_numbers_and_borders_a_little_elsewhere() -> None:
    new = regions("#########\n#777#333#\n#777#335#\n#5555555#\n#########")
    found = identify(regions(HOUSE), new, IDENTITY)
    assert same_of(found) == {0: 7, 1: 3, 2: 5}
    assert {pair.old: round(pair.iou, 2) for pair in found.same} == {0: 1.0, 1: 0.83, 2: 0.87}


def test_a_split_submap_keeps_its_id_in_the_larger_part_as_does_a_merged_one() -> None:
    split = regions("#########\n#000#111#\n#000#111#\n#2222233#\n#########")
    found = identify(regions(HOUSE), split, IDENTITY)
    assert same_of(found) == {0: 0, 1: 1, 2: 2}
    assert found == Identity(same=found.same, **NOTHING | {"split": (Divided(old=2, new=(2, 3)),)})
    merged = regions("#########\n#000#111#\n#000#111#\n#1111111#\n#########")
    found = identify(regions(HOUSE), merged, IDENTITY)
    assert same_of(found) == {0: 0, 2: 1}
    assert found == Identity(same=found.same, **NOTHING | {"merged": (United(old=(1, 2), new=1),)})


def test_what_only_one_map_saw_is_new_or_unseen_and_a_filled_room_is_gone() -> None:
    new = regions("??#####???? ??#777#???? ??#777#???? 666######## 666########")
    # the corridor is walled up, room 1 was not visited, 6 is space that the old map never saw
    found = identify(regions(HOUSE), new, Pose2(-2.0, 0.0, 0.0))
    assert same_of(found) == {0: 7}
    assert (found.new, found.unseen, found.gone) == ((6,), (1,), (2,))


def test_borders_drawn_all_anew_and_maps_without_a_cell_in_common() -> None:
    old = regions("########\n#000111#\n#000111#\n########")
    new = regions("########\n#222222#\n#333333#\n########")
    found = identify(old, new, IDENTITY)
    assert not found.same
    assert (found.redrawn_old, found.redrawn_new) == ((0, 1), (2, 3))
    found = identify(regions(HOUSE), regions(HOUSE), Pose2(100.0, 0.0, 0.0))
    assert not found.same
    assert found.new == found.unseen == (0, 1, 2)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-math.pi, math.pi, exclude_max=True))
def test_the_frame_of_the_new_map_does_not_matter(x: float, y: float, turn: float) -> None:
    old_from_new = Pose2(x, y, turn)
    old = regions(HOUSE)
    side = 200
    cells = np.argwhere(np.ones((side, side), dtype=bool))
    canvas = GridMap(np.full((side, side), UNKNOWN, dtype=np.uint8), CELL_M, (-10.0, -10.0))
    places = old_from_new.apply(canvas.centres_of(cells))
    inside = old.grid.inside(old.grid.cells_of(places))
    owner = np.full((side, side), NOBODY)
    rows, columns = old.grid.cells_of(places[inside]).T
    owner.reshape(-1)[inside] = old.owner[rows, columns]
    canvas.cells.reshape(-1)[:] = old.grid.values_at(places)
    found = identify(old, Regions.of(canvas, owner), old_from_new)
    whole = {
        i
        for i in (0, 1, 2)
        if np.count_nonzero(owner == i) > 0.98 * np.count_nonzero(old.owner == i)
    }
    assert {i: i for i in whole}.items() <= same_of(found).items()
    assert all(pair.iou > 0.8 for pair in found.same if pair.old in whole)


def test_what_went_to_others_and_came_from_them_is_told() -> None:
    first, second = border_changes(regions("0001 ..11"), regions("0021 0011"))
    assert first.iou == pytest.approx(2 / 5)
    assert dict(first.given) == {2: 1.0}
    assert dict(first.taken) == {NOBODY: 2.0}
    assert (second.iou, dict(second.given), dict(second.taken)) == (1.0, {}, {})
    first, _ = border_changes(regions("01"), regions("11"))
    assert (first.submap, first.iou, dict(first.given)) == (0, 0.0, {1: 1.0}), "no cell left"


def test_the_same_map_has_the_same_borders_and_floor_that_only_one_saw_does_not_count() -> None:
    whole = regions("001 .11")
    for change, m2 in zip(border_changes(whole, whole), (2.0, 3.0), strict=True):
        assert (change.iou, change.was_m2) == pytest.approx((1.0, m2))
        assert not change.given
        assert not change.taken
    (change,) = border_changes(regions("00"), regions("0?"))
    assert (change.iou, change.was_m2) == pytest.approx((1.0, 1.0))

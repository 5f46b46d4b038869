"""What differs between two maps where both saw, which submap is which, and moved borders."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.core.geometry import IDENTITY, BentMotion, FloatArray, Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.differences import Differences, Surveyed, differences, obstacles_in
from specmap_cli.topology.identity import Divided, Identity, United, border_changes, identify
from specmap_cli.topology.regions import NOBODY, Regions
from tests.topology.rooms import CELL_M, regions_of

RIGID = BentMotion(IDENTITY)
TRACK = np.array([[x, 3.0] for x in np.arange(1.0, 9.5, 0.5)])


def flat(door: bool = True) -> Regions:
    """Two rooms of 4.7 m x 5.6 m side by side, with a door of 0.9 m or a wall between them."""
    doors = [(4.9, 2.9, 5.1, 3.8)] if door else []
    return regions_of((10.0, 6.0), {0: [(0.2, 0.2, 4.9, 5.8), *doors], 1: [(5.1, 0.2, 9.8, 5.8)]})


def drawn(regions: Regions, *boxes: tuple[slice, slice], state: int = OCCUPIED) -> Regions:
    cells, owner = regions.grid.cells.copy(), regions.owner.copy()
    for box in boxes:
        cells[box] = state
        owner[box] = 0 if state == FREE else NOBODY
    return Regions.of(GridMap(cells, CELL_M, regions.grid.origin), owner)


def changes(found: Differences) -> int:
    """How many differences of the building there are, whatever became of the submaps."""
    parts = found.closed, found.opened, found.appeared, found.vanished
    return sum(map(len, parts)) + len(found.identity.gone)


def told(old: Regions, new: Regions, track: FloatArray = TRACK) -> Differences:
    return differences(old, new, (TRACK, track), RIGID)


CABINET = (slice(20, 28), slice(50, 66))  # 0.8 m x 0.4 m


HALF_SEEN = drawn(drawn(flat(), CABINET), (slice(0, 120), slice(0, 100)), state=UNKNOWN)
UNCHANGED = {
    "itself": flat(),
    "flicker of single cells": drawn(
        flat(), *((slice(k, k + 1), slice(3 * k, 3 * k + 1)) for k in range(20, 32, 5))
    ),
    "a cabinet where one map saw nothing": HALF_SEEN,
    "a door not seen again": drawn(flat(), (slice(0, 120), slice(80, 200)), state=UNKNOWN),
} | {
    f"walls drawn {5 * cells} cm elsewhere": drawn(
        flat(), (slice(4, 4 + cells), slice(4, 98)), (slice(4, 116), slice(4, 4 + cells))
    )
    for cells in (1, 2, 3)
}


@pytest.mark.parametrize("new", UNCHANGED.values(), ids=UNCHANGED.keys())
def test_what_is_no_change(new: Regions) -> None:
    assert changes(told(flat(), new)) == 0


def test_a_cabinet_appears_and_vanishes_and_a_moved_one_does_both() -> None:
    appeared = told(flat(), drawn(flat(), CABINET)).appeared
    assert len(appeared) == 1
    assert appeared[0].place == pytest.approx([2.9, 1.2], abs=0.05)
    assert appeared[0].length_m == pytest.approx(0.8, abs=0.1)
    assert appeared[0].width_m == pytest.approx(0.4, abs=0.1)
    assert (appeared[0].old_submap, appeared[0].new_submap) == (0, 0)
    vanished = told(drawn(flat(), CABINET), flat()).vanished
    assert vanished[0].place == pytest.approx(appeared[0].place)
    elsewhere = (slice(90, 98), slice(150, 166))
    found = told(drawn(flat(), CABINET), drawn(flat(), elsewhere))
    assert (len(found.appeared), len(found.vanished), changes(found)) == (1, 1, 2)
    assert found.appeared[0].old_submap == 1


def test_what_was_seen_from_afar_or_by_one_map_only_is_not_judged() -> None:
    assert changes(told(drawn(flat(), CABINET), flat(), TRACK[TRACK[:, 0] > 8.5])) == 0
    assert len(told(drawn(flat(), CABINET), flat(), TRACK).vanished) == 1
    assert changes(told(HALF_SEEN, flat())) == 0
    seen = Surveyed(flat().grid, np.zeros((0, 3)))
    assert obstacles_in(drawn(flat(), CABINET).grid, seen, RIGID) == []


def test_a_closed_door_is_a_way_and_no_obstacle() -> None:
    shut = drawn(flat(), (slice(58, 76), slice(99, 101)))
    found = told(flat(), shut)
    assert [way.between for way in found.closed] == [(0, 1)]
    assert found.closed[0].width_m == pytest.approx(0.9, abs=0.1)
    assert found.closed[0].place == pytest.approx([5.0, 3.35], abs=0.5)
    assert not found.appeared
    assert not found.opened
    back = told(shut, flat())
    assert [way.between for way in back.opened] == [(0, 1)]
    assert not back.vanished
    # closed before the room behind it was seen, it is told from one side
    room, rim = (slice(0, 120), slice(102, 200)), (slice(58, 76), slice(101, 102))
    new = drawn(drawn(shut, room, state=UNKNOWN), rim, state=UNKNOWN)
    assert [way.between for way in told(flat(), new).closed] == [(0, 1)]


def test_a_way_cut_through_a_wall_is_opened_and_half_a_door_is_not_closed() -> None:
    found = told(flat(door=False), flat())
    assert [way.between for way in found.opened] == [(0, 1)]
    assert changes(found) == 1
    found = told(flat(), drawn(flat(), (slice(58, 66), slice(96, 104))))
    assert not found.closed
    assert len(found.appeared) == 1


COARSE_M = 0.1


def pictured(picture: str) -> Regions:
    """A metre a letter: a digit owns its floor, `#` is wall, `.` floor of nobody, else unknown."""
    rows = picture.split()[::-1]
    owner = np.array([[int(c) if c.isdigit() else NOBODY for c in row] for row in rows])
    states = {"#": OCCUPIED, " ": UNKNOWN, "?": UNKNOWN}
    cells = np.array([[states.get(c, FREE) for c in row] for row in rows], dtype=np.uint8)
    return Regions.of(GridMap(_finer(cells), COARSE_M), _finer(owner))


def _finer(cells: NDArray[Any]) -> NDArray[Any]:
    side = round(1.0 / COARSE_M)
    return np.kron(cells, np.ones((side, side), dtype=cells.dtype))


HOUSE = "#########\n#000#111#\n#000#111#\n#2222222#\n#########"
SPLIT = "#########\n#000#111#\n#000#111#\n#2222233#\n#########"
MERGED = "#########\n#000#111#\n#000#111#\n#1111111#\n#########"
NOTHING: dict[str, Any] = {each.name: () for each in fields(Identity) if each.name != "same"}


def same_of(identity: Identity) -> dict[int, int]:
    return {pair.old: pair.new for pair in identity.same}


@pytest.mark.parametrize(
    ("new", "same", "ious", "changed"),
    [
        (HOUSE, {0: 0, 1: 1, 2: 2}, [1.0, 1.0, 1.0], {}),
        (SPLIT, {0: 0, 1: 1, 2: 2}, [1.0, 1.0, 5 / 7], {"split": (Divided(old=2, new=(2, 3)),)}),
        (MERGED, {0: 0, 2: 1}, [1.0, 7 / 13], {"merged": (United(old=(1, 2), new=1),)}),
    ],
    ids=["itself", "split", "merged"],
)
def test_a_split_or_merged_submap_keeps_its_id_in_the_larger_part(
    new: str, same: dict[int, int], ious: list[float], changed: dict[str, Any]
) -> None:
    found = identify(pictured(HOUSE), pictured(new), IDENTITY)
    assert same_of(found) == same
    assert [pair.iou for pair in found.same] == pytest.approx(ious)
    assert found == Identity(same=found.same, **NOTHING | changed)


def test_what_only_one_map_saw_is_new_or_unseen_and_a_filled_room_is_gone() -> None:
    new = pictured("??#####???? ??#777#???? ??#777#???? 666######## 666########")
    # the corridor is walled up, room 1 was not visited, 6 is space that the old map never saw
    found = identify(pictured(HOUSE), new, Pose2(-2.0, 0.0, 0.0))
    assert same_of(found) == {0: 7}
    assert (found.new, found.unseen, found.gone) == ((6,), (1,), (2,))


def test_borders_drawn_all_anew_and_maps_without_a_cell_in_common() -> None:
    old = pictured("########\n#000111#\n#000111#\n########")
    new = pictured("########\n#222222#\n#333333#\n########")
    found = identify(old, new, IDENTITY)
    assert not found.same
    assert (found.redrawn_old, found.redrawn_new) == ((0, 1), (2, 3))
    found = identify(pictured(HOUSE), pictured(HOUSE), Pose2(100.0, 0.0, 0.0))
    assert not found.same
    assert found.new == found.unseen == (0, 1, 2)


def test_what_went_to_others_and_came_from_them_is_told_of_floor_that_both_saw() -> None:
    first, second = border_changes(pictured("0001 ..11"), pictured("0021 0011"))
    assert first.iou == pytest.approx(2 / 5)
    assert dict(first.given) == {2: 1.0}
    assert dict(first.taken) == {NOBODY: 2.0}
    assert (second.iou, dict(second.given), dict(second.taken)) == (1.0, {}, {})
    first, _ = border_changes(pictured("01"), pictured("11"))
    assert (first.submap, first.iou, dict(first.given)) == (0, 0.0, {1: 1.0}), "no cell left"
    whole = pictured("001 .11")
    for change, m2 in zip(border_changes(whole, whole), (2.0, 3.0), strict=True):
        assert (change.iou, change.was_m2) == pytest.approx((1.0, m2))
        assert not change.given
        assert not change.taken
    (change,) = border_changes(pictured("00"), pictured("0?"))
    assert (change.iou, change.was_m2) == pytest.approx((1.0, 1.0))

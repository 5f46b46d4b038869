"""What differs between two maps in one frame, judged where both saw."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.grids.bent import BentMotion
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.differences import Differences, Surveyed, differences, obstacles_in
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
    assert appeared[0].centre == pytest.approx([2.9, 1.2], abs=0.05)
    assert appeared[0].length_m == pytest.approx(0.8, abs=0.1)
    assert appeared[0].width_m == pytest.approx(0.4, abs=0.1)
    assert (appeared[0].old_submap, appeared[0].new_submap) == (0, 0)
    vanished = told(drawn(flat(), CABINET), flat()).vanished
    assert vanished[0].centre == pytest.approx(appeared[0].centre)
    elsewhere = (slice(90, 98), slice(150, 166))
    found = told(drawn(flat(), CABINET), drawn(flat(), elsewhere))
    assert (len(found.appeared), len(found.vanished), changes(found)) == (1, 1, 2)
    assert found.appeared[0].old_submap == 1


def test_what_was_seen_from_afar_or_by_one_map_only_is_not_judged() -> None:
    far = TRACK[TRACK[:, 0] > 8.5]
    assert changes(told(drawn(flat(), CABINET), flat(), far)) == 0
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


def test_places_of_the_new_map_are_told_in_the_frame_of_the_old_one() -> None:
    new = drawn(flat(), CABINET)
    shifted = Regions(GridMap(new.grid.cells, CELL_M, (7.0, -2.0)), new.owner, new.outlines)
    old_from_new = BentMotion(Pose2(-7.0, 2.0, 0.0))
    found = differences(flat(), shifted, (TRACK, TRACK + (7.0, -2.0)), old_from_new)
    assert found.appeared[0].centre == pytest.approx([2.9, 1.2], abs=0.05)
    assert found.appeared[0].corners.mean(axis=0) == pytest.approx([2.9, 1.2], abs=0.05)

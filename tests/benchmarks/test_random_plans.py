"""Floor plans drawn at random: rooms that hang together, and what a division of them scores."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.making.buildings import BUILDINGS
from benchmarks.simulated.plans import joined_rooms, random_plan
from benchmarks.simulated.tours import robot

COUNT = 12


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_every_room_is_free_painted_and_within_reach(kind: str) -> None:
    for plan in (random_plan(kind, number, furnished=False) for number in range(COUNT)):
        assert len(plan.rooms) > 2
        assert set(np.unique(plan.labels)) == {-1, *range(len(plan.rooms))}
        assert plan.free[plan.labels >= 0].all()
        assert ndimage.label(plan.free)[1] == 1


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_furniture_changes_no_room_and_shuts_nothing_off(kind: str) -> None:
    for number in range(3):
        bare, full = (random_plan(kind, number, furnished) for furnished in (False, True))
        assert np.array_equal(bare.labels, full.labels)
        assert (full.free <= bare.free).all()
        assert 0.7 < full.free.sum() / bare.free.sum() < 1.0
        inner = (ndimage.binary_erosion(plan.free, iterations=5) for plan in (bare, full))
        assert len({ndimage.label(free)[1] for free in inner}) == 1


def test_rooms_that_share_a_region_are_counted() -> None:
    rooms = np.repeat(np.arange(4, dtype=np.int32), 5)[None]
    assert joined_rooms(rooms, rooms) == 0
    assert joined_rooms(rooms, np.repeat(np.array([0, 1, 1, 2], dtype=np.int32), 5)[None]) == 2


def test_a_plan_and_its_robot_are_the_same_by_their_number() -> None:
    one, again, other = (random_plan("flat", number, furnished=True) for number in (2, 2, 3))
    assert np.array_equal(one.free, again.free)
    assert one.free.shape != other.free.shape or not np.array_equal(one.free, other.free)
    robots, same, others = ([robot(k, n) for n in range(8)] for k in ("ring", "ring", "hall"))
    assert robots == same != others
    assert len({(o.field_of_view_deg, o.beams, o.range_max_m, o.noise_m) for o in robots}) > 5

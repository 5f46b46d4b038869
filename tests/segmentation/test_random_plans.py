"""Floor plans drawn at random: rooms that hang together, and what a division of them scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.random_plans.__main__ import Row, joined_rooms, line, plans
from benchmarks.random_plans.buildings import BUILDINGS
from benchmarks.random_plans.builds import Build, sensor
from specmap_cli.evaluation.scores import RoomScores

COUNT = 12


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_every_room_is_free_painted_and_within_reach(kind: str) -> None:
    for plan in plans(kind, range(COUNT), furnished=False):
        assert len(plan.rooms) > 2
        assert set(np.unique(plan.labels)) == {-1, *range(len(plan.rooms))}
        assert plan.free[plan.labels >= 0].all()
        assert ndimage.label(plan.free)[1] == 1


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_furniture_changes_no_room_and_shuts_nothing_off(kind: str) -> None:
    for bare, full in zip(plans(kind, range(3), False), plans(kind, range(3), True), strict=True):
        assert np.array_equal(bare.labels, full.labels)
        assert (full.free <= bare.free).all()
        assert 0.7 < full.free.sum() / bare.free.sum() < 1.0
        assert (
            ndimage.label(ndimage.binary_erosion(full.free, iterations=5))[1]
            == (ndimage.label(ndimage.binary_erosion(bare.free, iterations=5))[1])
        )


def test_rooms_that_share_a_region_are_counted() -> None:
    rooms = np.repeat(np.arange(4, dtype=np.int32), 5)[None]
    assert joined_rooms(rooms, rooms) == 0
    assert joined_rooms(rooms, np.repeat(np.array([0, 1, 1, 2], dtype=np.int32), 5)[None]) == 2


def test_a_line_has_the_means_and_the_sums() -> None:
    one = RoomScores(recall=1.0, precision=0.8, iou=0.9, segments_per_room=1.0)
    other = RoomScores(recall=0.5, precision=0.8, iou=0.7, segments_per_room=2.0)
    rows = [Row(one, 2, 10), Row(other, 0, 5)]
    assert line("flat", True, rows).split() == [
        *("flat", "yes", "0.750", "0.800", "0.800", "1.50", "2", "15", "0.700")
    ]


def test_a_plan_is_the_same_by_its_number() -> None:
    *_, last = plans("flat", range(3), furnished=True)
    (alone,) = plans("flat", [2], furnished=True)
    assert np.array_equal(last.free, alone.free)


def test_a_number_has_its_own_robot_and_every_fourth_no_odometry() -> None:
    robots = [sensor("ring", number) for number in range(8)]
    assert [measured for _, measured in robots] == [False, True, True, True] * 2
    assert robots == [sensor("ring", number) for number in range(8)]
    assert robots != [sensor("hall", number) for number in range(8)]
    assert len({(o.field_of_view_deg, o.beams, o.range_max_m, o.noise_m) for o, _ in robots}) > 5


def test_the_line_of_a_build_tells_how_its_log_was_measured() -> None:
    options, _ = sensor("flat", 5)
    build = Build(options, True, 6, 7, 0.99, "5/5", 0.0312, "good")
    assert f"x {options.odometry_drift:g}" in build.line("flat", 5)
    assert replace(build, measured=False).line("flat", 5).split()[4] == "none"
    assert build.line("flat", 5).endswith("0.990    5/5    0.031  good")

"""Borders that a person moved: made, undone, and never crossed by a region."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.records import IntArray, Labels
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.topology.redrawing import carried, redrawn, undone
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import BorderEdit, Merge, Split, fences_of, heirs

ACROSS = ((2.0, 1.9), (2.0, 0.1))  # seen along it, the left part of the hall is on its right


def hall() -> GridMap:
    """A hall of 4 m x 2 m and a room of 2 m x 2 m beside it, behind a wall with a door."""
    cells = np.full((22, 64), OCCUPIED, dtype=np.uint8)
    cells[1:21, 1:41] = FREE
    cells[1:21, 42:62] = FREE
    cells[8:14, 41] = FREE
    return GridMap(cells, 0.1, (-0.1, -0.1))


def driven() -> Labels:
    """Keyframes along the middle, from left to right: ten a metre, the hall is 0, the room 1."""
    x = np.arange(0.3, 5.9, 0.1)
    poses = np.column_stack([x, np.full(len(x), 1.0), np.zeros(len(x))])
    stamps = np.arange(len(x), dtype=np.int64)
    return Labels(stamps_ns=stamps, poses=poses, submaps=(x > 4.05).astype(np.int64))


def after(*wished: BorderEdit) -> tuple[IntArray, tuple[BorderEdit, ...]]:
    labels = driven()
    found = redrawn(hall(), labels, (), wished, 2)
    assert not found.skipped
    return found.submaps, found.borders


def test_a_merge_takes_all_keyframes_and_those_that_came_later_are_parted_by_the_nearest() -> None:
    labels = driven()
    submaps, borders = after(Merge((1, 0)))
    (merge,) = borders
    assert set(submaps.tolist()) == {1}
    assert isinstance(merge, Merge)
    assert merge.keyframes == tuple(np.flatnonzero(labels.submaps == 0).tolist())
    assert merge.known == len(submaps)
    poses = np.concatenate([labels.poses, [[1.0, 1.2, 0.0], [5.0, 0.8, 0.0]]])
    before = undone(np.append(submaps, [1, 1]), poses, borders)
    assert before[-2:].tolist() == [0, 1]
    (moved,) = carried(borders, labels.poses, poses[-2:])
    assert isinstance(moved, Merge)
    assert (moved.keyframes, moved.known) == ((0,), 2)


def test_a_split_gives_what_is_right_of_the_line_a_new_id() -> None:
    submaps, (split,) = after(Split(submap=0, line=ACROSS))
    x = driven().poses[:, 0]
    assert (submaps == 2).tolist() == (x < 2.0).tolist()
    assert isinstance(split, Split)
    assert split.new == 2
    assert split.fence is not None
    (_, top), (_, bottom) = split.fence
    assert top == pytest.approx(2.0, abs=0.11)
    assert bottom == pytest.approx(0.0, abs=0.11)
    turned, _ = after(Split(submap=0, line=ACROSS[::-1]))
    assert (turned == 2).tolist() == ((x > 2.0) & (x < 4.05)).tolist()


def test_no_region_crosses_the_fence() -> None:
    """The robot stood near the line on one side only: its region still ends there."""
    labels, whole = driven(), hall()
    kept = np.flatnonzero((labels.poses[:, 0] < 0.8) | (labels.poses[:, 0] > 2.2))
    seen = Labels(
        stamps_ns=labels.stamps_ns[kept], poses=labels.poses[kept], submaps=labels.submaps[kept]
    )
    found = redrawn(whole, seen, (), [Split(submap=0, line=ACROSS, new=5)], 2)
    divided = replace(seen, submaps=found.submaps)
    regions = divide(whole, divided, fences_of(found.borders))
    centres = whole.centres_of(np.argwhere(regions.owner == 5))
    assert centres[:, 0].max() == pytest.approx(2.0, abs=0.16)
    others = whole.centres_of(np.argwhere(regions.owner == 0))
    assert others[:, 0].min() == pytest.approx(2.0, abs=0.16)
    assert found.next_id == 6
    free = divide(whole, divided)
    assert whole.centres_of(np.argwhere(free.owner == 5))[:, 0].max() < 1.8


def test_a_line_through_one_leg_of_a_building_splits_on_foot() -> None:
    """Two corridors side by side, joined at one end: the line crosses one of them only."""
    cells = np.full((22, 42), OCCUPIED, dtype=np.uint8)
    cells[1:9, 1:41] = FREE
    cells[13:21, 1:41] = FREE
    cells[1:21, 33:41] = FREE
    whole = GridMap(cells, 0.1)
    x = np.arange(0.5, 3.6, 0.1)
    there = np.column_stack([x, np.full(len(x), 0.5), x * 0])
    back = np.column_stack([x[::-1], np.full(len(x), 1.7), x * 0])
    poses = np.concatenate([there, back])
    labels = Labels(
        stamps_ns=np.arange(len(poses)), poses=poses, submaps=np.zeros(len(poses), dtype=np.int64)
    )
    found = redrawn(whole, labels, (), [Split(submap=0, line=((2.0, 0.8), (2.0, 0.2)))], 1)
    assert np.flatnonzero(found.submaps == 1).tolist() == np.flatnonzero(there[:, 0] < 2).tolist()


def test_changes_are_made_in_order_and_undone() -> None:
    wished: list[BorderEdit] = [Split(submap=0, line=ACROSS, new=7), Merge((1, 0)), Merge((7, 1))]
    submaps, borders = after(*wished)
    assert set(submaps.tolist()) == {7}
    labels = driven()
    assert undone(submaps, labels.poses, borders).tolist() == labels.submaps.tolist()
    changed = replace(labels, submaps=submaps)
    fewer = redrawn(hall(), changed, borders, wished[:2], 8)
    assert set(fewer.submaps.tolist()) == {1, 7}
    same = redrawn(hall(), changed, borders, wished, 8)
    assert same.submaps.tolist() == submaps.tolist()
    assert same.borders == borders


def test_what_cannot_be_made_is_told_and_the_rest_made() -> None:
    wished: list[BorderEdit] = [
        Merge((0, 9)),
        Split(submap=9, line=ACROSS),
        Split(submap=0, line=((9.0, 9.0), (8.0, 8.0))),
        Split(submap=0, line=((0.05, 1.9), (0.05, 0.1))),
        Split(submap=0, line=ACROSS, new=1),
        Split(submap=0, line=ACROSS),
    ]
    found = redrawn(hall(), driven(), (), wished, 2)
    assert found.skipped == {
        0: "there is no submap 9",
        1: "there is no submap 9",
        2: "the line does not cross submap 0",
        3: "the robot was on one side of the line only in submap 0",
        4: "submap 1 exists already",
    }
    assert len(found.borders) == 1
    assert (found.submaps == 2).any()


def test_heirs_are_what_a_submap_became() -> None:
    borders: list[BorderEdit] = [Split(submap=5, line=ACROSS, new=7), Merge((3, 5)), Merge((2, 9))]
    assert heirs(5, borders) == {3, 7}
    assert heirs(3, borders) == {3}
    assert heirs(5, borders[1:]) == {3}

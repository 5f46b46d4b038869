"""A room that both maps only half understood is divided as a build of both divides it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray, Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.layout.result import Layout
from specmap_cli.pipelines.map_in_making import LaidOut
from specmap_cli.pipelines.thinning import Thinned
from specmap_cli.pipelines.update import redivided

CONFIG = Config()
SIDE_M = 4.1  # of a room and a wall


@pytest.fixture(scope="module")
def whole() -> GridMap:
    """Three rooms of 4 m x 4 m in a row, with doors 1 m wide, in cells of 0.1 m."""
    cells = np.full((44, 124), OCCUPIED, dtype=np.uint8)
    for k in range(3):
        cells[2:42, 41 * k + 1 : 41 * k + 41] = FREE
        cells[17:27, 41 * k : 41 * k + (k > 0)] = FREE
    return GridMap(cells, 0.1)


def way(start_m: float, end_m: float) -> FloatArray:
    """Poses every 0.1 m along the middle of the rooms."""
    x = np.arange(start_m, end_m, 0.1)
    return np.column_stack([x, np.full_like(x, 2.2), np.zeros_like(x)])


def kept(poses: FloatArray, submaps: IntArray, loose: tuple[int, ...] = ()) -> LaidOut:
    stamps = np.arange(len(poses), dtype=np.int64)
    return LaidOut(
        layout=Layout(poses=poses, loose=loose),
        labels=Labels(stamps_ns=stamps, poses=poses, submaps=submaps),
        trajectory=Trajectory(stamps_ns=stamps, poses=poses),
        stays={},
        closures=(),
        breaks={},
        logs=(),
        findings=(),
        next_id=5,
    )


def updated(whole: GridMap, loose: tuple[int, ...] = ()) -> tuple[LaidOut, IntArray]:
    """The map, and the room of each keyframe: the old robot left out the middle room."""
    first = np.concatenate([way(1.0, 3.5), way(9.5, 11.5)])
    second = way(1.5, 11.0)
    rooms = (np.concatenate([first, second])[:, 0] // SIDE_M).astype(np.int64)
    old = replace(kept(first, np.minimum(rooms[: len(first)], 1)), drawn=whole)
    provisional = np.concatenate([old.labels.submaps, np.zeros(len(second), dtype=np.int64)])
    joint = kept(np.concatenate([first, second]), provisional, loose)
    left = np.flatnonzero(np.arange(len(rooms)) % 7 != 3)  # some were let go
    labels = Labels(
        stamps_ns=left, poses=joint.layout.poses[left], submaps=joint.labels.submaps[left]
    )
    drawn = replace(joint, labels=labels, drawn=whole)
    fewer = Thinned(drawn, left, int((left < len(first)).sum()))
    return redivided(old, joint, fewer, CONFIG).laid, rooms[left]


def test_a_room_that_was_entered_is_a_submap_whoever_looked_into_it(whole: GridMap) -> None:
    map_, rooms = updated(whole)
    assert (map_.labels.submaps != np.array([0, 5, 1])[rooms]).sum() <= 4, "doors, either way"
    assert map_.next_id == 6


def test_where_a_part_lies_by_a_guess_nothing_is_divided_anew(whole: GridMap) -> None:
    map_, _ = updated(whole, loose=(40,))
    assert set(map_.labels.submaps.tolist()) == {0, 1}
    assert map_.next_id == 5

"""What two maps become in one: the edits of both, and rooms that both only half understood."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import IntArray, Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.layout.result import Layout
from specmap_cli.maps.edits import Change, Edits, ForbidEdit, MergeEdit, SplitEdit, SubmapEdit
from specmap_cli.pipelines.joining import with_edits_of
from specmap_cli.pipelines.laying_out import division_of
from specmap_cli.pipelines.map_in_making import LaidOut
from specmap_cli.pipelines.thinning import Thinned
from specmap_cli.pipelines.update import redivided
from specmap_cli.topology.regions import NOBODY
from specmap_cli.topology.topological_map import LogInfo

OWN = np.repeat([0, 1, 2, 3], 5)  # the submaps of the newer map's keyframes, a metre apart
POSES = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])


def laid_out(
    poses: FloatArray, submaps: IntArray, loose: tuple[int, ...] = (), edits: Edits | None = None
) -> LaidOut:
    """A map of one recording as far as it is laid out."""
    count = len(poses)
    stamps = np.arange(count, dtype=np.int64)
    log = LogInfo("new.mcap", start_ns=0, end_ns=count - 1, scans=count, keyframes=(0, count - 1))
    return LaidOut(
        layout=Layout(poses=poses, nodes=np.arange(count), loose=loose),
        labels=Labels(stamps_ns=stamps, poses=poses, submaps=submaps),
        trajectory=Trajectory(stamps_ns=stamps, poses=poses),
        stays={},
        closures=(),
        breaks={},
        logs=(log,),
        findings=(),
        next_id=9,
        edits=edits or Edits(),
    )


def kept(*changes: Change, submaps: dict[int, SubmapEdit] | None = None) -> LaidOut:
    return laid_out(POSES, OWN, edits=Edits(submaps=submaps or {}, changes=changes))


def both(
    new: LaidOut,
    became: Sequence[int] | IntArray,
    where: Pose2 = IDENTITY,
    *,
    submaps: dict[int, SubmapEdit] | None = None,
) -> LaidOut:
    """The joint map: `became` are the submaps of the new keyframes, or of five of them each.

    Of the older map's `submaps` something was said.
    """
    own = np.repeat(became, 20 // len(became))
    older = kept(submaps=submaps)
    joint = replace(older, labels=replace(older.labels, submaps=own), next_id=20)
    return with_edits_of(joint, new, where)


def test_changes_name_what_the_submaps_became() -> None:
    changes = (
        MergeEdit(merge=(0, 1)),
        SplitEdit(split=0, line=((2.0, -1.0), (2.0, 1.0)), new=8),
        ForbidEdit(forbid=(8, 2), at=(10.0, 0.0)),
        MergeEdit(merge=(8, 3)),
    )
    found = both(kept(*changes), [11, 12, 13, 14], Pose2(1.0, 2.0, math.pi / 2))
    assert found.edits.changes == (
        MergeEdit(merge=(11, 12)),
        SplitEdit(split=11, line=((2.0, 4.0), (0.0, 4.0)), new=20),
        ForbidEdit(forbid=(20, 13), at=(1.0, 12.0)),
        MergeEdit(merge=(20, 14)),
    )
    assert (found.next_id, found.lost) == (21, ())
    found = both(kept(MergeEdit(merge=(0, 1)), ForbidEdit(forbid=(0, 2))), [11, 11, 13, 14])
    assert found.edits.changes == (ForbidEdit(forbid=(11, 13)),), "they are one already"


@pytest.mark.parametrize(("x", "cut"), [(1.0, 11), (4.0, 12)])
def test_the_submap_at_the_line_is_cut(x: float, cut: int) -> None:
    new = kept(SplitEdit(split=0, line=((x, -1.0), (x, 1.0)), new=8))
    (change,) = both(new, np.array([11, 11, 11, 12, 12, *[13] * 15])).edits.changes
    assert isinstance(change, SplitEdit)
    assert change.split == cut


def test_what_says_nothing_of_the_joint_map_is_told() -> None:
    new = kept(
        MergeEdit(merge=(0, 7)),
        ForbidEdit(forbid=(7, 1)),
        submaps={0: SubmapEdit(name="Hall", kind="hall"), 7: SubmapEdit(name="Attic")},
    )
    earlier = {11: SubmapEdit(name="Lobby", properties={"floor": 2})}
    found = both(new, [11, 12, 13, 14], submaps=earlier)
    joined = SubmapEdit(name="Lobby", kind="hall", properties={"floor": 2})
    assert found.edits.submaps == {11: joined}
    assert found.lost == (
        "in the map of new.mcap: merge 7 into 0: there is no submap 7",
        "in the map of new.mcap: forbid the way between 7 and 1: there is no submap 7",
        "in the map of new.mcap: submaps.0: 'Hall' is 'Lobby' in an earlier map",
        "in the map of new.mcap: submaps.7: there is no submap 7",
    )


def test_a_submap_that_went_to_very_many_is_the_commonest_of_them() -> None:
    new = kept(ForbidEdit(forbid=(0, 1)))
    new = replace(new, labels=replace(new.labels, submaps=np.repeat([0, 1], [19, 1])))
    assert both(new, np.arange(30, 50)).edits.changes == (ForbidEdit(forbid=(30, 49)),)


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


def updated(
    whole: GridMap,
    loose: tuple[int, ...] = (),
    second: FloatArray = way(1.5, 11.0),
    known: GridMap | None = None,
) -> tuple[LaidOut, IntArray]:
    """The map, and the room of each keyframe: the old robot left out the middle room.

    It knew the whole map, or what is `known`.
    """
    first = np.concatenate([way(1.0, 3.5), way(9.5, 11.5)])
    rooms = (np.concatenate([first, second])[:, 0] // SIDE_M).astype(np.int64)
    old = replace(laid_out(first, np.minimum(rooms[: len(first)], 1)), drawn=known or whole)
    provisional = np.concatenate([old.labels.submaps, np.zeros(len(second), dtype=np.int64)])
    joint = laid_out(np.concatenate([first, second]), provisional, loose)
    left = np.flatnonzero(np.arange(len(rooms)) % 7 != 3)  # some were let go
    poses, submaps = joint.layout.poses[left], joint.labels.submaps[left]
    labels = Labels(stamps_ns=left, poses=poses, submaps=submaps)
    division = division_of(whole, joint.layout, Config())
    drawn = replace(joint, labels=labels, drawn=whole, division=division)
    fewer = Thinned(drawn, left, int((left < len(first)).sum()))
    return redivided(old, joint, fewer, Config()).laid, rooms[left]


def test_a_room_that_was_entered_is_a_submap_whoever_looked_into_it(whole: GridMap) -> None:
    map_, rooms = updated(whole)
    assert (map_.labels.submaps != np.array([0, 9, 1])[rooms]).sum() <= 4, "doors, either way"
    assert map_.next_id == 10


def test_a_room_that_nobody_entered_stays_a_part_of_the_submaps_that_had_most_of_it(
    whole: GridMap,
) -> None:
    middle = np.s_[2:42, 43:82]
    for had_columns, kept in ((82, True), (55, False)):  # all of it, and a third
        cells = whole.cells.copy()
        cells[:, had_columns:83] = UNKNOWN
        map_, _ = updated(whole, second=way(9.6, 11.4), known=GridMap(cells, whole.resolution))
        owner = map_.regions.owner[middle]
        assert bool((owner == NOBODY).all()) != kept
        assert bool(np.isin(owner, [0, 1]).all()) == kept


def test_where_a_part_lies_by_a_guess_nothing_is_divided_anew(whole: GridMap) -> None:
    map_, _ = updated(whole, loose=(40,))
    assert set(map_.labels.submaps.tolist()) == {0, 1}
    assert map_.next_id == 9


def test_where_recordings_lie_apart_a_room_nobody_entered_is_nobodys(whole: GridMap) -> None:
    joint = replace(laid_out(way(1.0, 7.0), np.zeros(60, dtype=np.int64), (40,)), drawn=whole)
    beyond = np.s_[2:42, 83:123]  # the last room
    for starts, seen_only in (((), False), ((40,), True)):
        division = division_of(whole, joint.layout, Config(), starts)
        owner = replace(joint, division=division).regions.owner[beyond]
        assert bool((owner == NOBODY).all()) == seen_only

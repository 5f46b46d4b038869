"""The edits of two maps said of the one that they become."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import IntArray, Labels, Trajectory
from specmap_cli.layout.result import Layout
from specmap_cli.maps.edits import Change, Edits, ForbidEdit, MergeEdit, SplitEdit, SubmapEdit
from specmap_cli.pipelines.joining import with_edits_of
from specmap_cli.pipelines.map_in_making import LaidOut
from specmap_cli.topology.topological_map import LogInfo

OWN = np.repeat([0, 1, 2, 3], 5)  # the submaps of the newer map's keyframes, a metre apart
POSES = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])


def kept(*changes: Change, submaps: dict[int, SubmapEdit] | None = None) -> LaidOut:
    stamps = np.arange(20, dtype=np.int64)
    return LaidOut(
        layout=Layout(poses=POSES, nodes=np.arange(20)),
        labels=Labels(stamps_ns=stamps, poses=POSES, submaps=OWN),
        trajectory=Trajectory(stamps_ns=stamps, poses=POSES),
        stays={},
        closures=(),
        breaks={},
        logs=(LogInfo(name="new.mcap", start_ns=0, end_ns=19, scans=20, keyframes=(0, 19)),),
        findings=(),
        next_id=9,
        edits=Edits(submaps=submaps or {}, changes=changes),
    )


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


def test_what_is_one_already_is_not_merged_again() -> None:
    changes = (MergeEdit(merge=(0, 1)), ForbidEdit(forbid=(0, 2)))
    found = both(kept(*changes), [11, 11, 13, 14])
    assert found.edits.changes == (ForbidEdit(forbid=(11, 13)),)


@pytest.mark.parametrize(("x", "cut"), [(1.0, 11), (4.0, 12)])
def test_the_submap_at_the_line_is_cut(x: float, cut: int) -> None:
    new = kept(SplitEdit(split=0, line=((x, -1.0), (x, 1.0)), new=8))
    spread = np.array([11, 11, 11, 12, 12, *[13] * 15])
    found = both(new, spread)
    (change,) = found.edits.changes
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
    assert found.edits.submaps == {
        11: SubmapEdit(name="Lobby", kind="hall", properties={"floor": 2})
    }
    assert found.lost == (
        "in the map of new.mcap: merge 7 into 0: there is no submap 7",
        "in the map of new.mcap: forbid the way between 7 and 1: there is no submap 7",
        "in the map of new.mcap: submaps.0: 'Hall' is 'Lobby' in an earlier map",
        "in the map of new.mcap: submaps.7: there is no submap 7",
    )


def test_a_submap_that_went_to_very_many_is_the_commonest_of_them() -> None:
    new = kept(ForbidEdit(forbid=(0, 1)))
    own = new.labels.submaps.copy()
    own[:] = np.repeat([0, 1], [19, 1])
    new = replace(new, labels=replace(new.labels, submaps=own))
    found = both(new, np.arange(30, 50))
    assert found.edits.changes == (ForbidEdit(forbid=(30, 49)),)

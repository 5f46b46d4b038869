"""Scans grouped into views: a robot that stands still sees one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.records import PosedScan
from specmap_cli.recognition.localization.filtering import ViewGrouping
from tests.recognition.localization.posed import at
from tests.turning import turn


@pytest.fixture(autouse=True)
def _views() -> None:
    turn("recognition", view_m=0.1, view_rad=0.2)


@pytest.mark.parametrize(
    ("scan", "begins"),
    [
        (at(0.0), False),
        (at(0.09), False),
        (at(0.11), True),
        (at(0.0, 0.19), False),
        (at(0.0, 0.21), True),
        (at(5.0, lost=True), False),
    ],
)
def test_a_view_begins_where_the_robot_moved(scan: PosedScan, begins: bool) -> None:
    views = ViewGrouping()
    assert views.begins(at(0.0))
    assert views.begins(scan) is begins


def test_slow_motion_adds_up() -> None:
    views = ViewGrouping()
    begun = [views.begins(at(0.03 * k)) for k in range(9)]
    assert begun == [True, False, False, False, True, False, False, False, True]


def test_the_first_scan_of_a_track_is_a_view_though_lost_or_unmoved() -> None:
    views = ViewGrouping()
    assert views.begins(at(0.0, lost=True))
    views.keep(np.zeros(2))
    views.restart()
    assert views.begins(at(0.0))


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=20))
def test_what_a_view_says_is_the_mean_of_its_scans(said: list[float]) -> None:
    views = ViewGrouping()
    views.begins(at(3.0))
    views.mean(np.array([1e6]))
    views.begins(at(4.0))
    for value in said:
        mean = views.mean(np.array([value, -value]))
    assert mean == pytest.approx([np.mean(said), -np.mean(said)], abs=1e-9)


def test_every_scan_gets_the_row_of_its_view() -> None:
    """Two tracks: one of two views, of three and one scans, and one of a single scan."""
    views = ViewGrouping()
    for number, x in enumerate((0.0, 0.01, 0.02, 1.0)):
        views.begins(at(x))
        views.keep(np.array([float(number)]))
    views.restart()
    views.begins(at(1.0))
    views.keep(np.array([4.0]))
    tracks = views.tracks()
    assert [track.tolist() for track in tracks] == [[[2.0], [3.0]], [[4.0]]]
    rows = [row for track in tracks for row in track]
    assert [row.tolist() for row in views.of_scans(rows)] == [[2.0]] * 3 + [[3.0], [4.0]]

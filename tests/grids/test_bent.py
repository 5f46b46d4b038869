"""A motion that is rigid, and a little off here and there."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.bent import BentMotion, LocalMotion

RIGID = Pose2(3.0, -1.0, 0.7)
POINTS = np.array([[0.0, 0.0], [5.0, 2.0], [-4.0, 8.0]])


def local(x: float, y: float, off_x: float) -> LocalMotion:
    motion = Pose2(RIGID.x + off_x, RIGID.y, RIGID.theta)
    return LocalMotion(np.array([x, y]), motion, 10.0)


def test_each_local_motion_rules_where_it_is_and_between_them_it_blends() -> None:
    bent = BentMotion(RIGID, (local(0.0, 0.0, 0.0), local(20.0, 0.0, 0.2)))
    places = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    off = bent.apply(places) - RIGID.apply(places)
    assert off[:, 0] == pytest.approx([0.0, 0.1, 0.2], abs=0.01)
    assert off[:, 1] == pytest.approx(0.0)
    assert bent.near(places[2]).x - RIGID.x == pytest.approx(off[2, 0])


def test_without_local_motions_it_is_rigid_and_with_them_it_leads_there_and_back() -> None:
    assert BentMotion(RIGID).apply(POINTS) == pytest.approx(RIGID.apply(POINTS))
    bent = BentMotion(RIGID, (local(0.0, 0.0, 0.0), local(8.0, 3.0, 0.15)))
    assert bent.apply(POINTS[:0]).shape == (0, 2)
    assert bent.inverse().apply(bent.apply(POINTS)) == pytest.approx(POINTS, abs=0.01)

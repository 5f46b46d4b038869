"""The pose within a submap: matched where a place leads, followed, and given only where it fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.localization.metric import Fix, MetricTracker
from specmap_cli.recognition.localization.places import Place
from tests.turning import turn


class Walk:
    """The first scans of a walk through a room, ten centimetres or so apart, and a tracker."""

    def __init__(self, building: Any) -> None:
        start, end = (Pose2(*pose) for pose in building.path(2, 3)[:2].tolist())
        way, shares = start.inverse() @ end, np.linspace(0.0, 1.0, 6).tolist()
        along = [start @ Pose2(way.x * t, way.y * t, 0.1 * t) for t in shares]
        self.scans: list[PosedScan] = building.posed(np.array(along))
        self.frames: dict[int, Pose2] = {room: building.frame(room) for room in (1, 2)}
        fields = {i: ScoreField.from_grid(building.visit(0, i).grid) for i in self.frames}
        self.tracker = MetricTracker(fields.__getitem__, self.frames)

    def place(self, scan: PosedScan, off: Pose2 = IDENTITY, room: int = 2) -> Place:
        """Where a scan is in a room's submap, and off by something."""
        pose = self.frames[room].inverse() @ scan.map_from_base @ off
        return Place(room, pose, scan.map_from_base)

    def locate(self, scan: PosedScan, place: Place) -> Fix | None:
        """The pose in the submap of the room."""
        return self.tracker.locate(scan, place, 2)

    def off_by(self, scan: PosedScan, place: Place, seen: PosedScan | None = None) -> Pose2:
        """What the pose of a scan, or of what is `seen` in its place, is off by."""
        fix = self.locate(scan if seen is None else seen, place)
        assert fix is not None
        assert fix.score > 0.8
        return self.place(scan, room=fix.submap).pose.inverse() @ fix.pose


@pytest.fixture
def walk(building: Any) -> Walk:
    return Walk(building)


def test_a_place_is_matched_and_then_followed(walk: Walk, building: Any) -> None:
    place = walk.place(walk.scans[0], Pose2(0.1, -0.1, 0.04))
    for scan in walk.scans:
        off = walk.off_by(scan, place)
        assert off.distance < 0.05
        assert abs(off.theta) < 0.01
    # a place of a later scan tells of an earlier one
    assert Walk(building).off_by(walk.scans[0], walk.place(walk.scans[-1])).distance < 0.05


def test_the_layout_says_where_a_place_is_in_another_submap(walk: Walk) -> None:
    scan = walk.scans[0]
    elsewhere = walk.place(scan, room=1)
    assert walk.off_by(scan, elsewhere).distance < 0.05
    walk.tracker.frames = {}
    assert walk.locate(scan, elsewhere) is None


def test_the_covariance_is_large_along_what_the_walls_do_not_tell(walk: Walk) -> None:
    """One straight wall ahead: across it the pose is known, along it only by the motion."""
    scan = walk.scans[0]
    ahead = np.abs(scan.planar.bearings) < 0.3
    ranges = np.where(ahead, 1.0 / np.cos(scan.planar.bearings), np.inf)
    wall = np.column_stack([np.ones(400), np.linspace(-4.0, 4.0, 400)])
    tracker = MetricTracker(lambda _: ScoreField.from_points(wall), {})
    seen = replace(scan, planar=replace(scan.planar, ranges=ranges), map_from_base=IDENTITY)
    fix = tracker.locate(seen, Place(0, IDENTITY, IDENTITY), 0)
    assert fix is not None
    assert fix.covariance[1, 1] > 4.0 * fix.covariance[0, 0]
    assert np.allclose(fix.covariance, fix.covariance.T)
    assert (np.linalg.eigvalsh(fix.covariance) > 0.0).all()


def test_a_slip_of_the_registration_is_followed(walk: Walk) -> None:
    place, right = walk.place(walk.scans[0]), walk.scans[3]
    for scan in walk.scans[:3]:
        walk.locate(scan, place)
    slipped = replace(right, map_from_base=right.map_from_base @ Pose2(0.15, 0.0, 0.05))
    assert walk.off_by(right, place, slipped).distance < 0.05


def test_another_place_is_not_drawn_to_the_one_that_was_followed(walk: Walk) -> None:
    first, second = walk.scans[:2]
    walk.locate(first, walk.place(first, Pose2(1.5, 0.5, 1.5)))
    assert walk.off_by(second, walk.place(second)).distance < 0.05


def test_after_a_restart_nothing_is_followed(walk: Walk) -> None:
    first, second = walk.scans[:2]
    walk.locate(first, walk.place(first))
    far = replace(second, map_from_base=Pose2(300.0, -80.0, 1.0), restarted=True)
    place = Place(2, walk.place(second).pose, far.map_from_base)
    assert walk.tracker.locate(replace(far, planar=first.planar), None, None) is None
    assert walk.off_by(second, place, far).distance < 0.05


def test_without_a_place_a_label_a_return_or_a_fit_there_is_no_pose(
    walk: Walk, building: Any
) -> None:
    scan, place = walk.scans[0], walk.place(walk.scans[0])
    blind = replace(scan, planar=building.scans(np.array([[1e6, 1e6, 0.0]]))[0])
    assert walk.tracker.locate(scan, None, 2) is None
    assert walk.tracker.locate(scan, place, None) is None
    assert walk.locate(replace(scan, lost=True), place) is None
    assert walk.locate(blind, place) is None
    assert walk.locate(scan, place) is not None
    turn("recognition", lost_score=1.0)
    assert walk.locate(scan, place) is None, "it fits no walls"

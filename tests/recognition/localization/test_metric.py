"""The pose within a submap: matched where a place leads, followed, and given only where it fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.localization.metric import Fix, MetricTracker
from specmap_cli.recognition.localization.places import Place
from tests.recognition.posed import posed
from tests.turning import turn

CONFIG = LocalizationConfig()
ROOMS = (1, 2)


def walk(building: Any, room: int, steps: int = 6) -> list[PosedScan]:
    """The first scans of a walk through a room, ten centimetres or so apart."""
    start, end = (Pose2(*building.path(room, 3)[k].tolist()) for k in (0, 1))
    way = start.inverse() @ end
    along = [
        start @ Pose2(way.x * t, way.y * t, 0.1 * t) for t in np.linspace(0.0, 1.0, steps).tolist()
    ]
    scans = building.scans(np.array(along))
    return [posed(s, p, k) for k, (p, s) in enumerate(zip(along, scans, strict=True))]


def frames_of(building: Any) -> dict[int, Pose2]:
    return {room: Pose2(*building.path(room, 0)[0].tolist()) for room in ROOMS}


def tracker_of(building: Any) -> MetricTracker:
    fields = {room: ScoreField.from_grid(building.visit(0, room).grid) for room in ROOMS}
    return MetricTracker(fields.__getitem__, frames_of(building))


def place_of(building: Any, room: int, scan: PosedScan, off: Pose2 = IDENTITY) -> Place:
    """Where a scan is in a room's submap, and off by something."""
    pose = frames_of(building)[room].inverse() @ scan.map_from_base @ off
    return Place(room, pose, scan.map_from_base)


def off_by(building: Any, scan: PosedScan, fix: Fix | None) -> Pose2:
    """What a pose is off by."""
    assert fix is not None
    return place_of(building, fix.submap, scan).pose.inverse() @ fix.pose


def test_a_place_is_matched_and_then_followed(building: Any) -> None:
    tracker = tracker_of(building)
    scans = walk(building, 2)
    place = place_of(building, 2, scans[0], Pose2(0.1, -0.1, 0.04))
    for scan in scans:
        fix = tracker.locate(scan, place, 2)
        off = off_by(building, scan, fix)
        assert off.distance < 0.05
        assert abs(off.theta) < 0.01
        assert fix is not None
        assert fix.score > 0.8


def test_a_place_of_a_later_scan_tells_of_an_earlier_one(building: Any) -> None:
    scans = walk(building, 2)
    fix = tracker_of(building).locate(scans[0], place_of(building, 2, scans[-1]), 2)
    assert off_by(building, scans[0], fix).distance < 0.05


def test_the_layout_says_where_a_place_is_in_another_submap(building: Any) -> None:
    scan = walk(building, 2)[0]
    elsewhere = frames_of(building)[1].inverse() @ scan.map_from_base
    fix = tracker_of(building).locate(scan, Place(1, elsewhere, scan.map_from_base), 2)
    assert off_by(building, scan, fix).distance < 0.05
    alone = tracker_of(building)
    alone.frames = {}
    assert alone.locate(scan, Place(1, elsewhere, scan.map_from_base), 2) is None


def test_the_covariance_is_large_along_what_the_walls_do_not_tell(building: Any) -> None:
    """One straight wall ahead: across it the pose is known, along it only by the motion."""
    scan = walk(building, 2)[0]
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


def test_a_slip_of_the_registration_is_followed(building: Any) -> None:
    tracker = tracker_of(building)
    scans = walk(building, 2)
    place = place_of(building, 2, scans[0])
    for scan in scans[:3]:
        tracker.locate(scan, place, 2)
    slipped = replace(scans[3], map_from_base=scans[3].map_from_base @ Pose2(0.15, 0.0, 0.05))
    fix = tracker.locate(slipped, place, 2)
    assert off_by(building, scans[3], fix).distance < 0.05


def test_another_place_is_not_drawn_to_the_one_that_was_followed(building: Any) -> None:
    tracker = tracker_of(building)
    scans = walk(building, 2)
    wrong = place_of(building, 2, scans[0], Pose2(1.5, 0.5, 1.5))
    tracker.locate(scans[0], wrong, 2)
    fix = tracker.locate(scans[1], place_of(building, 2, scans[1]), 2)
    assert off_by(building, scans[1], fix).distance < 0.05


def test_after_a_restart_nothing_is_followed(building: Any) -> None:
    tracker = tracker_of(building)
    first, second = walk(building, 2)[:2]
    tracker.locate(first, place_of(building, 2, first), 2)
    far = replace(second, map_from_base=Pose2(300.0, -80.0, 1.0), restarted=True)
    place = Place(2, place_of(building, 2, second).pose, far.map_from_base)
    assert tracker.locate(replace(far, planar=first.planar), None, None) is None
    fix = tracker.locate(far, place, 2)
    assert off_by(building, second, fix).distance < 0.05


@pytest.mark.parametrize("lost_score", [0.0, 1.0])
def test_what_fits_no_walls_has_no_pose(building: Any, lost_score: float) -> None:
    turn("recognition", lost_score=lost_score)
    tracker = tracker_of(building)
    scan = walk(building, 2)[0]
    assert (tracker.locate(scan, place_of(building, 2, scan), 2) is None) == (lost_score == 1.0)


def test_without_a_place_a_label_or_a_return_there_is_no_pose(building: Any) -> None:
    tracker = tracker_of(building)
    scan = walk(building, 2)[0]
    place = place_of(building, 2, scan)
    blind = replace(scan, planar=building.scans(np.array([[1e6, 1e6, 0.0]]))[0])
    assert tracker.locate(scan, None, 2) is None
    assert tracker.locate(scan, place, None) is None
    assert tracker.locate(replace(scan, lost=True), place, 2) is None
    assert tracker.locate(blind, place, 2) is None

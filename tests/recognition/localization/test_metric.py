"""The pose within a submap: found anywhere in it, followed, and found again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids import matching
from specmap_cli.recognition.localization import metric
from specmap_cli.recognition.localization.metric import MetricTracker

CONFIG = LocalizationConfig()


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How often the tracker searched near a guess, and everywhere."""
    counts = {"near": 0, "everywhere": 0}

    def near(*arguments: Any) -> Any:
        counts["near"] += 1
        return matching.search(*arguments)

    def everywhere(*arguments: Any, **options: Any) -> Any:
        counts["everywhere"] += 1
        return matching.search_everywhere(*arguments, **options)

    monkeypatch.setattr(metric, "search", near)
    monkeypatch.setattr(metric, "search_everywhere", everywhere)
    return counts


def walk(building: Any, room: int, seed: int = 3, steps: int = 6) -> list[PosedScan]:
    """The first scans of a walk through a room, ten centimetres or so apart."""
    start, end = (Pose2(*building.path(room, seed)[k].tolist()) for k in (0, 1))
    turn = end.theta - start.theta if abs(end.theta - start.theta) < 0.5 else 0.1
    along = [
        Pose2(
            start.x + (end.x - start.x) * t,
            start.y + (end.y - start.y) * t,
            start.theta + turn * t,
        )
        for t in np.linspace(0.0, 1.0, steps)
    ]
    scans = building.scans(np.array(along))
    return [
        PosedScan(index=k, stamp_ns=k, map_from_base=p, planar=s, base_from_laser=IDENTITY)
        for k, (p, s) in enumerate(zip(along, scans, strict=True))
    ]


def off_by(building: Any, room: int, scan: PosedScan, found: Pose2) -> float:
    """Metres between a pose found in a room's submap and the true one."""
    submap = Pose2(*building.path(room, 0)[0].tolist())
    truth = submap.inverse() @ scan.map_from_base
    return (truth.inverse() @ found).distance


def test_a_pose_is_found_anywhere_and_then_followed(
    building: Any, searches: dict[str, int]
) -> None:
    tracker = MetricTracker({2: building.visit(0, 2).grid}, CONFIG)
    for scan in walk(building, 2):
        match = tracker.locate(scan, 2)
        assert off_by(building, 2, scan, match.pose) < 0.1
        assert match.score > 0.8
    assert searches == {"near": 0, "everywhere": 1}


@pytest.mark.parametrize(("score", "near"), [(0.0, 0), (1.0, 5)])
def test_what_fits_where_the_motion_leads_is_not_sought(
    building: Any, searches: dict[str, int], score: float, near: int
) -> None:
    config = LocalizationConfig(follow_score=score)
    tracker = MetricTracker({2: building.visit(0, 2).grid}, config)
    for scan in walk(building, 2):
        assert off_by(building, 2, scan, tracker.locate(scan, 2).pose) < 0.1
    assert searches == {"near": near, "everywhere": 1}


def test_the_layout_says_where_a_robot_comes_into_another_submap(
    building: Any, searches: dict[str, int]
) -> None:
    grids = {room: building.visit(0, room).grid for room in (1, 2)}
    frames = {room: Pose2(*building.path(room, 0)[0].tolist()) for room in (1, 2)}
    tracker = MetricTracker(grids, CONFIG, frames)
    for room in (1, 2, 1):
        scan = walk(building, room)[0]
        assert off_by(building, room, scan, tracker.locate(scan, room).pose) < 0.1
    assert searches == {"near": 0, "everywhere": 1}


def test_a_layout_that_leads_astray_is_mended_by_a_search(
    building: Any, searches: dict[str, int]
) -> None:
    grids = {room: building.visit(0, room).grid for room in (1, 2)}
    tracker = MetricTracker(grids, CONFIG, {1: IDENTITY, 2: Pose2(90.0, 0.0, 2.0)})
    for room in (1, 2):
        scan = walk(building, room)[0]
        assert off_by(building, room, scan, tracker.locate(scan, room).pose) < 0.1
    assert searches == {"near": 1, "everywhere": 2}


def test_a_submap_newly_entered_is_searched_as_a_whole(
    building: Any, searches: dict[str, int]
) -> None:
    grids = {room: building.visit(0, room).grid for room in (1, 2)}
    tracker = MetricTracker(grids, CONFIG)
    for room in (1, 2, 1):
        scan = walk(building, room)[0]
        assert off_by(building, room, scan, tracker.locate(scan, room).pose) < 0.1
    assert searches == {"near": 0, "everywhere": 3}


def test_after_a_restart_the_last_pose_is_no_guess(building: Any, searches: dict[str, int]) -> None:
    tracker = MetricTracker({2: building.visit(0, 2).grid}, CONFIG)
    first, second = walk(building, 2)[:2]
    tracker.locate(first, 2)
    far = Pose2(300.0, -80.0, 1.0)  # registration begins in another frame
    again = PosedScan(
        index=1,
        stamp_ns=1,
        map_from_base=far,
        planar=second.planar,
        base_from_laser=IDENTITY,
        restarted=True,
    )
    assert off_by(building, 2, second, tracker.locate(again, 2).pose) < 0.1
    assert searches == {"near": 0, "everywhere": 2}


def test_a_low_score_leads_to_a_search_everywhere(building: Any, searches: dict[str, int]) -> None:
    tracker = MetricTracker({2: building.visit(0, 2).grid}, CONFIG)
    first, second = walk(building, 2)[:2]
    tracker.locate(first, 2)
    slipped = second.map_from_base @ Pose2(1.5, 0.0, 0.9)  # odometry that lies
    match = tracker.locate(
        PosedScan(
            index=1,
            stamp_ns=1,
            map_from_base=slipped,
            planar=second.planar,
            base_from_laser=IDENTITY,
        ),
        2,
    )
    assert off_by(building, 2, second, match.pose) < 0.1
    assert searches == {"near": 1, "everywhere": 2}


def test_when_a_score_is_too_low_is_a_setting(building: Any, searches: dict[str, int]) -> None:
    careful = LocalizationConfig(lost_score=1.0)
    tracker = MetricTracker({2: building.visit(0, 2).grid}, careful)
    for scan in walk(building, 2)[:3]:
        tracker.locate(scan, 2)
    assert searches["everywhere"] == 3


def test_how_far_a_pose_is_followed_is_a_setting(building: Any) -> None:
    grid = {2: building.visit(0, 2).grid}
    first, second = walk(building, 2)[:2]
    slipped = second.map_from_base @ Pose2(0.9, 0.0, 0.0)
    found = []
    for reach in (0.4, 1.2):
        tracker = MetricTracker(grid, LocalizationConfig(follow_m=reach, lost_score=0.0))
        tracker.locate(first, 2)
        match = tracker.locate(
            PosedScan(
                index=1,
                stamp_ns=1,
                map_from_base=slipped,
                planar=second.planar,
                base_from_laser=IDENTITY,
            ),
            2,
        )
        found.append(off_by(building, 2, second, match.pose))
    assert found[1] < 0.1 < found[0]


def test_a_scan_without_a_return_has_no_pose_to_speak_of(building: Any) -> None:
    tracker = MetricTracker({2: building.visit(0, 2).grid}, CONFIG)
    scan = walk(building, 2)[0]
    blind = PosedScan(
        index=0,
        stamp_ns=0,
        map_from_base=IDENTITY,
        planar=building.scans(np.array([[1e6, 1e6, 0.0]]))[0],
        base_from_laser=IDENTITY,
    )
    assert tracker.locate(blind, 2).score == 0.0
    assert off_by(building, 2, scan, tracker.locate(scan, 2).pose) < 0.1

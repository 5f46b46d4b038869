"""Places: where motion leads, which of several leads, and how a carried robot is found."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.learning.misfit import HeldOutMisfit
from specmap_cli.recognition.localization.filtering import LEAP
from specmap_cli.recognition.localization.metric import Fix, MetricTracker
from specmap_cli.recognition.localization.places import LeadingPlace, Owners, Place, looking_back
from specmap_cli.recognition.localization.tracking import PlaceTracker
from specmap_cli.recognition.localization.wall_fit import Ratio, Surroundings, View, WallFit
from tests.casting import ranges_at
from tests.recognition.posed import posed
from tests.turning import turn

CELL_M = 0.05
FRAMES = {0: Pose2(0.0, 0.0, 0.0), 1: Pose2(6.0, 0.0, 0.0), 2: Pose2(12.0, 0.0, 0.0)}
TRACKS = {k: np.array([[frame.x, frame.y]]) for k, frame in FRAMES.items()}
NO_WAYS: dict[int, list[int]] = {}
EVEN = np.full(3, 1.0 / 3.0)
ASIDE = Pose2(0.3, 0.4, -1.2)


def room(niche: bool, box: bool) -> GridMap:
    """A room of 4 m by 5 m whose frame is in its middle; a niche and a box tell it from others."""
    cells = np.full((112, 92), UNKNOWN, dtype=np.uint8)
    cells[4:108, 4:88] = OCCUPIED
    cells[6:106, 6:86] = FREE
    if niche:
        cells[70:95, 86:90] = FREE
        cells[68:97, 90:92] = OCCUPIED
    if box:
        cells[6:18, 20:40] = OCCUPIED
    return GridMap(cells, CELL_M, (-2.3, -2.8))


ROOMS = {k: room(niche=k == 1, box=k == 2) for k in FRAMES}


class Home:
    """Rooms 0 and 1 differ by a niche that only a way past it shows; room 2 has a box."""

    def __init__(
        self,
        grids: dict[int, GridMap] = ROOMS,
        tracks: dict[int, FloatArray] = TRACKS,
        frames: dict[int, Pose2] = FRAMES,
        adjacency: dict[int, list[int]] = NO_WAYS,
    ) -> None:
        self.grids, config = grids, LocalizationConfig()
        ratio = Ratio(HeldOutMisfit(0.02, 60), config)
        fit = WallFit(grids, Surroundings(grids, adjacency, frames), ratio, frames)
        self.tracker = PlaceTracker(list(grids), fit, Owners(tracks, frames, grids), config)

    @property
    def place(self) -> Place | None:
        """The place that leads."""
        return None if self.tracker.lead is None else self.tracker.lead.place

    def scan(self, number: int, pose: Pose2, track: Pose2 | None = None) -> PosedScan:
        """What half a circle sees at a pose in a room; `track` is where registration puts it."""
        bearings = np.radians(np.arange(-90.0, 90.0))
        ranges = ranges_at(self.grids[number], np.array([pose]), bearings, 20.0)[0]
        planar = PlanarScan(0, bearings, ranges, 20.0, full_circle=False)
        return posed(planar, pose if track is None else track)

    def see(
        self, number: int, pose: Pose2, belief: FloatArray = EVEN, track: Pose2 | None = None
    ) -> FloatArray:
        """Show the tracker a scan."""
        scan = self.scan(number, pose, track)
        view = View.of(scan, scan.planar, 8.0)
        assert view is not None
        return self.tracker.update(scan, view, belief)


def north(step: int) -> Pose2:
    """Along the wall with the niche, looking at it from two metres south of it on."""
    return Pose2(0.5, -1.8 + 0.25 * step, 0.3)


def test_a_place_that_no_other_looks_like_leads_till_a_scan_is_lost_or_tracking_restarts() -> None:
    """What walls said of it is remembered no longer than a leap is unlikely."""
    home = Home()
    home.see(2, ASIDE)  # two of three submaps are searched
    belief = home.see(2, ASIDE)
    assert home.place is not None
    assert home.place.submap == 2
    assert (ASIDE.inverse() @ home.place.pose).distance < 0.1
    assert belief.argmax() == 2
    assert belief.sum() == pytest.approx(1.0)
    for step in range(40):
        home.see(2, ASIDE @ Pose2(0.0, 0.0, 0.2 * step))
    assert home.tracker.hypotheses[0].weight == pytest.approx(-math.log(LEAP))
    lost = replace(home.scan(2, ASIDE, Pose2(50.0, 0.0, 0.0)), lost=True)
    home.tracker.update(lost, None, EVEN)
    assert home.tracker.lead is None
    home.see(2, ASIDE)
    assert home.tracker.lead is not None, "the next one has a place again"
    home.tracker.restart()
    assert home.tracker.lead is None
    assert not home.tracker.hypotheses
    assert home.tracker.update(home.scan(2, IDENTITY), None, EVEN).tolist() == EVEN.tolist()


def test_none_of_two_look_alikes_leads() -> None:
    home = Home({k: room(niche=False, box=k == 2) for k in FRAMES})
    for step in range(12):
        belief = home.see(0, north(step))
        assert home.place is None
        assert belief[0] == pytest.approx(belief[1], rel=0.2)


def test_the_way_tells_look_alikes_apart_even_against_the_classifiers() -> None:
    home, leads = Home(), []
    mistaken = np.array([0.998, 0.001, 0.001])
    for step in range(14):
        belief = home.see(1, north(step), mistaken)
        leads.append(home.place)
    assert all(lead is None or lead.submap == 1 for lead in leads)
    assert leads[-1] is not None
    assert belief.argmax() == 1


def test_a_robot_that_is_carried_away_has_no_pose_and_then_the_right_one() -> None:
    home = Home()
    for step in range(8):
        home.see(1, north(step))
    assert home.place is not None
    wheels, given = north(8), []
    for step in range(16):
        pose = Pose2(-0.8 + 0.2 * step * 0.4, 1.5 - 0.2 * step, -1.4)
        track = wheels @ (Pose2(-0.8, 1.5, -1.4).inverse() @ pose)
        belief = home.see(2, pose, track=track)
        given.append(home.place)
        if home.place is not None:
            assert home.place.submap == 2
            assert (pose.inverse() @ home.place.pose).distance < 0.15
    assert given[0] is None
    assert given[-1] is not None
    assert belief.argmax() == 2


def test_a_place_goes_over_into_the_submap_of_the_keyframes_around_it() -> None:
    """Two submaps of one hall that both saw all of it."""
    hall = room(niche=True, box=True)
    frames = {0: Pose2(0.0, 0.0, 0.0), 1: Pose2(0.0, 1.0, 0.0)}
    moved = GridMap(hall.cells, CELL_M, (hall.origin[0], hall.origin[1] - 1.0))
    tracks = {0: np.array([[0.0, -1.0]]), 1: np.array([[0.0, 1.0]])}
    home, labels = Home({0: hall, 1: moved}, tracks, frames, {0: [1], 1: [0]}), list[int]()
    for step in range(12):
        pose = Pose2(0.0, -1.2 + 0.2 * step, 1.0)
        labels.append(int(home.see(0, pose, np.array([0.6, 0.4])).argmax()))
    assert labels == [0] * 6 + [1] * 6 or labels == [0] * 7 + [1] * 5
    assert home.place is not None
    assert home.place.submap == 1
    assert (frames[1] @ home.place.pose)[:2] == pytest.approx(pose[:2], abs=0.05)


def test_where_submaps_end_is_not_known_without_tracks_and_labels_stay_the_filter_s() -> None:
    home, belief = Home(tracks={}), np.array([0.1, 0.6, 0.3])
    after = home.see(2, ASIDE, belief)
    assert home.place is not None
    np.testing.assert_array_equal(after, belief)


def test_a_wall_between_keeps_a_place_in_its_submap() -> None:
    cells = np.full((40, 60), FREE, dtype=np.uint8)
    cells[:, 30:32] = OCCUPIED
    grids = {0: GridMap(cells, 0.1), 1: GridMap(cells, 0.1)}
    frames = {0: IDENTITY, 1: IDENTITY}
    tracks = {0: np.array([[1.0, 2.0]]), 1: np.array([[3.4, 2.0]])}
    behind = Owners(tracks, frames, grids)
    assert behind.of(0, Pose2(2.8, 2.0, 0.0)) == 0
    cells[15:25] = FREE
    assert behind.of(0, Pose2(2.8, 2.0, 0.0)) == 1
    assert behind.of(0, Pose2(2.0, 2.0, 0.0)) == 0
    assert Owners({}, frames, grids).of(0, Pose2(2.8, 2.0, 0.0)) == 0
    assert Owners(tracks, {}, grids).of(0, Pose2(2.8, 2.0, 0.0)) == 0


def test_a_submap_is_surrounded_by_the_walls_of_its_neighbours() -> None:
    """Only where it saw nothing itself, and only by those that it is joined to."""
    own = GridMap(np.array([[FREE, UNKNOWN, UNKNOWN]], dtype=np.uint8), 1.0)
    other = GridMap(np.array([[OCCUPIED, UNKNOWN, OCCUPIED]], dtype=np.uint8), 1.0)
    grids, frames = {0: own, 1: other}, {0: IDENTITY, 1: IDENTITY}
    points = np.array([[0.5, 0.5], [1.5, 0.5], [2.5, 0.5]])
    joined = Surroundings(grids, {0: [1], 1: [0]}, frames).field(0)
    assert joined.at(points).tolist() == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)
    for adjacency, known in (({}, frames), ({0: [1]}, {})):
        alone: Any = Surroundings(grids, adjacency, known).field(0)
        assert alone.at(points).max() < 1e-3


TRACK = Pose2(40.0, -3.0, 2.0)  # registration has a frame of its own
PLACE = Place(1, Pose2(1.0, 2.0, 0.5), TRACK)
STEP = Pose2(0.4, 0.1, -0.2)
LAYOUT = {1: Pose2(10.0, 5.0, 1.0), 4: Pose2(-2.0, 7.0, -2.5)}


def test_motion_leads_within_a_submap_and_the_layout_into_another() -> None:
    assert PLACE.led_to(1, TRACK @ STEP, {}) == pytest.approx(PLACE.pose @ STEP)
    found = PLACE.led_to(4, TRACK @ STEP, LAYOUT)
    assert found is not None
    assert LAYOUT[4] @ found == pytest.approx(LAYOUT[1] @ PLACE.pose @ STEP)
    for frames in ({}, {1: LAYOUT[1]}, {4: LAYOUT[4]}):
        assert PLACE.led_to(4, TRACK, frames) is None, "without both frames nothing is known"


@pytest.mark.parametrize(("restarted", "first"), [(0, 1), (1, 1), (2, 2), (3, 3), (4, 1)])
def test_the_next_lead_is_carried_back_within_reach_but_not_past_a_loss_of_tracking(
    restarted: int, first: int
) -> None:
    late = LeadingPlace(Place(7, Pose2(5.0, 1.0, 0.0), Pose2(3.0, 0.0, 0.0)), 0.97)
    scans = [(Pose2(x, 0.0, 0.0), x == restarted, late if x == 3 else None) for x in range(6)]
    found = looking_back(scans, 2.0)
    assert [lead is not None for lead in found] == [first <= x <= 3 for x in range(6)]
    assert [lead.place.pose.x for lead in found if lead] == [2.0 + x for x in range(first, 4)]
    assert {lead.probability for lead in found if lead is not None} == {0.97}


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


def test_a_place_is_matched_and_then_followed_into_another_submap_by_the_layout(
    walk: Walk, building: Any
) -> None:
    place = walk.place(walk.scans[0], Pose2(0.1, -0.1, 0.04))
    for scan in walk.scans:
        off = walk.off_by(scan, place)
        assert off.distance < 0.05
        assert abs(off.theta) < 0.01
    # a place of a later scan tells of an earlier one
    assert Walk(building).off_by(walk.scans[0], walk.place(walk.scans[-1])).distance < 0.05
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


def test_after_a_restart_nothing_is_followed(walk: Walk, building: Any) -> None:
    first, second = walk.scans[:2]
    walk.locate(first, walk.place(first))
    found = walk.locate(replace(second, restarted=True), walk.place(second))
    alone = Walk(building).locate(second, walk.place(second))
    assert found is not None
    assert alone is not None
    assert found.pose == alone.pose
    np.testing.assert_array_equal(found.covariance, alone.covariance)


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

"""Weighed places: which of several leads, how a carried robot is found, and how good a pose is."""

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
from specmap_cli.recognition.learning.calibration import HeldOutMisfit
from specmap_cli.recognition.localization import walls
from specmap_cli.recognition.localization.filtering import LEAP
from specmap_cli.recognition.localization.places import Estimate, Place, WeighedPlaces, information
from specmap_cli.recognition.localization.walls import Fitted, MapWalls, View
from tests.casting import ranges_at
from tests.recognition.posed import posed, walls_of
from tests.recognition.watching import watched
from tests.turning import turn

CELL_M = 0.05
EVEN = np.full(3, 1.0 / 3.0)
ASIDE = Pose2(0.3, 0.4, -1.2)
WIDE = 92  # cells of a room


def room(niche: bool, box: bool) -> Any:
    """Cells of a room of 4 m by 5 m; a niche and a box tell it from others."""
    cells = np.full((112, WIDE), UNKNOWN, dtype=np.uint8)
    cells[4:108, 4:88] = OCCUPIED
    cells[6:106, 6:86] = FREE
    if niche:
        cells[70:95, 86:90] = FREE
        cells[68:97, 90:92] = OCCUPIED
    if box:
        cells[6:18, 20:40] = OCCUPIED
    return cells


class Home:
    """Rooms 0 and 1 differ by a niche that only a way past it shows; room 2 has a box."""

    def __init__(self, niche: bool = True) -> None:
        cells = np.hstack([room(niche and k == 1, k == 2) for k in range(3)])
        self.grid = GridMap(cells, CELL_M, (-2.3, -2.8))
        owner = np.repeat(np.arange(3), WIDE)[None].repeat(112, axis=0)
        config = LocalizationConfig()
        known = MapWalls(self.grid, owner, HeldOutMisfit(0.02, 60), config)
        self.places = WeighedPlaces(known, [0, 1, 2], config)
        self.lead: Any = None
        self.told: Any = None

    def at(self, number: int, pose: Pose2) -> Pose2:
        """A pose in a room, in the map; the frame of a room is in its middle."""
        return Pose2(WIDE * CELL_M * number, 0.0, 0.0) @ pose

    def scan(self, number: int, pose: Pose2, track: Pose2 | None = None) -> PosedScan:
        """What half a circle sees at a pose in a room; `track` is where registration puts it."""
        bearings = np.radians(np.arange(-90.0, 90.0))
        ranges = ranges_at(self.grid, np.array([self.at(number, pose)]), bearings, 20.0)[0]
        planar = PlanarScan(0, bearings, ranges, 20.0, full_circle=False)
        return posed(planar, pose if track is None else track)

    def see(
        self, number: int, pose: Pose2, belief: FloatArray = EVEN, track: Pose2 | None = None
    ) -> FloatArray:
        """Show a scan; the chances of the submaps after it."""
        return self.show(self.scan(number, pose, track), belief)

    def show(self, scan: PosedScan, belief: FloatArray = EVEN) -> FloatArray:
        """The same of a scan that is there."""
        self.told = self.places.see(scan, scan, belief)
        self.lead = self.places.follow(scan, belief)
        return self.places.mixed(belief)

    def off(self, number: int, pose: Pose2) -> float:
        """How far the place that leads is from a pose in a room."""
        return float((self.at(number, pose).inverse() @ self.lead.estimate.pose).distance)


def north(step: int) -> Pose2:
    """Along the wall with the niche, looking at it from two metres south of it on."""
    return Pose2(0.5, -1.8 + 0.25 * step, 0.3)


def test_a_place_that_no_other_looks_like_leads_till_a_scan_is_lost_or_tracking_restarts() -> None:
    """What walls said of it is remembered no longer than a leap is unlikely."""
    home = Home()
    belief = home.see(2, ASIDE)
    assert home.told < 0.0
    assert belief.argmax() == 2
    assert belief.sum() == pytest.approx(1.0)
    for step in range(4):
        home.see(2, ASIDE @ Pose2(0.0, 0.0, 0.3 * step))
    assert home.off(2, ASIDE @ Pose2(0.0, 0.0, 0.9)) < 0.05
    for step in range(40):
        home.see(2, ASIDE @ Pose2(0.0, 0.0, 0.2 * step))
    assert home.places.places[0].weight == pytest.approx(-math.log(LEAP))
    home.show(replace(home.scan(2, ASIDE, Pose2(50.0, 0.0, 0.0)), lost=True))
    assert home.lead is None
    assert home.told is None
    home.see(2, ASIDE)
    assert home.lead is not None, "the next one has a place again"
    home.places.restart()
    assert home.places.places == []
    assert home.places.mixed(EVEN).tolist() == EVEN.tolist()


def test_a_view_in_doubt_takes_no_pose_unless_another_place_explains_it_or_none_may() -> None:
    """A person stands close: the place has fitted so far, and nothing else fits."""
    home = Home()
    for step in range(6):
        home.see(2, ASIDE @ Pose2(0.0, 0.0, 0.3 * step))
    scan = home.scan(2, ASIDE @ Pose2(0.0, 0.0, 1.5))
    leader = home.places.places[0]
    elsewhere = replace(leader, estimate=Estimate.found(home.at(0, ASIDE)), weight=0.0)
    for against, other, leads in ((0.5, 1.0, True), (0.5, -1.0, False), (3.5, 4.0, False)):
        home.places.places = [replace(leader, against=against), replace(elsewhere, against=other)]
        home.places._owners = [2, 0]
        assert (home.places.follow(scan, EVEN) is not None) == leads


def test_a_label_follows_a_place_before_its_pose_is_told_as_the_robot_may_be_outside() -> None:
    home = Home()
    home.see(2, ASIDE)
    scan, leader = home.scan(2, ASIDE), home.places.places[0]
    for weight, leads in ((15.0, False), (90.0, True)):  # a third of it is the room's
        home.places.places, home.places._owners = [replace(leader, weight=math.log(weight))], [2]
        assert home.places.mixed(EVEN)[2] > 0.95
        assert (home.places.follow(scan, EVEN) is not None) == leads


def test_along_a_bare_wall_a_place_goes_with_the_motion_and_across_with_the_match() -> None:
    grid = GridMap(np.full((60, 400), FREE, dtype=np.uint8), CELL_M, (-10.0, -1.5))
    grid.cells[8:10], grid.cells[50:52] = OCCUPIED, OCCUPIED
    grid.cells[:8], grid.cells[52:] = UNKNOWN, UNKNOWN
    known = MapWalls(grid, np.zeros(grid.cells.shape), None, LocalizationConfig())
    places = WeighedPlaces(known, [0], LocalizationConfig())
    along = np.linspace(-4.0, 4.0, 80)
    walls = np.vstack([np.column_stack([along, np.full(80, y)]) for y in (-1.075, 1.075)])
    scan = posed(PlanarScan(0, np.zeros(0), np.zeros(0), 20.0, full_circle=True), IDENTITY)
    place = Place(Estimate.found(IDENTITY), IDENTITY, 5.0, -1.0)
    fitted = Fitted(Pose2(0.25, 0.06, 0.0), 0.02, -3.0)
    pose = places._matched(place, fitted, View(scan, walls, walls)).estimate.pose
    assert abs(pose.x) < 0.05
    assert abs(pose.y - 0.06) < 0.03


def test_the_way_tells_look_alikes_apart_even_against_the_classifiers() -> None:
    home, owners = Home(), []
    mistaken = np.array([0.998, 0.001, 0.001])
    for step in range(14):
        belief = home.see(1, north(step), mistaken)
        if home.lead is not None:
            owners.append(home.places.walls.owner(home.lead.estimate.pose))
    assert set(owners) == {1}
    assert home.lead is not None
    assert belief.argmax() == 1


def test_a_robot_that_is_carried_away_has_no_pose_and_then_the_right_one() -> None:
    home = Home()
    for step in range(8):
        home.see(1, north(step))
    assert home.lead is not None
    wheels, given = north(8), []
    for step in range(16):
        pose = Pose2(-0.8 + 0.08 * step, 1.5 - 0.2 * step, -1.4)
        belief = home.see(2, pose, track=wheels @ (Pose2(-0.8, 1.5, -1.4).inverse() @ pose))
        given.append(home.lead)
        if home.lead is not None:
            assert home.off(2, pose) < 0.15
    assert given[0] is None
    assert given[-1] is not None
    assert belief.argmax() == 2


def test_a_place_found_where_a_likely_one_fails_speaks_for_the_map_when_it_goes_on() -> None:
    """Of another building every view may fit somewhere: that it goes on to fit there tells."""
    home = Home()
    for step in range(8):
        home.see(2, ASIDE @ Pose2(0.0, 0.0, 0.3 * step))
    assert home.told < -1.0
    told = []
    for step in range(6):
        pose = Pose2(-0.8 + 0.1 * step, 1.5 - 0.3 * step, -1.4)
        home.see(0, pose, track=ASIDE @ Pose2(0.0, 0.0, 2.4) @ Pose2(0.3 * step, 0.0, 0.0))
        told += [home.told] if home.told is not None else []
    assert any(each.fits for each in home.places.places), "it was found"
    assert told[0] > 1.0
    assert told[-1] < 0.0


def test_what_fits_is_not_sought_and_elsewhere_ever_more_rarely_standing_and_by_the_way_driving(
    building: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    searches = watched(monkeypatch, walls, "search_everywhere")
    known = walls_of(building.plan)
    (standing,) = building.posed(building.path(0, 3)[:1])
    scans = [replace(standing, map_from_base=Pose2(0.06 * k, 0.0, 0.0)) for k in range(9)]
    found = WeighedPlaces(known, [0], LocalizationConfig())
    for scan in scans[:1] * 5:
        found.see(scan, scan, np.ones(1))
    assert len(searches) == 1
    said = [found.see(scan, scan, np.ones(1)) is None for scan in scans[1:]]
    assert said == [True, True, True, False] * 2, "but after some motion it is looked at again"
    assert len(searches) == 1
    foreign = np.random.default_rng(1).uniform(1.0, 5.0, len(scans[0].planar.ranges))
    for step_m, sought in ((0.0, [0, 2, 6, 14, 30]), (0.11, [0, 2, 6, 14, 24])):
        elsewhere, asked = WeighedPlaces(known, [0], LocalizationConfig()), []
        planar = replace(scans[0].planar, ranges=foreign)
        for k in range(32):
            before = len(searches)
            scan = posed(planar, Pose2(step_m * k, 0.0, 0.0))
            elsewhere.see(scan, scan, np.ones(1))
            asked += [k] * (len(searches) > before)
        assert asked == sought


class Walk:
    """The first scans of a walk through a room, ten centimetres or so apart, all in one place."""

    def __init__(self, building: Any) -> None:
        start, end = (Pose2(*pose) for pose in building.path(2, 3)[:2].tolist())
        way, shares = start.inverse() @ end, np.linspace(0.0, 1.0, 6).tolist()
        along = [start @ Pose2(way.x * t, way.y * t, 0.1 * t) for t in shares]
        self.scans: list[PosedScan] = building.posed(np.array(along))
        soon = LocalizationConfig(lead=0.8)  # after one view
        self.places = WeighedPlaces(walls_of(building.plan), [0], soon)
        self.places.see(self.scans[0], self.scans[0], np.ones(1))

    def locate(self, scan: PosedScan) -> Any:
        """The place that leads, at a scan."""
        return self.places.follow(scan, np.ones(1))


def test_a_slip_of_the_registration_is_followed(building: Any) -> None:
    walk, right = Walk(building), Walk(building).scans[3]
    for scan in walk.scans[:3]:
        walk.locate(scan)
    place = walk.locate(replace(right, map_from_base=right.map_from_base @ Pose2(0.15, 0.0, 0.05)))
    assert place.score > 0.8
    assert (right.map_from_base.inverse() @ place.estimate.pose).distance < 0.05


def test_without_a_return_or_a_fit_there_is_no_pose(building: Any) -> None:
    walk = Walk(building)
    scan = walk.scans[0]
    blind = replace(scan, planar=building.scans(np.array([[1e6, 1e6, 0.0]]))[0])
    for seen in (blind, scan):
        assert walk.locate(seen).has_pose == (seen is scan)
    assert walk.locate(replace(scan, lost=True)) is None
    turn("recognition", lost_score=1.0)
    assert not walk.locate(scan).has_pose, "it fits no walls"


def test_the_covariance_is_large_along_what_the_walls_do_not_tell() -> None:
    """One straight wall ahead: across it the pose is known, along it only by the motion."""
    wall = np.column_stack([np.ones(400), np.linspace(-4.0, 4.0, 400)])
    seen = np.column_stack([np.ones(40), np.linspace(-0.3, 0.3, 40)])
    told = information(ScoreField.from_points(wall), seen, IDENTITY)
    found = Estimate.found(IDENTITY).corrected(IDENTITY, told)
    assert found.covariance[1, 1] > 4.0 * found.covariance[0, 0]
    assert np.allclose(found.covariance, found.covariance.T)
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()


def test_a_match_where_none_was_to_be_expected_is_as_good_as_one_just_found() -> None:
    sure = Estimate(IDENTITY, 1e-6 * np.eye(3))
    told = 1e4 * np.eye(3)
    near, far = (sure.corrected(Pose2(x, 0.0, 0.0), told) for x in (0.005, 0.3))
    assert near.pose.x < 0.001
    assert far.pose.x == pytest.approx(0.3, abs=0.01)


def test_none_of_two_look_alikes_leads() -> None:
    home = Home(niche=False)
    for step in range(12):
        belief = home.see(0, north(step))
        assert home.lead is None
        assert belief[0] == pytest.approx(belief[1], rel=0.2)

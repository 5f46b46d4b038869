"""Scans against walls: own places fit, none hides what is seen there, and searches are rare."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import expon, norm

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.matching import Match
from specmap_cli.recognition.learning.misfit import _USUAL_MISFIT, HeldOutMisfit, pooled
from specmap_cli.recognition.localization import wall_fit
from specmap_cli.recognition.localization.places import Place
from specmap_cli.recognition.localization.unknown import WallCheck
from specmap_cli.recognition.localization.wall_fit import (
    _FIT_MOST,
    _FOREIGN_MISFIT,
    _FOREIGN_MISFIT_SPREAD,
    Fitted,
    Ratio,
    Sightlines,
    Surroundings,
    WallFit,
)
from tests.recognition.posed import posed
from tests.recognition.watching import watched
from tests.turning import configured

CONFIG = LocalizationConfig()


def standing(building: Any, room: int = 0) -> PosedScan:
    """The first scan of a walk through a room."""
    found: list[PosedScan] = building.posed(building.path(room, 3)[:1])
    return found[0]


def rooms_of(building: Any, frames: dict[int, Pose2] | None = None, **settings: float) -> WallCheck:
    """The walls of all rooms of the building, each a submap."""
    return check({k: building.walk(k, 0, "pairs").grid for k in range(4)}, frames, **settings)


def check(
    grids: Mapping[int, GridMap], frames: dict[int, Pose2] | None = None, **settings: float
) -> WallCheck:
    config = configured(LocalizationConfig, "recognition", settings)
    around = Surroundings(grids, {}, {})
    return WallCheck(WallFit(grids, around, Ratio(None, config), frames), config)


def told(walls: WallCheck, scan: PosedScan, asked: list[int]) -> float | None:
    """What walls say of a scan that is all that was seen of late."""
    return walls.unknown(scan, scan.planar, asked)


def ratio_of(walls: WallCheck, scan: PosedScan, asked: list[int]) -> float:
    """The same where they say something."""
    ratio = told(walls, scan, asked)
    assert ratio is not None
    return ratio


def asked_at(said: list[float | None]) -> list[int]:
    """The scans of which something was said."""
    return [k for k, ratio in enumerate(said) if ratio is not None]


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """One item for each search of a whole submap."""
    return watched(monkeypatch, wall_fit, "search_everywhere")


shares = st.floats(0.0, 1.0)


@given(shares, shares, shares, shares, st.integers(0, 60))
def test_the_ratio_is_that_of_scipy_s_distributions_and_speaks_for_a_place_that_stands_out(
    one: float, other: float, typical: float, gap: float, views: int
) -> None:
    """Places that look alike say nothing, and more misfit never speaks for the map."""
    ratio = Ratio(HeldOutMisfit(typical, views), CONFIG)
    unknown = norm.logpdf(min(one, _FOREIGN_MISFIT), _FOREIGN_MISFIT, _FOREIGN_MISFIT_SPREAD)
    expected = unknown - expon.logpdf(one, scale=ratio.known)
    assert ratio.of(one) == pytest.approx(min(max(expected, -_FIT_MOST), _FIT_MOST))
    low, high = sorted((one, other))
    assert ratio.of(low) <= ratio.of(high) + 1e-12
    assert ratio.of(one, gap) <= ratio.of(one) == ratio.of(one, 0.05)


def test_few_views_widen_what_is_taken_for_known() -> None:
    means = [pooled(HeldOutMisfit(0.01, views), CONFIG) for views in (0, 2, 10, 60)]
    assert means == sorted(means, reverse=True)
    assert means[0] == pooled(None, CONFIG) == _USUAL_MISFIT
    assert pooled(HeldOutMisfit(0.0, 60), CONFIG) == CONFIG.least_misfit
    assert pooled(HeldOutMisfit(0.2, 60), CONFIG) == pytest.approx(0.2 / math.log(2.0), rel=0.1)


def test_own_scans_fit_in_the_likeliest_submap_and_those_of_another_room_do_not(
    building: Any,
) -> None:
    for room, sign in ((0, -1.0), (2, 1.0)):
        for scan in building.posed(building.path(room, 3)[::6]):
            walls = rooms_of(building)
            assert sign * ratio_of(walls, scan, [0, 1, 3] if sign < 0.0 else [0]) > 0.5
            assert walls.fit.around._fields.keys() == {0}


def test_a_place_is_kept_where_the_scan_alone_fits(building: Any, searches: list[Any]) -> None:
    """What was seen of late shows many small things that the map has not; the scan does not."""
    walls, here = rooms_of(building), standing(building)
    scan = here.planar
    assert ratio_of(walls, here, [0]) < 0.0
    asked = len(searches)
    legs = np.arange(len(scan.ranges)) % 2 == 0
    cluttered = replace(scan, ranges=np.where(legs, 0.6 * scan.ranges, scan.ranges))
    again = walls.unknown(here, cluttered, [0])
    assert again is not None
    assert again < 0.0
    assert len(searches) == asked
    assert ratio_of(walls, replace(here, planar=cluttered), [0]) > 0.0


@pytest.mark.parametrize(
    ("step_m", "likely", "said"),
    [
        (0.0, [2], [0, 2, 6, 14, 30]),  # then 2, 4, 8 and 16 scans later
        (0.0, [2, 3, 1], [0, 3, 8, 17]),
        (0.11, [2], [0, 2, 6, 14, 24]),
    ],
)
def test_elsewhere_is_searched_ever_more_rarely_standing_and_by_the_way_driving(
    building: Any, step_m: float, likely: list[int], said: list[int]
) -> None:
    walls = rooms_of(building, fit_submaps=2, fit_search_m=1.0)
    scan = standing(building).planar
    scans = [posed(scan, Pose2(step_m * k, 0.0, 0.0)) for k in range(32)]
    assert asked_at([told(walls, each, likely) for each in scans]) == said


def test_a_standing_robot_has_one_submap_after_the_other_searched(building: Any) -> None:
    """Its own is the last that the classifiers think of, and it is found in a few scans."""
    walls = rooms_of(building, fit_submaps=1)
    here, said, found = standing(building), [], []
    for _ in range(6):
        said.append(told(walls, here, [2, 3, 1, 0]))
        found.append(walls.found)
    assert [ratio is not None and ratio < 0.0 for ratio in said] == [False] * 3 + [True] * 3
    assert said[0] is not None
    assert said[1:3] == [None, None], "the likeliest submap said it already"
    assert found == [False, False, False, True, False, False]


def test_while_a_scan_fits_it_is_not_sought_and_the_next_look_comes_after_some_motion(
    building: Any, searches: list[Any]
) -> None:
    walls = rooms_of(building, fit_step_m=0.2, fit_step_rad=9.0, view_m=0.05, view_rad=9.0)
    start = building.path(0, 3)[0]
    scans = building.posed(np.array([start + (0.06 * k, 0.0, 0.0) for k in range(9)]))
    assert asked_at([told(walls, scan, [0]) for scan in scans]) == [0, 4, 8]
    assert told(walls, scans[-1], [0]) is not None  # it stands
    assert len(searches) == 1
    walls.restart()
    told(walls, scans[-1], [0])
    assert len(searches) == 2


@pytest.mark.parametrize(
    ("known", "likely", "searched"), [(True, [2], 1), (False, [2], 2), (True, [3, 1], 1)]
)
def test_the_layout_leads_from_one_submap_into_another(
    building: Any, searches: list[Any], known: bool, likely: list[int], searched: int
) -> None:
    """A robot that drives into another room is searched there only without it.

    It need not be among those that the classifiers think of.
    """
    frames = {room: building.frame(room) for room in range(4)}
    walls = rooms_of(building, frames if known else None)
    for room, asked in ((0, [0]), (2, likely)):
        assert ratio_of(walls, standing(building, room), asked) < 0.0
    assert len(searches) == searched


@pytest.mark.parametrize("near", [True, False])
def test_a_robot_that_comes_back_is_known_where_motion_leads(
    building: Any, searches: list[Any], near: bool
) -> None:
    """It saw what the map has not, a metre away or far from where it was known."""
    walls = rooms_of(building, {room: building.frame(room) for room in range(4)})
    scan, place = standing(building), standing(building).map_from_base
    there = Pose2(place.x + (1.0 if near else 12.0), place.y, place.theta)
    elsewhere = posed(standing(building, 2).planar, there)
    for seen in (scan, elsewhere, elsewhere):
        told(walls, seen, [0])
    asked = len(searches)
    said = told(walls, scan, [3])
    assert (said is not None and said < 0.0) == near
    assert len(searches) == asked + (0 if near else 1)


def test_a_place_stands_out_if_none_elsewhere_fits_nearly_as_well(building: Any) -> None:
    fit = rooms_of(building).fit

    def fitted(x: float, misfit: float) -> Fitted:
        return Fitted(Place(0, Pose2(x, 0.0, 0.0), IDENTITY), misfit, fit.ratio.of(misfit))

    best, beside, far, near = fitted(0, 0.22), fitted(0.8, 0.23), fitted(3, 0.45), fitted(5, 0.25)
    assert best.against > 0.0
    assert fit.best([beside, best]) == best, "no other place is known to be worse"
    assert fit.best([far, beside, best, near]) == best, "another one is nearly as good"
    stands_out = fit.best([far, beside, best])
    assert stands_out.place == best.place
    assert stands_out.fits
    sure = fitted(0, 0.02)
    assert fit.best([far, sure]) == sure, "what fits by itself is no better for it"


def test_what_is_seen_behind_walls_speaks_for_unknown(building: Any) -> None:
    """Half a circle that sees one wall and, where the map has another, farther than that."""
    walls, here = rooms_of(building), standing(building)
    whole = here.planar
    ahead = np.abs(whole.bearings) < np.radians(90.0)
    beside = np.abs(whole.bearings) < np.radians(15.0)
    said = []
    for further in (0.0 * ahead, 3.0 * beside, 3.0 * ahead):
        scan = replace(whole, ranges=whole.ranges + further)
        walls.restart()
        said.append(walls.unknown(replace(here, planar=scan), whole, [0]))
    own, door, foreign = (ratio for ratio in said if ratio is not None)
    assert own == door < 0.0, "a door that was closed explains as much"
    assert foreign > 0.0


def test_of_the_places_found_the_one_counts_that_the_map_can_say_least_against(
    building: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a map of half a room the true place may score less than a wrong one."""
    here = standing(building)
    right = building.frame(0).inverse() @ here.map_from_base
    wrong = right @ Pose2(1.0, 0.8, 1.0)
    for order in ([wrong, right], [right, wrong]):
        walls = rooms_of(building)
        found = [Match(pose, 1.0) for pose in order]
        monkeypatch.setattr(wall_fit, "search_everywhere", lambda *_, found=found: found)
        assert ratio_of(walls, here, [0]) < -1.0


def test_returns_where_the_map_saw_nothing_count_less_and_lost_or_empty_scans_say_nothing(
    building: Any,
) -> None:
    """The scan of a room against a map of its left half."""
    grid = building.walk(0, 0, "pairs").grid
    cells = grid.cells.copy()
    cells[:, cells.shape[1] // 2 :] = UNKNOWN
    half = {7: GridMap(cells, grid.resolution, grid.origin)}
    here = standing(building)
    less, alike = (ratio_of(check(half, None, unseen_weight=w), here, [7]) for w in (0.0, 1.0))
    assert less < alike
    assert told(check(half), replace(here, lost=True), [7]) is None
    ranges = here.planar.ranges
    few = replace(here.planar, ranges=np.where(np.arange(len(ranges)) < 9, ranges, np.inf))
    assert told(check(half), replace(here, planar=few), [7]) is None


CELL_M = 0.05
REACH_M = 8.0
BEARINGS = np.radians(np.arange(-90.0, 90.0))


def box(width_m: float, height_m: float) -> GridMap:
    """A closed room of a given size with walls of two cells; its free space begins at (0, 0)."""
    cells = np.full((round(height_m / CELL_M) + 4, round(width_m / CELL_M) + 4), OCCUPIED, np.uint8)
    cells[2:-2, 2:-2] = FREE
    return GridMap(cells, CELL_M, (-2 * CELL_M, -2 * CELL_M))


def seen_in(width_m: float, height_m: float, pose: Pose2) -> PosedScan:
    """What half a circle sees in a room of that size, by geometry alone."""
    angles = BEARINGS + pose.theta
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(angles) > 0.0, width_m - pose.x, -pose.x) / np.cos(angles)
        y = np.where(np.sin(angles) > 0.0, height_m - pose.y, -pose.y) / np.sin(angles)
    planar = PlanarScan(0, BEARINGS, np.minimum(x, y), range_max=30.0, full_circle=False)
    return posed(planar, pose)


def share(scan: PosedScan, pose: Pose2, width_m: float = 5.0, height_m: float = 4.0) -> float:
    return Sightlines({3: box(width_m, height_m)}, REACH_M).behind(3, scan, pose)


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.08, -0.08, 0.0), (0.0, 0.05, 0.03)])
@pytest.mark.parametrize("place", [(2.5, 2.0, 0.3), (0.4, 0.4, 2.0), (4.7, 2.0, 1.5)])
def test_in_its_own_room_nothing_is_behind_walls_however_slightly_a_match_is_off(
    place: tuple[float, float, float], off: tuple[float, float, float]
) -> None:
    pose = Pose2(*place)
    matched = Pose2(pose.x + off[0], pose.y + off[1], pose.theta + off[2])
    assert share(seen_in(5.0, 4.0, pose), matched) <= 0.02


def test_the_far_wall_of_a_longer_room_is_behind_the_map_s_and_none_of_a_smaller_one() -> None:
    pose = Pose2(2.5, 2.0, 0.0)
    scan = seen_in(8.0, 4.0, pose)
    farther = np.cos(BEARINGS) * scan.planar.ranges > 2.5 + 0.3
    assert share(scan, pose) == pytest.approx(np.mean(farther), abs=0.06)
    assert share(scan, pose) > 0.3
    assert share(seen_in(3.5, 3.0, pose), pose) == 0.0


def test_a_wall_beyond_reach_stops_nothing_and_without_a_return_nothing_is_behind_it() -> None:
    pose = Pose2(1.0, 2.0, 0.0)
    scan = seen_in(29.0, 4.0, pose)
    near, far = (Sightlines({3: box(12.0, 4.0)}, r).behind(3, scan, pose) for r in (8.0, 15.0))
    assert near == 0.0 < far
    for reading in (math.inf, math.nan):
        ranges = np.full(len(BEARINGS), reading)
        assert share(replace(scan, planar=replace(scan.planar, ranges=ranges)), pose) == 0.0


def test_the_laser_looks_from_where_it_is_mounted() -> None:
    pose, mounting = Pose2(3.5, 2.0, 0.0), Pose2(0.3, 0.1, math.pi)
    seen = seen_in(5.0, 4.0, pose @ mounting)
    scan = posed(seen.planar, pose, base_from_laser=mounting)
    assert share(scan, pose) <= 0.02
    turned = Pose2(pose.x, pose.y, math.pi)
    assert share(scan, turned) > 0.05


def test_furnished_rooms_hide_nothing_from_their_own_scans(building: Any) -> None:
    for room in range(4):
        grid, first = building.walk(room, 0, "pairs").grid, building.frame(room)
        sight = Sightlines({1: grid}, REACH_M)
        for scan in building.posed(building.path(room, 3)[::8]):
            assert sight.behind(1, scan, first.inverse() @ scan.map_from_base) < 0.05

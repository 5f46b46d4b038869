"""Scans against walls: own places fit, people hide nothing, and walls that are gone tell."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import NO_SUBMAP, PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.recognition.learning.calibration import _USUAL_MISFIT, HeldOutMisfit, pooled
from specmap_cli.recognition.localization import walls as walls_module
from specmap_cli.recognition.localization.walls import Fitted, MapWalls, View
from tests.recognition.posed import posed, scanned, walls_of
from tests.recognition.watching import watched

CONFIG = LocalizationConfig()
CELL_M = 0.05
BEARINGS = np.radians(np.arange(-90.0, 90.0))


def view_of(scan: PosedScan, seen: PlanarScan | None = None) -> View:
    """What is matched of a scan, of which `seen` is all that was seen of late."""
    found = View.of(scan, scan if seen is None else replace(scan, planar=seen))
    assert found is not None
    return found


def standing(building: Any, room: int = 0) -> PosedScan:
    """The first scan of a walk through a room."""
    found: list[PosedScan] = building.posed(building.path(room, 3)[:1])
    return found[0]


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
    return posed(PlanarScan(0, BEARINGS, np.minimum(x, y), range_max=30.0, full_circle=False), pose)


def behind(scan: PosedScan, pose: Pose2, width_m: float = 5.0) -> float:
    """The share of a scan behind the walls of a room of that width and 4 m height."""
    return walls_of(box(width_m, 4.0))._behind(scan, pose)


def test_few_views_widen_what_is_taken_for_known() -> None:
    means = [pooled(HeldOutMisfit(0.01, views), CONFIG) for views in (0, 2, 10, 60)]
    assert means == sorted(means, reverse=True)
    assert means[0] == pooled(None, CONFIG) == _USUAL_MISFIT
    assert pooled(HeldOutMisfit(0.0, 60), CONFIG) == CONFIG.least_misfit
    assert pooled(HeldOutMisfit(0.2, 60), CONFIG) == pytest.approx(0.2 / math.log(2.0), rel=0.1)


@pytest.mark.parametrize("room", [0, 1, 2, 3])
def test_own_scans_are_found_anywhere_and_others_fit_far_worse(building: Any, room: int) -> None:
    whole = scanned(building.plan)
    middle = [190 * k + 5 for k in range(5)]
    cells = whole.cells.copy()
    cells[:, middle[room] : middle[room + 1]] = UNKNOWN
    for scan in building.posed(building.path(room, 3)[::13]):
        best = walls_of(building.plan).anywhere(view_of(scan))[0]
        assert best.misfit < 0.06
        assert (best.pose.inverse() @ scan.map_from_base).distance < 0.05
        known = HeldOutMisfit(0.02, 60)
        others = MapWalls(GridMap(cells, 0.05), np.zeros(cells.shape), known, CONFIG)
        assert others.anywhere(view_of(scan))[0].misfit > 1.5 * best.misfit


def test_people_and_moved_things_in_front_of_walls_say_little_and_a_wall_there_much() -> None:
    """A person beside the robot hides a sixth of a room; a wall hides as much, but is longer."""
    pose = Pose2(2.5, 2.0, 0.3)
    scan, walls = seen_in(5.0, 4.0, pose), walls_of(box(5.0, 4.0))
    beside = np.abs(BEARINGS) < np.radians(30.0)
    person = np.where(beside, 0.8, scan.planar.ranges)
    wall = np.where(beside, 1.4 / np.cos(BEARINGS), scan.planar.ranges)
    alone, hidden, closed = (
        walls.near(view_of(replace(scan, planar=replace(scan.planar, ranges=ranges))), pose)
        for ranges in (scan.planar.ranges, person, wall)
    )
    assert alone.misfit < hidden.misfit < 0.1 < 0.2 < closed.misfit
    assert hidden.fits
    assert not closed.fits


def test_where_all_that_was_seen_of_late_is_wrong_the_scan_alone_finds_the_place(
    building: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The track slipped: what was seen before it lies elsewhere."""
    scan, walls = standing(building), walls_of(building.plan)
    rng = np.random.default_rng(1)
    astray = replace(scan.planar, ranges=rng.uniform(1.0, 4.0, len(scan.planar.ranges)))
    searches = watched(monkeypatch, walls_module, "search_everywhere")
    assert walls.anywhere(view_of(scan))[0].fits
    assert len(searches) == 1
    best = walls.anywhere(view_of(scan, astray))[0]
    assert len(searches) == 3
    assert (best.pose.inverse() @ scan.map_from_base).distance < 0.05
    assert best.fits


def test_a_place_stands_out_if_none_elsewhere_fits_nearly_as_well(building: Any) -> None:
    walls = walls_of(building.plan)

    def fitted(x: float, misfit: float) -> Fitted:
        return Fitted(Pose2(x, 0.0, 0.0), misfit, 1.0 if misfit > 0.1 else -3.0)

    best, beside, near, far = fitted(0, 0.22), fitted(0.8, 0.23), fitted(5, 0.25), fitted(3, 0.45)
    assert walls._weighed([best, beside]) == [best, beside], "no other is known to be worse"
    assert walls._weighed([best, beside, near, far])[0] == best, "another is nearly as good"
    assert walls._weighed([best, beside, far])[0].against < 0.0
    sure = fitted(0, 0.02)
    assert walls._weighed([sure, far])[0] == sure, "what fits by itself is no better for it"


def test_returns_where_the_map_saw_nothing_count_less_and_lost_or_empty_scans_say_nothing(
    building: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scan of a room against a map of its left half."""
    cells = scanned(building.plan).cells.copy()
    scan = standing(building)
    cells[:, round(scan.map_from_base.x / 0.05) :] = UNKNOWN
    half = MapWalls(GridMap(cells, 0.05), np.zeros(cells.shape), None, CONFIG)
    points, said = view_of(scan).points, []
    for weight in (0.0, 0.25, 1.0):
        monkeypatch.setattr(walls_module, "_UNSEEN_WEIGHT", weight)
        said.append(half._off_walls(points, scan.map_from_base)[0])
    assert said == sorted(said)
    assert said[0] < 0.1 < said[2]
    assert View.of(replace(scan, lost=True), scan) is None
    ranges = scan.planar.ranges
    few = replace(scan.planar, ranges=np.where(np.arange(len(ranges)) < 9, ranges, np.inf))
    shows_little = replace(scan, planar=few)
    assert View.of(shows_little, shows_little) is None


def test_a_place_is_of_the_submap_whose_cell_it_is_or_of_the_nearest() -> None:
    owner = np.full((40, 60), NO_SUBMAP)
    owner[5:35, 5:20], owner[5:35, 25:55] = 7, 0
    walls = MapWalls(GridMap(np.full((40, 60), FREE, np.uint8), 0.1), owner, None, CONFIG)
    places = {(1.0, 2.0): 7, (3.0, 2.0): 0, (2.15, 2.0): 7, (2.4, 2.0): 0, (-9.0, 2.0): 7}
    for (x, y), submap in places.items():
        assert walls.owner(Pose2(x, y, 0.0)) == submap


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.08, -0.08, 0.0), (0.0, 0.05, 0.03)])
@pytest.mark.parametrize("place", [(2.5, 2.0, 0.3), (0.4, 0.4, 2.0), (4.7, 2.0, 1.5)])
def test_in_its_own_room_nothing_is_behind_walls_however_slightly_a_match_is_off(
    place: tuple[float, float, float], off: tuple[float, float, float]
) -> None:
    pose = Pose2(*place)
    matched = Pose2(pose.x + off[0], pose.y + off[1], pose.theta + off[2])
    assert behind(seen_in(5.0, 4.0, pose), matched) <= 0.02


def test_the_far_wall_of_a_longer_room_is_behind_the_map_s_and_none_of_a_smaller_one() -> None:
    pose = Pose2(2.5, 2.0, 0.0)
    scan = seen_in(8.0, 4.0, pose)
    farther = np.cos(BEARINGS) * scan.planar.ranges > 2.5 + 0.3
    assert behind(scan, pose) == pytest.approx(np.mean(farther), abs=0.06)
    assert behind(scan, pose) > 0.3
    assert behind(seen_in(3.5, 3.0, pose), pose) == 0.0


@pytest.mark.parametrize("own_width_m", [5.0, 8.0])
def test_what_the_maps_own_scans_look_through_speaks_against_no_place(own_width_m: float) -> None:
    """A pane is a wall of the map, behind which its own scans saw what is there."""
    pose, grid = Pose2(2.5, 2.0, 0.0), box(8.0, 4.0)
    inside = grid.cells_of(np.array([[5.0, 2.0]]))[0, 1]
    grid.cells[2:-2, inside : inside + 3] = OCCUPIED
    at = [Pose2(2.5, y, 0.0) for y in (1.0, 1.5, 2.0, 2.5, 3.0)]
    own = [replace(seen_in(own_width_m, 4.0, each), map_from_base=each) for each in at]
    walls = MapWalls(grid, np.zeros(grid.cells.shape), None, CONFIG, lambda: own)
    behind = walls._behind(seen_in(8.0, 4.0, pose), pose)
    assert (behind > 0.3) == (own_width_m == 5.0)
    assert behind < 0.1 or own_width_m == 5.0

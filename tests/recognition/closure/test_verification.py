"""Do two grids show the same place? What is prepared of them, the search, and the judgement."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert, wrap_angle
from specmap_cli.core.settings import GridConfig, RecognitionConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.occupancy import OccupancyGrid
from specmap_cli.recognition.closure.verification import (
    _CONTRADICTION_DEPTH_M,
    _CONTRADICTION_M,
    _INLIER_M,
    MIN_LEAD,
    MIN_WALL_M,
    Check,
    PreparedGrid,
    headings,
    judge,
    prepared,
    tracks_overlap,
    verify,
)
from tests.strategies import angles, few, pose_arrays, poses
from tests.turning import turn


def ready(grid: GridMap) -> PreparedGrid:
    made = prepared(grid)
    assert made is not None
    return made


def matched(old: PreparedGrid, new: PreparedGrid, tracked: Pose2 | None = None) -> Check:
    """The match of two grids that both show enough walls."""
    check = verify(old, new, lambda _: True, tracked)
    assert check is not None
    return check


def walls_at(
    segments: list[tuple[float, float, float, float]], free: bool = False, resolution: float = 0.05
) -> GridMap:
    """A grid of 12 m by 12 m about the origin with walls (x0, y0, x1, y1), else free or unknown."""
    side = round(12.0 / resolution)
    cells = np.full((side, side), FREE if free else UNKNOWN, dtype=np.uint8)
    grid = GridMap(cells, resolution, (-6.0, -6.0))
    for x0, y0, x1, y1 in segments:
        t = np.linspace(0.0, 1.0, round(math.hypot(x1 - x0, y1 - y0) / resolution * 2))[:, None]
        rows, columns = grid.cells_of(np.array([[x0, y0]]) * (1 - t) + np.array([[x1, y1]]) * t).T
        cells[rows, columns] = OCCUPIED
    return grid


def around(*corners: tuple[float, float]) -> list[tuple[float, float, float, float]]:
    """The walls between corners, closed."""
    return [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]


# an L-shaped room with a shelf: no turn takes it to itself
ROOM = around((-3.0, -2.0), (3.0, -2.0), (3.0, 0.5), (0.5, 0.5), (0.5, 2.0), (-3.0, 2.0))
ROOM += [(-1.5, -0.7, -0.5, -0.7)]
HALL = around((-4.0, -2.0), (4.0, -2.0), (4.0, 2.0), (-4.0, 2.0))
# no two walls at right angles
WEDGE = around((-4.0, -2.0), (3.0, -1.0), (1.0, 2.5))
ROOM_WITH_FLOOR, HALF_WITH_FLOOR = (ready(walls_at(part, free=True)) for part in (ROOM, ROOM[:4]))


def moved(segments: list[tuple[float, float, float, float]], by: Pose2) -> Any:
    """The segments as seen from a frame at `by`."""
    ends = by.inverse().apply(np.array(segments).reshape(-1, 2))
    return [tuple(row) for row in ends.reshape(-1, 4).tolist()]


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), angles)
@few(8)
def test_a_room_is_found_however_it_lies(x: float, y: float, theta: float) -> None:
    """The frame of the second grid lies anywhere; its rows and columns cut the walls otherwise."""
    truth = Pose2(x, y, theta)
    first, second = ready(walls_at(ROOM)), ready(walls_at(moved(ROOM, truth)))
    error = truth.inverse() @ matched(first, second).old_from_new
    assert error.distance < 0.08
    assert abs(error.theta) < 0.03


def driven(building: Any, room: int, resolution: float, frame: Pose2) -> PreparedGrid:
    """What a walk through a room shows on cells of this size, in a frame moved by `frame`."""
    poses = building.path(room, 0)[::4]
    grid = OccupancyGrid(GridConfig(resolution_m=resolution, footprint_m=0.0))
    track = compose(invert(compose(poses[0], np.array(frame))), poses)
    grid.integrate(building.scans(poses), track, track)
    return ready(grid.snapshot())


@pytest.mark.parametrize("resolution", [0.02, 0.03, 0.05, 0.06, 0.08, 0.12, 0.15, 0.2, 0.25])
@pytest.mark.parametrize("frame", [IDENTITY, Pose2(1.3, -0.7, 1.1), Pose2(-0.83, 0.41, -2.3)])
def test_rooms_are_found_at_any_resolution(building: Any, resolution: float, frame: Pose2) -> None:
    for room in range(4):
        old, new = (driven(building, room, resolution, by) for by in (IDENTITY, frame))
        check = matched(old, new)
        error = frame.inverse() @ check.old_from_new
        assert error.distance < 0.05, room
        assert abs(error.theta) < 0.03, room
        assert check.score > 0.95, room
        assert check.confirmed_m > MIN_WALL_M, room


@pytest.mark.parametrize("resolution", [0.05, 0.08, 0.15])
def test_a_corridor_that_fits_twice_keeps_its_rival_on_coarse_cells(resolution: float) -> None:
    """Many rotations are tried there: turns of the best must not hide the second place."""
    long = [(-3.5, -1.0, 3.5, -1.0), (-3.5, 1.0, 3.5, 1.0)]
    short = [(-1.2, -1.0, 1.2, -1.0), (-1.2, 1.0, 1.2, 1.0)]
    old, new = (ready(walls_at(walls, resolution=resolution)) for walls in (long, short))
    assert matched(old, new).lead < MIN_LEAD
    room = ready(walls_at(ROOM, resolution=resolution))
    assert matched(room, room).lead > MIN_LEAD


def test_grids_of_two_rooms_contradict_each_other_and_are_left_rough(building: Any) -> None:
    """Below hope nothing is gained by the fine steps, so they are not made: no lead is known."""
    first, other = ready(building.visit(0, 1).grid), ready(building.visit(1, 2).grid)
    assert matched(first, other).score < RecognitionConfig().min_score
    turn("recognition", hopeless_score=1.0)
    assert matched(first, other).lead == 0.0


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.12, 0.25])
def test_a_grid_agrees_with_itself_and_not_with_one_far_away(resolution: float) -> None:
    """The room has 21 m of wall, in 84 to 1,050 cells."""
    room = ready(walls_at(ROOM, free=True, resolution=resolution))
    check = judge(room, room, IDENTITY)
    assert (check.score, check.overlap, check.least_overlap) == (1.0, 1.0, 1.0)
    assert check.confirmed_m == pytest.approx(21.0, rel=0.1)
    check = judge(room, room, Pose2(50.0, 0.0, 0.0))
    assert (check.score, check.confirmed_m, check.overlap) == (0.0, 0, 0.0)


def by_hand(old: GridMap, new: GridMap, old_from_new: Pose2) -> Any:
    """Confirmed and contradicted share and count of the new grid's walls, by nearest cells."""
    walls = old.centres_of(np.argwhere(old.occupied))
    closed = old.centres_of(np.argwhere(old.cells != FREE))
    points = old_from_new.apply(new.centres_of(np.argwhere(new.occupied)))
    at = old.centres_of(old.cells_of(points[old.values_at(points) != UNKNOWN]))
    distance, _ = cKDTree(walls).query(at)
    depth, _ = cKDTree(closed).query(at)
    confirmed = distance <= _INLIER_M + 1e-6
    contradicted = (distance > _CONTRADICTION_M + 1e-6) & (depth > _CONTRADICTION_DEPTH_M + 1e-6)
    return confirmed.mean(), contradicted.mean(), int(confirmed.sum())


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), angles)
@example(0.05, 0.0, 0.0)
@example(0.2, 0.0, 0.0)
@example(0.4, 0.0, 0.0)
@example(1.0, 0.0, 0.0)
def test_confirmed_and_contradicted_count_both_ways(x: float, y: float, theta: float) -> None:
    there = Pose2(x, y, theta)
    for old, new in ((ROOM_WITH_FLOOR, ROOM_WITH_FLOOR), (ROOM_WITH_FLOOR, HALF_WITH_FLOOR)):
        check, other = judge(old, new, there), judge(new, old, there.inverse())
        sides = by_hand(old.grid, new.grid, there), by_hand(new.grid, old.grid, there.inverse())
        expected = min(s[0] for s in sides) - 2.0 * max(s[1] for s in sides)
        assert check.score == pytest.approx(expected, abs=0.02)  # OpenCV's distances are rounded
        assert check.confirmed_m == pytest.approx(0.05 * min(s[2] for s in sides), abs=0.25)
        assert (check.score, check.confirmed_m) == pytest.approx((other.score, other.confirmed_m))
        assert check.overlap == other.overlap


@given(pose_arrays(), pose_arrays(), poses, st.floats(0.5, 60.0))
def test_overlap_by_a_loop_and_the_same_both_ways(
    old: FloatArray, new: FloatArray, old_from_new: Pose2, reach: float
) -> None:
    placed = old_from_new.apply(new[:, :2])
    gaps = [[math.dist(a, b) for b in placed] for a in old[:, :2]]
    of_old = sum(min(row) <= reach for row in gaps) / len(old)
    of_new = sum(min(column) <= reach for column in zip(*gaps, strict=True)) / len(new)
    found = tracks_overlap(old, new, old_from_new, reach)
    assert found == pytest.approx(min(of_old, of_new))
    assert tracks_overlap(new, old, old_from_new.inverse(), reach) == pytest.approx(found)
    assert tracks_overlap(old, new[:0], old_from_new, reach) == 0.0


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_ways_that_a_hall_fits_the_plausible_one_is_sure(turned: bool) -> None:
    """A rectangle fits as well when it is turned by half; tracking knows which way it stands."""
    hall, room = ready(walls_at(HALL)), ready(walls_at(ROOM))
    known = verify(hall, hall, lambda pose: (math.cos(pose.theta) < 0.0) is turned)
    assert known is not None
    assert matched(hall, hall).lead < MIN_LEAD < known.lead
    assert (math.cos(known.old_from_new.theta) < 0.0) is turned
    # what leads though it is not plausible is told, so that the reason can be said: a twin
    assert verify(room, room, lambda pose: pose.distance > 1.0) == matched(room, room)


def test_where_new_space_turns_the_walls_the_tracked_place_is_tried() -> None:
    """Most walls of the new grid are of an annex that stands askew: along them nothing fits."""
    annex = [(x, 2.4, x + 5.4, 5.4) for x in (-5.5, -4.0, -2.5, -1.0, 0.5)]
    old, new = ready(walls_at(ROOM)), ready(walls_at(ROOM + annex))
    assert abs(matched(old, new).old_from_new.theta) > 0.3
    found = matched(old, new, Pose2(0.2, -0.1, 0.03))
    assert min(found.score - 0.95, found.lead - MIN_LEAD) > 0.0
    assert found.old_from_new.distance < 0.05


@pytest.mark.parametrize("degrees", [0, 10, 37, 80, 130])
def test_headings_lay_walls_along_walls(degrees: float) -> None:
    """Also where no two walls meet at right angles."""
    truth = Pose2(0.0, 0.0, math.radians(degrees))
    for place in (HALL, WEDGE):
        old, new = ready(walls_at(place)), ready(walls_at(moved(place, truth)))
        off = [abs(wrap_angle(each - truth.theta)) for each in headings(old, new)]
        assert math.degrees(min(off)) < 1.5  # the refinement takes more


def test_the_border_of_a_grid_is_no_end_of_free_space() -> None:
    cells = np.full((40, 40), FREE, dtype=np.uint8)
    cells[20, 5:35] = OCCUPIED
    area = ready(GridMap(cells, 0.05))
    assert area.known.all()
    assert area.open[:10].all()
    assert not area.open[15:26, 5:35].any()


@pytest.mark.parametrize(("inlier_m", "margin"), [(0.15, 3), (0.25, 5), (0.01, 1)])
def test_the_known_area_grows_by_what_an_inlier_may_be_off(inlier_m: float, margin: int) -> None:
    cells = np.full((40, 40), UNKNOWN, dtype=np.uint8)
    cells[19, 2:38] = OCCUPIED
    cells[2, 2] = cells[37, 37] = FREE  # the crop keeps the rows between
    turn("recognition", inlier_m=inlier_m)
    middle = ready(GridMap(cells, 0.05)).known[:, 15]
    assert np.flatnonzero(middle).tolist() == list(range(17 - margin, 17 + margin + 1))

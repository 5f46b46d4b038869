"""Grid maps: cells, windows, distances, rays, bent motions; they claim what beams have proved."""

import itertools
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, BentMotion, FloatArray, LocalMotion, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids import gridmap
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cast_rays
from specmap_cli.grids.occupancy import SURFACE_GAP_M, OccupancyGrid
from tests.strategies import few, grid_maps, planar_scans, poses, seeds
from tests.turning import turn


@given(grid_maps())
def test_cells_and_their_centres_belong_together(grid: GridMap) -> None:
    cells = np.argwhere(np.ones_like(grid.cells))
    centres = grid.centres_of(cells)
    np.testing.assert_array_equal(grid.cells_of(centres), cells)
    np.testing.assert_array_equal(grid.values_at(centres), grid.cells.reshape(-1))
    height, width = grid.cells.shape
    outside = np.array([[-1, 0], [0, -1], [height, 0], [0, width]])
    assert not grid.inside(outside).any()
    assert (grid.values_at(grid.centres_of(outside)) == UNKNOWN).all()
    assert grid.inside(cells).all()


@given(grid_maps())
def test_distances_are_scipys(grid: GridMap) -> None:
    clearance = distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1] * grid.resolution
    np.testing.assert_allclose(grid.clearance(), clearance, rtol=1e-5)
    if grid.occupied.any():
        distance = distance_transform_edt(~grid.occupied) * grid.resolution
        np.testing.assert_allclose(grid.obstacle_distance(), distance, rtol=1e-5)
    else:
        assert (grid.obstacle_distance() > 100.0).all()


def test_what_is_near_a_zero_is_the_same_in_bands_of_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    picture = (np.random.default_rng(0).uniform(size=(90, 40)) > 0.01).astype(np.uint8)
    picture[30:70, 5:35] = 1  # some bands of rows hold no zero
    numbers = np.random.default_rng(1).integers(-1, 7, (90, 40)).astype(np.int16)
    table = np.arange(10, 18, dtype=np.int32)
    away = distance_transform_edt(picture)
    for cells in (1 << 20, 120):
        monkeypatch.setattr(gridmap, "_CELLS_AT_ONCE", cells)
        for reach in (0.0, 2.99, 3.0, 5.0, 200.0):
            np.testing.assert_array_equal(gridmap.within(picture, reach), away <= reach)
        np.testing.assert_array_equal(gridmap.looked_up(table, numbers), table[numbers])
    assert gridmap.within(picture[:0], 3.0).shape == (0, 40)


@given(grid_maps(), st.data())
def test_a_window_is_the_same_map_seen_through_a_hole(grid: GridMap, data: st.DataObject) -> None:
    height, width = grid.cells.shape
    low, left = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    high, right = data.draw(st.integers(low, height)), data.draw(st.integers(left, width))
    part = grid.window(slice(low, high), slice(left, right))
    assert part.cells.shape == (high - low, right - left)
    assert part.resolution == grid.resolution
    cells = np.argwhere(np.ones_like(part.cells))
    places = part.centres_of(cells)
    np.testing.assert_allclose(places, grid.centres_of(cells + (low, left)), atol=1e-9)
    np.testing.assert_array_equal(grid.values_at(places), part.cells.reshape(-1))
    assert not np.shares_memory(part.cells, grid.cells)


def test_a_point_on_a_border_belongs_to_the_cell_above_and_right_of_it() -> None:
    grid = GridMap(np.zeros((4, 4), dtype=np.uint8), 0.25, (-0.5, 1.0))
    corners = np.array([[-0.5, 1.0], [0.0, 1.0], [-0.25, 1.25], [0.5, 2.0]])
    assert grid.cells_of(corners).tolist() == [[0, 0], [0, 2], [1, 1], [4, 4]]
    assert grid.inside(grid.cells_of(corners)).tolist() == [True, True, True, False]
    assert grid.cells_of(np.zeros((0, 2))).shape == (0, 2)
    assert grid.values_at(np.zeros((0, 2))).shape == (0,)


def test_a_packed_grid_is_the_grid_in_a_fraction_of_its_memory() -> None:
    grid = GridMap(np.full((300, 200), UNKNOWN, dtype=np.uint8), 0.05, (-3.0, 7.5))
    grid.cells[50:250, 40:160], grid.cells[50:250, 40] = FREE, OCCUPIED
    packed = gridmap.PackedGrid.of(grid)
    np.testing.assert_array_equal(packed.grid.cells, grid.cells)
    assert (packed.grid.resolution, packed.grid.origin) == (0.05, (-3.0, 7.5))
    assert 20 * len(packed.cells.data) < grid.cells.nbytes


def test_rays_end_at_their_range_and_at_the_edge_of_the_grid() -> None:
    room = GridMap(np.full((100, 140), FREE, dtype=np.uint8), 0.05)
    room.cells[:, 120:] = OCCUPIED  # from x = 6 m on
    distance, middle, ahead = room.obstacle_distance(), np.array([[3.5, 2.5]]), np.zeros(1)
    assert cast_rays(distance, room, middle, ahead, 2.4)[0] == np.inf
    assert cast_rays(distance, room, middle, ahead, 2.6)[0] == pytest.approx(2.5)
    assert cast_rays(distance, room, middle, ahead + np.pi, 50.0)[0] == np.inf
    assert cast_rays(distance, room, middle + 9.0, ahead, 50.0)[0] == np.inf
    assert cast_rays(distance, room, middle[:0], ahead[:0], 5.0).shape == (0,)


def walked(grid: GridMap, origin: np.ndarray, angle: float) -> float:
    """The range of one ray, from border to border through every cell it crosses."""
    start = (origin - grid.origin) / grid.resolution
    step = np.array([math.cos(angle), math.sin(angle)])
    height, width = grid.cells.shape
    borders = [
        (line - start[axis]) / step[axis]
        for axis, count in ((0, width), (1, height))
        for line in range(count + 1)
        if step[axis]
    ]
    for near, far in itertools.pairwise(np.array([0.0, *sorted(t for t in borders if t > 0.0)])):
        column, row = np.floor(start + step * (near + far) / 2.0).astype(int)
        if not (0 <= row < height and 0 <= column < width):
            return math.inf
        if grid.cells[row, column] == OCCUPIED:
            return float(near) * grid.resolution
    return math.inf


@given(grid_maps(), seeds)
def test_ranges_are_those_of_a_walk_through_every_cell(grid: GridMap, seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = grid.cells.shape
    origins = grid.origin + rng.uniform(0, 1, (12, 2)) * (width, height) * np.array(grid.resolution)
    middle = grid.centres_of(np.array([[height // 2, width // 2]] * 4))
    origins = np.concatenate([origins, middle])  # from the middle along its row and its column
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, 12), 0.5 * np.pi * np.arange(4)])
    found = cast_rays(grid.obstacle_distance(), grid, origins, angles, 100.0)
    expected = [walked(grid, origin, angle) for origin, angle in zip(origins, angles, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(grid_maps(), st.integers(0, 3))
def test_a_crop_is_what_is_known_and_a_frame_within_the_map(grid: GridMap, frame: int) -> None:
    crop, known = grid.cropped(frame=frame), np.argwhere(grid.cells != UNKNOWN)
    if not len(known):
        assert crop is grid
        return
    low = np.maximum(known.min(axis=0) - frame, 0).tolist()
    high = np.minimum(known.max(axis=0) + frame + 1, grid.cells.shape).tolist()
    expected = grid.window(slice(low[0], high[0]), slice(low[1], high[1]))
    for found in (crop, grid.cropped(grid.cells != UNKNOWN, frame)):
        np.testing.assert_array_equal(found.cells, expected.cells)
        assert found.origin == expected.origin


RIGID = Pose2(3.0, -1.0, 0.7)
POINTS = np.array([[0.0, 0.0], [5.0, 2.0], [-4.0, 8.0]])


def local(x: float, y: float, off_x: float) -> LocalMotion:
    motion = Pose2(RIGID.x + off_x, RIGID.y, RIGID.theta)
    return LocalMotion(np.array([x, y]), motion, 0.02)


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


def test_a_small_room_that_lies_turned_does_not_bend_the_corridor_beside_it() -> None:
    """Its heading is known to half a degree: over the length of a corridor that is decimetres."""
    middle = Pose2(-3.0, 5.0, 0.0)
    off = middle @ Pose2(0.1, 0.0, 0.02) @ middle.inverse()
    room = LocalMotion(np.array(middle[:2]), RIGID @ off, 0.08, 0.02)
    corridor = LocalMotion(np.zeros(2), RIGID, 0.12, 0.003)
    bent = BentMotion(RIGID, (room, corridor))
    places = np.array([middle[:2], (0.0, 18.0), (0.0, -18.0)])
    away = np.hypot(*(bent.apply(places) - RIGID.apply(places)).T)
    assert away == pytest.approx([0.08, 0.0, 0.0], abs=0.03)


def test_distances_are_the_same_bit_for_bit_wherever_the_picture_lies() -> None:
    picture = (np.random.default_rng(0).random((233, 181)) > 0.002).astype(np.uint8)
    exact = distance_transform_edt(picture).astype(np.float32)
    threads = cv2.getNumThreads()
    for count in (1, 2):
        cv2.setNumThreads(count)
        for offset in range(4):
            memory = np.empty(picture.size + 4, dtype=np.uint8)
            moved = memory[offset : offset + picture.size].reshape(picture.shape)
            moved[:] = picture
            np.testing.assert_array_equal(gridmap.cell_distances(moved), exact)
    cv2.setNumThreads(threads)


CELL = 0.0625  # a power of two, so that shifts by whole cells are exact
Taken = list[tuple[PlanarScan, Pose2]]


def settings(**chosen: float) -> GridConfig:
    """Cells of that size, and a robot that covers nothing: what is free was passed by a beam."""
    return GridConfig(**({"resolution_m": CELL, "footprint_m": 0.0} | chosen))


CONFIG = settings()
NOTHING = PlanarScan(0, np.zeros(0), np.zeros(0), 20.0, False)


def add(grid: OccupancyGrid, scan: PlanarScan, pose: Pose2) -> None:
    """One scan, taken by a laser that stands in the middle of the robot."""
    grid.integrate([scan], np.array([pose]), np.array([pose]))


def counts_of(taken: Taken, config: GridConfig = CONFIG) -> OccupancyGrid:
    grid = OccupancyGrid(config)
    for scan, pose in taken:
        add(grid, scan, pose)
    return grid


def gridded(scans: list[PlanarScan], at: list[Pose2], config: GridConfig = CONFIG) -> GridMap:
    return counts_of(list(zip(scans, at, strict=True)), config).snapshot()


def known(grid: GridMap) -> dict[tuple[int, int], int]:
    """State of every known cell by its place in the world, in whole cells."""
    column, row = (round(side / grid.resolution) for side in grid.origin)
    cells = np.argwhere(grid.cells != UNKNOWN)
    return {(int(c) + column, int(r) + row): int(grid.cells[r, c]) for r, c in cells}


def ahead(reach: float) -> PlanarScan:
    """One beam."""
    return PlanarScan(0, np.zeros(1), np.array([reach]), 20.0, False)


def proved_points(scan: PlanarScan, pose: Pose2, config: GridConfig) -> FloatArray:
    """Points dense along every beam that returned, and between two that met one surface."""
    returned = np.isfinite(scan.ranges)
    ranges = np.where(returned, np.minimum(scan.ranges, config.max_range_m), 0.0)
    beams = np.column_stack([np.cos(scan.bearings), np.sin(scan.bearings)]) * ranges[:, None]
    ends = [beams[returned]]
    gaps = np.linalg.norm(np.diff(beams, axis=0), axis=1)
    for i in np.flatnonzero(returned[1:] & returned[:-1] & (gaps <= SURFACE_GAP_M)):
        ends.append(beams[i] + np.linspace(0, 1, 12)[:, None] * (beams[i + 1] - beams[i]))
    along = np.linspace(0.0, 1.0, 400)[:, None, None] * np.concatenate(ends)[None]
    return pose.apply(along.reshape(-1, 2))


@given(planar_scans(beams=48, reach=4.5), poses)
def test_only_where_a_beam_passed_is_free_and_along_it_known(scan: PlanarScan, pose: Pose2) -> None:
    grid, proved = gridded([scan], [pose]), proved_points(scan, pose, CONFIG)
    free = grid.centres_of(np.argwhere(grid.free))
    seen = grid.centres_of(np.argwhere(grid.cells != UNKNOWN))
    for places, among in ((free, proved), (proved, seen)):
        away, _ = cKDTree(among).query(places)
        assert away.max() <= 1.5 * CELL  # a line drawn in whole cells strays by one of them


@given(planar_scans(reach=6.0), poses)
def test_every_return_is_occupied_whatever_other_beams_say(scan: PlanarScan, pose: Pose2) -> None:
    grid = gridded([scan] * 3, [pose] * 3)
    hits = pose.apply(scan.hits())
    # a return on the border of two cells belongs to either
    around = [hits + np.array([dx, dy]) for dx in (-1e-9, 1e-9) for dy in (-1e-9, 1e-9)]
    assert (np.array([grid.values_at(p) == OCCUPIED for p in around]).any(axis=0)).all()
    assert grid.occupied.sum() <= len(hits)


def test_beams_without_a_return_prove_nothing_and_those_cut_short_no_wall() -> None:
    bearings = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    for empty in (np.inf, np.nan):
        nothing = PlanarScan(0, bearings, np.full(90, empty), 20.0, True)
        assert not known(gridded([nothing], [Pose2(1.0, 2.0, 0.3)]))
    cut = gridded([ahead(5.0)], [IDENTITY], settings(max_range_m=3.0))
    places = np.array([[2.5, 0.0], [3.5, 0.0], [5.0, 0.0]])
    assert cut.values_at(places).tolist() == [FREE, UNKNOWN, UNKNOWN]
    assert not cut.occupied.any()


@given(planar_scans(), poses, st.integers(-40, 40), st.integers(-40, 40))
def test_a_shift_moves_the_grid(scan: PlanarScan, pose: Pose2, columns: int, rows: int) -> None:
    start = Pose2(round(pose.x * 256) / 256, round(pose.y * 256) / 256, pose.theta)
    moved = Pose2(start.x + columns * CELL, start.y + rows * CELL, start.theta)
    shifted = {(c + columns, r + rows): v for (c, r), v in known(gridded([scan], [start])).items()}
    found = known(gridded([scan], [moved]))
    # a beam may end on a border to within rounding
    assert len({cell for cell, _ in shifted.items() ^ found.items()}) <= 2


@pytest.mark.parametrize("limit", [{"max_extent_m": 40.0}, {"max_area_m2": 1600.0}])
def test_a_grid_never_grows_past_its_limit_and_counts_scans_beyond(limit: dict[str, float]) -> None:
    grid = OccupancyGrid(settings(**limit))
    add(grid, ahead(2.0), IDENTITY)
    before = grid.snapshot()
    for x in (500.0, -500.0):
        add(grid, ahead(2.0), Pose2(x, 0.0, 0.0))
    assert grid.refused == 2
    add(grid, NOTHING, Pose2(0.0, -500.0, 0.0))  # the robot's footprint is no scan
    add(grid, ahead(np.inf), Pose2(500.0, 0.0, 0.0))  # nor has this one anything
    assert grid.refused == 2
    np.testing.assert_array_equal(grid.snapshot().cells, before.cells)
    add(grid, ahead(2.0), Pose2(5.0, 5.0, 0.0))
    assert grid.refused == 2
    assert grid.snapshot().cells.size * CELL**2 <= 1600.0
    assert grid.snapshot().values_at(np.array([[7.0, 5.0]]))[0] == OCCUPIED


@given(st.integers(0, 6), st.integers(0, 12), st.sampled_from([0.1, 0.25, 0.5, 1.0]))
def test_a_cell_is_occupied_from_its_share_of_hits_on(hits: int, passes: int, share: float) -> None:
    turn("grids", occupied_share=share)
    beams = [ahead(2.0)] * hits + [ahead(4.0)] * passes
    grid = gridded(beams, [IDENTITY] * len(beams))
    expected = UNKNOWN
    if hits + passes:
        expected = OCCUPIED if hits and hits >= share * (hits + passes) else FREE
    assert grid.values_at(np.array([[2.0, 0.0]]))[0] == expected


@given(seeds, st.floats(0.0, 1.5))
def test_the_footprint_is_every_cell_whose_centre_it_covers(seed: int, radius: float) -> None:
    x, y = np.random.default_rng(seed).uniform(-3.0, 3.0, 2).tolist()
    snapshot = gridded([NOTHING], [Pose2(x, y, 0.0)], settings(footprint_m=radius))
    cells = np.argwhere(np.ones_like(snapshot.cells))
    away = np.hypot(*(snapshot.centres_of(cells) - (x, y)).T)
    clear_cut = np.abs(away - radius) > 1e-9
    np.testing.assert_array_equal(snapshot.free.reshape(-1)[clear_cut], (away <= radius)[clear_cut])
    assert not snapshot.occupied.any()


@pytest.mark.parametrize("reading", [0.0, -1.0, np.nan, np.inf, -np.inf])
def test_a_reading_that_is_no_range_changes_nothing(reading: float) -> None:
    turn("grids", surface_gap_m=0.01)

    def seen(bearings: list[float], ranges: list[float]) -> dict[tuple[int, int], int]:
        scan = PlanarScan(0, np.array(bearings), np.array(ranges), 20.0, False)
        return known(gridded([scan], [IDENTITY]))

    without = seen([-0.4, 0.4], [2.0, 2.0])
    assert seen([-0.4, 0.0, 0.4], [2.0, reading, 2.0]) == without
    assert seen([-0.4, 0.0, 0.4], [2.0, 3.0, 2.0]) != without


@pytest.mark.parametrize(("gap", "state"), [(0.5, FREE), (0.3, UNKNOWN)])
def test_between_two_returns_of_one_surface_all_is_free(gap: float, state: int) -> None:
    scan = PlanarScan(0, np.array([-0.1, 0.1]), np.array([2.0, 2.0]), 20.0, False)  # 0.4 m apart
    turn("grids", surface_gap_m=gap)
    grid = gridded([scan], [IDENTITY], settings(resolution_m=0.02))
    between, on_it = [1.5, 0.0], [1.5 * math.cos(0.1), 1.5 * math.sin(0.1)]
    assert grid.values_at(np.array([between, on_it])).tolist() == [state, FREE]


@pytest.mark.parametrize("limit", [{"max_extent_m": 5.0}, {"max_area_m2": 2.0}])
def test_a_scan_that_fits_is_taken_though_no_cell_is_to_spare(limit: dict[str, float]) -> None:
    grid = counts_of([(ahead(reach), IDENTITY) for reach in (2.0, 4.5)], settings(**limit))
    assert grid.refused == 0
    snapshot = grid.snapshot()
    assert snapshot.values_at(np.array([[2.0, 0.0], [4.5, 0.0]])).tolist() == [OCCUPIED, OCCUPIED]
    height, width = (side * CELL for side in snapshot.cells.shape)
    assert max(height, width) <= limit.get("max_extent_m", np.inf)
    assert height * width <= limit.get("max_area_m2", np.inf)
    add(grid, ahead(9.0), Pose2(0.0, 3.0, 0.0))
    assert grid.refused == 1


@given(
    st.lists(st.tuples(planar_scans(beams=24), poses, st.booleans()), min_size=1, max_size=6),
    st.sampled_from([1000.0, 12.0]),
)
def test_scans_taken_in_at_once_are_those_taken_one_by_one(
    taken: list[tuple[PlanarScan, Pose2, bool]], extent: float
) -> None:
    config = settings(footprint_m=0.2, max_extent_m=extent)
    scans = [scan if seen else NOTHING for scan, _, seen in taken]
    bases = np.array([pose for _, pose, _ in taken])
    lasers = np.array([Pose2(0.1, 0.05, 0.3) @ pose for _, pose, _ in taken])
    together, in_turn = OccupancyGrid(config), OccupancyGrid(config)
    together.integrate(scans, lasers, bases)
    for k, scan in enumerate(scans):
        in_turn.integrate([scan], lasers[k : k + 1], bases[k : k + 1])
    assert together.refused == in_turn.refused
    assert together.snapshot().origin == in_turn.snapshot().origin
    np.testing.assert_array_equal(together.snapshot().cells, in_turn.snapshot().cells)


@few(12)
@given(st.lists(st.tuples(planar_scans(beams=24), poses), max_size=5), st.integers(0, 5))
def test_grids_are_added_and_taken_from_each_other(taken: Taken, cut: int) -> None:
    one, other = taken[:cut], taken[cut:]
    both = counts_of(one)
    both.include(counts_of(other))
    assert known(both.snapshot()) == known(counts_of(taken).snapshot())
    rest = counts_of(taken).without(counts_of(one))
    assert known(rest.snapshot()) == known(counts_of(other).snapshot())
    assert known(both.snapshot()) == known(counts_of(taken).snapshot())
    for scan, pose in one:  # a grid that was cropped grows again
        add(rest, scan, pose)
    assert known(rest.snapshot()) == known(counts_of(taken).snapshot())


def test_what_was_seen_for_years_is_not_forgotten() -> None:
    """64 looks, doubled ten times, are one more than a count can hold."""
    grid = counts_of([(ahead(1.0), IDENTITY)] * 64)
    before = known(grid.snapshot())
    for _ in range(11):
        grid.include(grid)
    assert known(grid.snapshot()) == before


@pytest.mark.parametrize(
    ("later", "looks", "is_wall"),
    [(2.0, 7, True), (2.0, 8, False), (1.0 + CELL, 8, True), (0.5, 8, True)],
)
def test_what_was_looked_at_often_enough_is_as_it_was_seen_last(
    later: float, looks: int, is_wall: bool
) -> None:
    """A wall a metre ahead that is gone, or hit a cell behind it, or hidden."""
    grid = counts_of([(ahead(1.0), IDENTITY)] * 40)
    grid.include(counts_of([(ahead(later), IDENTITY)] * looks), renewing=True)
    seen = grid.snapshot().values_at(np.array([[1.0, 0.0], [later, 0.0]]))
    assert seen.tolist() == [OCCUPIED if is_wall else FREE, OCCUPIED]


@given(planar_scans(), poses, st.floats(0.0, 9.0))
def test_the_part_near_places_is_cut_from_all(scan: PlanarScan, pose: Pose2, reach: float) -> None:
    grid = gridded([scan], [pose])
    counts = counts_of([(scan, pose)])
    places = np.array([[0.0, 1.0, 0.3], [2.0, -1.0, 0.0]])
    part, same = grid.near(places, reach), counts.near(places, reach)
    assert (part.resolution, part.origin) == (same.resolution, same.origin)
    np.testing.assert_array_equal(part.cells, same.cells)
    centres = grid.centres_of(np.argwhere(grid.cells < 3))
    shown = centres[(np.abs(centres - (1.0, 0.0)) <= 1.0 + reach - CELL).all(axis=1)]
    assert part.inside(part.cells_of(shown)).all()
    assert max(part.cells.shape) * CELL <= 2.0 + 2.0 * reach + 2.0 * CELL

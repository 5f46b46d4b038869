"""The outlines of regions, what a submap is by its shape, and the division of cells."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.json_values import point
from specmap_cli.core.records import NO_SUBMAP, Labels
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.regions import NOBODY, Outline, Regions, divide, kind_of, outline_of
from tests.exports.consumers import consumer


def rectangle(width: float, height: float) -> FloatArray:
    return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])


@pytest.mark.parametrize(
    ("kind", "sizes"),
    [
        ("room", [(5.0, 4.0), (2.0, 2.0), (6.0, 2.5), (7.0, 6.5), (12.0, 4.0), (1.5, 5.8)]),
        ("corridor", [(10.0, 2.0), (1.5, 6.2), (40.0, 3.0)]),
        ("hall", [(8.0, 8.0), (30.0, 5.0), (60.0, 40.0)]),
    ],
)
def test_rectangles(kind: str, sizes: list[tuple[float, float]]) -> None:
    for size in sizes:
        assert kind_of(rectangle(*size)) == kind, size


def test_a_corridor_may_bend_and_branch_but_furniture_makes_none_of_a_room() -> None:
    """Shelves 0.5 m apart stand out from both long walls of 6 m x 5 m."""
    bent = np.array([[0, 0], [8, 0], [8, 2], [2, 2], [2, 9], [0, 9]], dtype=np.float64)
    tee = np.array([[0, 0], [9, 0], [9, 2], [5.5, 2], [5.5, 7], [3.5, 7], [3.5, 2], [0, 2]])
    assert kind_of(bent) == kind_of(tee) == "corridor"
    shelf = ((0, 0), (0.5, 0), (0.5, 1.5), (1, 1.5))
    lower = [(k + x, y) for k in range(6) for x, y in shelf]
    upper = [(6 - x, 5 - y) for x, y in lower]
    assert kind_of(np.array([*lower, (6, 0), *upper, (0, 5)], dtype=np.float64)) == "room"


def test_what_has_no_area_has_no_kind_and_the_work_does_not_grow_with_the_size() -> None:
    for shape in (np.zeros((0, 2)), np.zeros((2, 2)), np.zeros((5, 2)), rectangle(9.0, 0.0)):
        assert kind_of(shape) is None
    assert kind_of(rectangle(1e7, 1e7)) == "hall"


def as_scanned(seed: int) -> FloatArray:
    """The border of two walls' length of space in a grid, with furniture and frayed walls."""
    rng = np.random.default_rng(seed)
    cells = np.zeros((400, 400), dtype=np.uint8)
    for _ in range(2):
        (x, y), (width, height) = rng.integers(150, 200, 2), rng.integers(20, 190, 2)
        cells[y : y + height, x : x + width] = 1
    for x, y in rng.integers(140, 360, (8, 2)):
        cells[y : y + rng.integers(4, 30), x : x + rng.integers(4, 30)] = 0
    frayed = cv2.blur(rng.random(cells.shape), (3, 3)) > 0.6
    return outline_of((cells > 0) & ~frayed, GridMap(cells, 0.05)).polygon


@given(
    st.one_of(
        st.builds(as_scanned, st.integers(0, 10_000)),
        st.builds(rectangle, st.floats(0.3, 30.0), st.floats(0.3, 12.0)),
    ),
    st.floats(-math.pi, math.pi),
    st.floats(-50.0, 50.0),
    st.booleans(),
)
def test_the_kind_is_the_same_turned_moved_mirrored_and_written(
    shape: FloatArray, turn: float, shift: float, mirrored: bool
) -> None:
    """But for shapes that are another kind when they are half a percent longer, or shorter."""
    moved = Pose2(shift, -shift, turn).apply(shape * ((-1.0, 1.0) if mirrored else (1.0, 1.0)))
    written = np.array([point(corner) for corner in moved])
    near = {kind_of(shape * stretch) for stretch in ((1.005, 1.0), (1.0, 1.005), (0.995, 0.995))}
    assert kind_of(written) == kind_of(shape) or len(near | {kind_of(shape)}) > 1


def grid_of(picture: list[str], resolution: float = 0.5) -> GridMap:
    """Free cells where a `.` is, the first line being the highest y."""
    cells = [[FREE if letter == "." else UNKNOWN for letter in line] for line in picture[::-1]]
    return GridMap(np.array(cells, dtype=np.uint8), resolution, (10.0, -4.0))


def outline(grid: GridMap) -> Outline:
    """The outline of all free cells."""
    return outline_of(grid.free, grid)


def test_the_centroid_lies_inside_an_l_and_thin_regions_keep_an_area() -> None:
    shape = outline(grid_of(["...     ", "...     ", "...     ", "........", "........"]))
    assert shape.centroid is not None
    corners, centroid = shape.polygon.astype(np.float32), tuple(shape.centroid.tolist())
    assert cv2.pointPolygonTest(corners, centroid, False) > 0
    for thin in (["."], ["...."], [".", "."]):
        polygon = outline(grid_of(thin)).polygon
        assert len(polygon) >= 3, thin
        assert cv2.contourArea(polygon.astype(np.float32), oriented=True) > 0, thin


def test_a_polygon_does_not_cross_itself() -> None:
    """Ragged regions; with fewer corners some of their contours would."""
    shapely = consumer("shapely")
    for seed in range(200):
        ragged = cv2.blur(np.random.default_rng(seed).random((30, 30)), (3, 3)) > 0.5
        grid = GridMap(np.where(ragged, FREE, OCCUPIED).astype(np.uint8), 0.05)
        assert shapely.Polygon(outline(grid).polygon).is_valid, seed


def labels_at(places: dict[int, tuple[float, float]]) -> Labels:
    """One keyframe in each submap."""
    poses = np.array([(x, y, 0.0) for x, y in places.values()])
    return Labels(stamps_ns=np.arange(len(places)), poses=poses, submaps=np.array(list(places)))


def test_a_room_that_was_not_entered_is_nobodys_up_to_its_door() -> None:
    grid = GridMap(np.full((4, 10), FREE, dtype=np.uint8), 1.0)
    entered = [(np.s_[0:4, 0:6], np.ones((4, 6), dtype=np.bool_))]
    regions = divide(grid, labels_at({3: (1.5, 1.5)}), rooms=entered)
    np.testing.assert_array_equal(regions.owner[:, :6], 3)
    np.testing.assert_array_equal(regions.owner[:, 6:], NOBODY)
    assert [piece.area_m2 for piece in regions.seen] == [16.0]
    standing = divide(grid, labels_at({3: (7.5, 1.5)}), rooms=entered).owner
    assert np.argwhere(standing == 3).tolist() == [[1, 7]], "where the robot stood is its own"


def test_a_submap_ends_with_its_room_though_it_is_the_nearest_beyond() -> None:
    """The robot stood near a door of the room, and in the corridor far from there."""
    cells = np.full((20, 30), FREE, dtype=np.uint8)
    cells[10] = OCCUPIED
    cells[10, 3:7] = FREE
    room = np.ones((10, 30), dtype=np.bool_)
    rooms = [(np.s_[0:10, 0:30], room), (np.s_[10:20, 0:30], room)]
    grid, stood = GridMap(cells, 0.1), labels_at({2: (0.5, 0.9), 4: (2.9, 1.9)})
    leaked, whole = (divide(grid, stood, rooms=known).owner for known in (None, rooms))
    assert 2 in leaked[11:]
    assert (whole[:10] == 2).all()
    assert (whole[11:] == 4).all()


def test_near_is_on_foot_not_through_a_wall_or_a_slit_of_a_railing() -> None:
    cells = np.full((30, 41), FREE, dtype=np.uint8)
    cells[:24, 20] = OCCUPIED  # a wall with an opening at the far end
    wall = divide(GridMap(cells, 1.0), labels_at({0: (18.5, 1.5), 1: (39.5, 28.5)})).owner
    cells = np.full((80, 120), FREE, dtype=np.uint8)
    cells[:60, 60] = OCCUPIED  # a railing with a way round it at the far end
    cells[5:60:6, 60] = FREE
    railing = divide(GridMap(cells, 0.05), labels_at({0: (2.7, 0.5), 1: (3.7, 3.7)})).owner
    for owner, rows, column in ((wall, 4, 20), (railing, 20, 60)):
        assert (owner[:rows, :column] == 0).all()
        assert (owner[:rows, column + 1 :] == 1).all()  # nearer to keyframe 0 as the crow flies


@pytest.mark.parametrize("seed", range(5))
def test_regions_are_connected_and_hold_their_keyframes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((60, 80)) < 0.04, OCCUPIED, FREE).astype(np.uint8)
    grid = GridMap(cells, 0.1)
    places = {id_: tuple(rng.uniform((0.2, 0.2), (7.8, 5.8))) for id_ in range(6)}
    regions = divide(grid, labels_at(places))
    for id_, place in places.items():
        row, column = grid.cells_of(np.array([place]))[0]
        region = regions.owner == id_
        assert region[row, column] or cells[row, column] == OCCUPIED
        count, _, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8))
        assert (stats[1:, cv2.CC_STAT_AREA].max() if count > 1 else 0) >= 0.97 * region.sum()
    owned = regions.owner != NOBODY
    assert (owned <= grid.free).all()
    assert owned.sum() > 0.97 * grid.free.sum()


def test_thin_rays_are_not_reached_but_a_doorway_of_half_a_metre_is_gone_through() -> None:
    """What single beams carved through a gap is no part of a room."""
    cells = np.full((40, 120), UNKNOWN, dtype=np.uint8)
    cells[5:35, 5:35], cells[20, 35:110] = FREE, FREE
    regions = divide(GridMap(cells, 0.05), labels_at({0: (1.0, 1.0)}))
    assert (regions.owner[5:35, 5:35] == 0).all()
    assert (regions.owner[20, 45:110] == NOBODY).all()
    cells = np.full((40, 70), FREE, dtype=np.uint8)
    cells[:15, 35], cells[25:, 35] = OCCUPIED, OCCUPIED
    regions = divide(GridMap(cells, 0.05), labels_at({0: (1.0, 1.0)}))
    assert (regions.owner[cells == FREE] == 0).all()


def test_the_area_of_a_submap_is_that_of_its_free_cells_and_furniture_is_none() -> None:
    cells = np.full((10, 20), FREE, dtype=np.uint8)
    cells[4:6, 4:7], cells[0, 19] = OCCUPIED, UNKNOWN
    owner = np.zeros(cells.shape, dtype=np.int64)
    owner[:, 10:], owner[9, :] = 1, NOBODY
    regions = Regions.of(GridMap(cells, 0.5), owner)
    assert regions.outline(0).area_m2 == pytest.approx((9 * 10 - 6) * 0.25)
    assert regions.outline(1).area_m2 == pytest.approx((9 * 10 - 1) * 0.25)
    assert regions.area_m2 == pytest.approx((2 * 9 * 10 - 7) * 0.25)


def test_what_was_only_seen_is_told_by_piece_with_a_place_inside() -> None:
    """The largest first. Pieces join over corners as rays do; neither specks nor walls count."""
    cells = np.full((60, 60), UNKNOWN, dtype=np.uint8)
    cells[0:10, 0:40] = FREE  # the room
    cells[20:30, 0:13], cells[30:32, 13:30] = FREE, FREE  # a hall and a strip at its corner
    cells[40:52, 5:45], cells[43, 25] = FREE, OCCUPIED
    cells[55:58, 0:33] = FREE  # 0.99 m2
    owner = np.full(cells.shape, NOBODY)
    owner[0:10, 0:40] = 0
    regions = Regions.of(GridMap(cells, 0.1, (-2.0, 3.0)), owner)
    large, small = regions.seen
    assert (large.area_m2, small.area_m2) == pytest.approx((12 * 40 * 0.01 - 0.01, 1.64))
    assert regions.seen_m2 == pytest.approx(large.area_m2 + small.area_m2)
    clear = distance_transform_edt(np.pad(cells[40:52, 5:45] == FREE, 1))[1:-1, 1:-1]
    row, column = regions.grid.cells_of(np.array([[large.x, large.y]]))[0] - (40, 5)
    assert clear[row, column] == clear.max()
    assert -2.0 < small.x < -0.7, "in the hall, not in the strip"
    assert 5.0 < small.y < 6.0


def test_no_keyframes_keyframes_off_the_grid_and_regions_without_a_cell() -> None:
    grid = GridMap(np.full((2, 2), FREE, dtype=np.uint8), 1.0)
    for labels in (labels_at({0: (100.0, 0.0)}), labels_at({NO_SUBMAP: (1.0, 1.0)})):
        assert (divide(grid, labels).owner == NOBODY).all()
    regions = Regions.of(grid, np.array([[0, 0], [NOBODY, 2]]))
    assert sorted(regions.outlines) == [0, 2]
    assert regions.outline(1).centroid is None

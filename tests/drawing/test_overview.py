"""The picture of a map: regions, graph and way of the robot; sheets to scale, and what they say."""

import itertools
import tracemalloc
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.findings import Finding, Quality, Where
from specmap_cli.core.geometry import IDENTITY, FloatArray
from specmap_cli.core.records import Labels, Trajectory
from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.canvas import Image
from specmap_cli.drawing.overview import drawn_as, render_overview, render_segmentation, spread
from specmap_cli.drawing.sheet import LONG_SIDE, MARGIN, TITLE, Sheet, extent_of
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.maps.writing import MapResult
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import Door, Edge, LogInfo, Submap, TopologicalMap
from tests.drawing.looking import inked, is_framed, near, of_colour, one_room, pixel
from tests.strategies import lengths, seeds

NOWHERE = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
UNLABELLED = Labels(stamps_ns=NOWHERE.stamps_ns, poses=NOWHERE.poses, submaps=NOWHERE.stamps_ns)
ROOM, REGIONS = one_room((80, 120))
MIDDLE = (2.975, 1.975)  # of the cell in the middle of the room


def drawn(made: MapResult) -> Image:
    return render_overview(made.topology, made.regions, made.trajectory, made.labels, made.logs)


def driven(way: FloatArray, *findings: Finding) -> Image:
    """The room after a way (n, 2), all its scans keyframes."""
    stamps = np.arange(len(way))
    poses = np.column_stack([way, np.zeros(len(way))])
    labels = Labels(stamps_ns=stamps, poses=poses, submaps=np.zeros_like(stamps))
    path, quality = Trajectory(stamps, poses), Quality.of(findings)
    return render_overview(ROOM, REGIONS, path, labels, [LogInfo("log")], quality)


def places_on(regions: Regions, points: list[tuple[float, float]]) -> FloatArray:
    """Where the points of a map are in its picture; what the legend says changes nothing there."""
    return Sheet(*extent_of(regions), ()).pixels(np.array(points))


def around(image: Image, place: FloatArray, reach: int) -> Image:
    x, y = place.astype(int).tolist()
    return image[y - reach : y + reach + 1, x - reach : x + reach + 1]


def test_shows_what_it_should(result: MapResult) -> None:
    image, regions = drawn(result), result.regions
    fills = palette.colours_of(result.topology, regions)
    assert len(set(fills.values())) == 3
    for id_, fill in fills.items():
        share = near(image, fill) / near(image, fills[0])
        area = regions.outline(id_).area_m2 / regions.outline(0).area_m2
        assert share == pytest.approx(area, rel=0.15)
    assert near(image, palette.TRAVERSED) > 100
    assert near(image, palette.CLOSURE) > 100
    assert near(image, palette.LOOSE) == 0
    assert is_framed(image)


@pytest.mark.parametrize("shape", [(4, 4), (1, 1)])
def test_nothing_known(shape: tuple[int, int]) -> None:
    grid = GridMap(np.full(shape, UNKNOWN, dtype=np.uint8), 0.05)
    empty = Regions.of(grid, np.full(shape, NOBODY))
    no_map = TopologicalMap(submaps={}, edges={})
    overview = render_overview(no_map, empty, NOWHERE, UNLABELLED, [LogInfo("empty")])
    for image in (overview, render_segmentation(no_map, empty, LogInfo("empty"))):
        assert is_framed(image)
        assert not inked(image[TITLE : TITLE + 1700]).any()


def test_the_way_is_drawn_over_its_whole_length_from_its_start_to_its_end() -> None:
    image = driven(np.linspace((1.0, 1.0), (5.0, 3.0), 60))
    start, end = places_on(REGIONS, [(1.0, 1.0), (5.0, 3.0)])
    assert pixel(image, start) == pixel(image, end) == palette.INK
    corner = np.array([6.5, 6.5])
    assert pixel(image, start + corner) == pixel(image, start - corner) == palette.INK  # a square
    assert palette.INK not in (pixel(image, end + corner), pixel(image, end - corner))  # a disc
    out_of_the_grid = np.linspace((1.0, 1.0), (12.0, 9.0), 60)
    image = driven(out_of_the_grid)
    assert is_framed(image)
    sheet = Sheet(np.minimum(0.0, extent_of(REGIONS)[0]), np.array([12.3, 9.3]), ())
    for place in sheet.pixels(out_of_the_grid[5:-5:2]):
        assert of_colour(around(image, place, 2), symbols.PATH, 90).any()


def test_a_jump_is_not_drawn_as_a_way() -> None:
    """The robot was lost and turned up elsewhere: no line leads there."""
    whole = np.linspace((1.0, 1.0), (5.0, 1.0), 40)
    lost = np.concatenate([whole[:5], whole[-5:]])
    nowhere, broken, through = (driven(way)[TITLE:] for way in (whole[:0], lost, whole))
    assert 100 < (broken != nowhere).sum() < (through != nowhere).sum() / 2


def test_a_badge_stays_near_the_way_of_the_robot() -> None:
    """The middle of a room stands for it, unless the robot never came near: glass lies between."""
    (middle,) = places_on(REGIONS, [MIDDLE])
    rim = middle + (symbols.BADGE_RADIUS - 3.0, 0.0)
    for corner, is_near in (((2.5, 1.5), True), ((0.5, 0.5), False)):
        image = driven(np.linspace(corner, np.array(corner) + 0.2, 20))
        assert (pixel(image, rim) == palette.FILLS[0]) is not is_near, corner


def test_the_margin_tells_days_frame_and_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(Sheet, "margin", lambda _, words: said.append(words))
    day_ns = 24 * 3600 * 10**9
    doubt = Quality.of([Finding(code="walls", severity="poor", message="walls stand twice")])
    for start_ns, end_ns in ((20_000 * day_ns, 20_001 * day_ns), (5, day_ns), (None, None)):
        log = LogInfo("log", start_ns=start_ns, end_ns=end_ns)
        render_overview(ROOM, REGIONS, NOWHERE, UNLABELLED, [log], doubt, "floor_2")
    of_no_date = "frame floor_2,  quality: poor"
    assert said == [f"2024-10-04 to 2024-10-05,  {of_no_date}", of_no_date, of_no_date]


def test_a_link_leads_through_its_crossing_or_along_its_way_and_its_door_is_drawn() -> None:
    """Two rooms side by side; what links look like is a matter of symbols."""
    cells = np.full((40, 80), OCCUPIED, dtype=np.uint8)
    cells[2:38, 2:38], cells[2:38, 42:78], cells[15:25, 38:42] = FREE, FREE, FREE
    owner = np.where(cells == FREE, (np.arange(80) >= 40)[None, :] * 1, NOBODY)
    grid = GridMap(cells, 0.1)
    rooms = {
        k: Submap(id=k, map_from_submap=IDENTITY, grid=grid, anchor=(2.0 + 4.0 * k, 2.0))
        for k in (0, 1)
    }
    regions, bare = Regions.of(grid, owner), TopologicalMap(submaps=rooms, robot_radius_m=0.2)
    crossed = Edge(source=0, target=1, kind="closure", x=4.0, y=3.5)
    path = np.array([[2.0, 2.0], [2.0, 3.5], [3.5, 2.0], [6.0, 2.0]])
    way = Edge(source=0, target=1, kind="traversed", path=path, length_m=6.1, clearance_m=0.4)
    door = Door(id=0, x=4.0, y=2.0, width_m=1.0, theta=0.0, between=(0, 1))
    without, through, along_it, under = (
        render_segmentation(each, regions, LogInfo("plan"))
        for each in (
            bare,
            replace(bare, edges={(0, 1): crossed}),
            replace(bare, edges={(0, 1): way}, doors=(door,)),
            replace(bare, doors=(replace(door, x=2.0, width_m=0.2),)),
        )
    )
    for image, place, colour in (
        (through, (4.0, 3.5), palette.CLOSURE),
        (along_it, (2.0, 3.0), palette.TRAVERSED),
        (along_it, (4.0, 1.5), palette.DOOR),
    ):
        assert near(around(image, places_on(regions, [place])[0], 9), colour) > 4
        assert near(without[TITLE:-120], colour) == 0
    (badge,) = places_on(regions, [(2.0, 2.0)])
    assert near(around(under, badge, 40), palette.DOOR) > 4
    assert np.array_equal(around(under, badge, 10), around(without, badge, 10)), "the id is on top"


def test_a_link_without_a_way_is_no_line_that_one_could_take() -> None:
    for edge, drawn in (
        (Edge(source=0, target=1, kind="traversed"), "narrow"),
        (Edge(source=0, target=1, kind="seen"), "narrow"),
        (Edge(source=0, target=1, kind="closure"), "closure"),
    ):
        assert drawn_as(TopologicalMap(robot_radius_m=0.2), edge) == drawn
        assert drawn_as(TopologicalMap(), edge) == edge.kind


@given(st.integers(1, 12), seeds)
def test_badges_do_not_overlap(count: int, seed: int) -> None:
    centres = np.random.default_rng(seed).uniform(0, 120, (count, 2))
    moved = spread(centres, symbols.BADGE_GAP)
    gaps = [float(np.linalg.norm(a - b)) for a, b in itertools.combinations(moved, 2)]
    assert all(gap >= symbols.BADGE_GAP * 0.9 for gap in gaps)
    np.testing.assert_allclose(moved.mean(axis=0), centres.mean(axis=0), atol=1e-6)
    roomy = np.array([(symbols.BADGE_GAP * k, 5.0 * k) for k in range(count)])
    np.testing.assert_array_equal(spread(roomy, symbols.BADGE_GAP), roomy)


def test_the_end_of_the_way_hides_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    badge = Mock()
    monkeypatch.setattr(symbols, "badge", badge)
    driven(np.linspace((1.0, 1.0), (5.0, 1.0), 60))
    drawn_at = badge.call_args.args[1]
    driven(np.array([(1.0, 1.0), MIDDLE]))  # ends where the number would stand
    (end,) = places_on(REGIONS, [MIDDLE])
    assert np.linalg.norm(drawn_at - end) < 2.0
    assert np.linalg.norm(badge.call_args.args[1] - end) > symbols.BADGE_RADIUS + 9.0


def test_a_doubtful_place_is_marked_and_the_title_says_why() -> None:
    place = (2.0, 3.0)
    bent = Finding(code="walls-disagree", severity="poor", message="", where=Where(None, *place))
    aside = Finding(code="input", severity="note", message="odd", where=Where(None, 4.0, 3.0))
    way = np.linspace((1.0, 1.0), (5.0, 1.0), 60)
    good, poor = driven(way, aside), driven(way, aside, bent)
    assert near(around(poor, places_on(REGIONS, [place])[0], 20), palette.WRONG) > 50
    assert near(good[: TITLE + 1200], palette.WRONG) == 0
    assert (good[:TITLE] != poor[:TITLE]).any()


def test_a_way_to_the_end_of_the_world_takes_no_more_memory() -> None:
    tracemalloc.start()
    image = driven(np.array([(1.0, 1.0), (2.0, 1.0), (1e7, 1.0)]))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert is_framed(image)
    assert most < 200e6


@pytest.mark.parametrize("shape", [(20, 4000), (4000, 20), (5, 5), (900, 900)])
def test_any_extent_fits_the_sheet(shape: tuple[int, int]) -> None:
    topology, regions = one_room(shape)
    image = render_segmentation(topology, regions, LogInfo("a plan with a long name" * 9))
    assert max(image.shape) <= LONG_SIDE + 400
    assert near(image, palette.FILLS[0]) > 1000
    assert not inked(image[:, : MARGIN - 3]).any()
    assert not inked(image[:, 3 - MARGIN :]).any()
    assert is_framed(image)


def test_thin_walls_of_a_large_map_are_seen() -> None:
    _, regions = one_room((4000, 300))
    regions.grid.cells[:, 123] = OCCUPIED  # 5 cm in a map of 200 m
    sheet = Sheet(*extent_of(regions), ())
    sheet.ground(regions, {0: palette.FILLS[0]})
    wall = sheet.pixels(np.array([[123.5 * 0.05, y] for y in (20.0, 99.0, 180.0)])).astype(int)
    for x, y in wall.tolist():
        assert sheet.canvas.image[y, x - 1 : x + 2].max(axis=-1).min() < 160
        assert sheet.canvas.image[y, x - 8 : x - 3].max(axis=-1).min() > 160


@given(st.floats(0.5, 900.0), st.floats(0.5, 900.0), lengths, lengths)
def test_places_are_drawn_to_scale(width_m: float, height_m: float, x: float, y: float) -> None:
    low, high = np.array([x, y]), np.array([x + width_m, y + height_m])
    sheet = Sheet(low, high, ())
    (left, bottom), (right, top) = sheet.pixels(np.array([low, high]))
    scale = sheet.pixels_per_m
    assert (right - left, bottom - top) == pytest.approx((width_m * scale, height_m * scale))
    assert max(right - left, bottom - top) == pytest.approx(LONG_SIDE)
    height, width, _ = sheet.canvas.image.shape
    assert MARGIN <= left <= right <= width - MARGIN
    assert top + 1 >= TITLE
    assert bottom < height - MARGIN
    assert abs(left - (width - right)) <= 2  # in the middle


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-3.2, 7.7), (1e5, -1e5)])
def test_cells_have_their_colours_and_regions_a_border(origin: tuple[float, float]) -> None:
    cells = np.full((40, 60), FREE, dtype=np.uint8)
    cells[:, 30], cells[:20, 45:] = OCCUPIED, UNKNOWN
    owner = np.where(np.arange(40)[:, None] < 20, 0, 1) * np.ones((1, 60), dtype=np.int64)
    owner[:, 30:] = NOBODY
    regions = Regions(GridMap(cells, 0.1, origin), owner, {})
    sheet = Sheet(*extent_of(regions), ())
    sheet.ground(regions, {0: palette.FILLS[0], 1: palette.FILLS[1]})
    places = np.array([[1.5, 2.0], [1.5, 1.5], [3.05, 2.0], [3.8, 2.0], [5.2, 1.0]]) + origin
    border, *inside = sheet.pixels(places).astype(int)
    (x, y), image = border, sheet.canvas.image
    assert of_colour(image[y - 2 : y + 3, x - 1 : x + 2], palette.BORDER, 40).any()
    seen = [pixel(image, place) for place in inside]
    assert seen == [palette.FILLS[0], palette.INK, palette.SEEN, palette.PAPER]

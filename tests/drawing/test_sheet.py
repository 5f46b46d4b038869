"""Sheets: a map to scale, what its ground looks like, scale bar, legend, and pieces of a way."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.overview import render_segmentation
from specmap_cli.drawing.sheet import LONG_SIDE, MARGIN, TITLE, Sheet, Stroke, extent_of, strokes
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import LogInfo
from tests.drawing.looking import bounds, inked, is_framed, near, of_colour, one_room, pixel
from tests.strategies import grid_maps, lengths, seeds

EVERYTHING = symbols.legend_of(symbols.SYMBOLS)


def sheet_of(width_m: float, height_m: float, legend: symbols.Legend = ()) -> Sheet:
    return Sheet(np.zeros(2), np.array([width_m, height_m]), legend)


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


@given(grid_maps())
def test_the_extent_is_that_of_the_known_cells_if_there_are_any(grid: GridMap) -> None:
    regions = Regions(grid, np.full(grid.cells.shape, NOBODY), {})
    low, high = extent_of(regions)
    corners = [
        grid.origin + grid.resolution * np.array([column + i, row + i])
        for row, column in np.argwhere(grid.cells != UNKNOWN).tolist()
        for i in (0, 1)
    ]
    if corners:
        np.testing.assert_allclose([low, high], [np.min(corners, 0), np.max(corners, 0)])
    nothing = GridMap(np.full_like(grid.cells, UNKNOWN), 0.05, (3.0, -2.0))
    low, high = extent_of(Regions(nothing, regions.owner, {}))
    assert (low.tolist(), high.tolist()) == ([3.0, -2.0], [3.5, -1.5])  # half a metre is shown


@pytest.mark.parametrize("extent_m", [0.1, 0.5, 3.0, 17.0, 60.0, 300.0, 2750.0])
def test_the_scale_bar_has_a_round_length(extent_m: float) -> None:
    sheet = sheet_of(extent_m, extent_m)
    dark = of_colour(sheet.canvas.image[TITLE + sheet.map_height :], palette.INK, 0)
    top = int(np.argmax(dark[:, MARGIN]))
    length = int(np.argmin(dark[top, MARGIN:])) - 1
    length_m = length / sheet.pixels_per_m
    round_lengths = [n * 10.0**power for n in (1, 2, 5) for power in range(-4, 4)]
    assert min(abs(length_m / other - 1.0) for other in round_lengths) < 0.01
    assert 360 / 2.6 < length < 362
    assert not dark[:, :MARGIN].any()


@pytest.mark.parametrize(("width_m", "height_m"), [(1.0, 9.0), (5.0, 5.0), (9.0, 1.0)])
def test_the_legend_lies_below_and_entries_do_not_touch(width_m: float, height_m: float) -> None:
    bare, full = sheet_of(width_m, height_m), sheet_of(width_m, height_m, EVERYTHING)
    assert full.map_height == bare.map_height
    below = inked(full.canvas.image)
    left, right, top, bottom = bounds(below)
    assert top > TITLE + full.map_height
    assert left >= MARGIN - 4
    assert right <= full.canvas.image.shape[1] - MARGIN
    assert bottom < full.canvas.image.shape[0] - 10
    for colour in (palette.TRAVERSED, palette.CLOSURE, palette.LOOSE, palette.SEEN):
        assert near(full.canvas.image, colour) > 80
        assert near(bare.canvas.image, colour) < 40  # the rims of letters
    starts = np.flatnonzero(np.diff(below.any(axis=1).astype(int)) == 1) + 1
    lines = [below[start : start + 16].any(axis=0) for start in starts[1:]]  # below the scale bar
    gaps = [np.diff(np.flatnonzero(line)) for line in lines]
    assert sum(1 + int((each > 30).sum()) for each in gaps) >= len(EVERYTHING)


def test_drawing_the_ground_takes_little_more_than_the_canvas() -> None:
    """It would else be what a small map needs most memory for."""
    _, regions = one_room((300, 300))
    sheet = Sheet(*extent_of(regions), ())
    tracemalloc.start()
    sheet.ground(regions, {0: palette.FILLS[0]})
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    pixels = sheet.canvas.image.size // 3
    assert peak < 32 * pixels  # all colours of all pixels as float64, twice, would be 48


def way(steps_m: list[float]) -> FloatArray:
    """Places (n + 1, 2) along a line, so far from one to the next."""
    return np.column_stack([np.cumsum([0.0, *steps_m]), np.zeros(len(steps_m) + 1)])


@given(seeds, st.integers(1, 60))
def test_strokes_are_the_runs_between_jumps(seed: int, count: int) -> None:
    """Against a walk from scan to scan."""
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 3, count)
    jumps = rng.random(count - 1) < 0.05
    places = way(np.where(jumps, 40.0, 0.1).tolist())
    assume(jumps.sum() <= 0.08 * count)  # more of them would be usual steps
    expected, first = [], 0
    for k in range(1, count + 1):
        if k == count or jumps[k - 1] or labels[k] != labels[k - 1]:
            goes_on = k < count and not jumps[k - 1]
            expected.append(Stroke(first, k, k + 1 if goes_on else k))
            first = k
    assert strokes(places, labels) == expected

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import NO_SUBMAP, Labels, Trajectory
from specmap_cli.drawing import palette, symbols
from specmap_cli.drawing.canvas import Canvas, text_width
from specmap_cli.drawing.confusion import render_confusion
from specmap_cli.drawing.overview import render_overview, render_segmentation, spread
from specmap_cli.drawing.predictions import render_labels
from specmap_cli.drawing.sheet import LONG_SIDE, MARGIN, TITLE, Sheet, extent_of
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.maps.store import MapResult
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import LogInfo, Submap, TopologicalMap


def near(image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], colour: palette.Colour) -> int:
    """Pixels of about that colour."""
    return int((np.abs(image.astype(int) - colour).max(axis=-1) <= 3).sum())


def one_room(shape: tuple[int, int]) -> tuple[TopologicalMap, Regions]:
    cells = np.full(shape, OCCUPIED, dtype=np.uint8)
    cells[1:-1, 1:-1] = FREE
    grid = GridMap(cells, 0.05)
    topology = TopologicalMap({0: Submap(0, Pose2(0.0, 0.0, 0.0), [], [], grid)})
    return topology, Regions.of(grid, np.where(cells == FREE, 0, NOBODY))


class TestColours:
    @settings(max_examples=40, derandomize=True)
    @given(st.integers(2, 40), st.integers(0, 1000))
    def test_neighbours_on_a_ring_with_chords_differ_strongly(self, count: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        chords = {(0, int(i)) for i in rng.integers(2, count + 1, 3) if i < count}
        pairs = {(i, i + 1) for i in range(count - 1)} | chords
        fills = palette.colour_graph(range(count), pairs)
        far = {
            (palette.FILLS[i], palette.FILLS[j])
            for i, j in np.argwhere(palette.fill_distances() >= palette.DISTINCT).tolist()
        }
        assert all((fills[a], fills[b]) in far for a, b in pairs)

    def test_many_submaps_without_links_use_all_colours(self) -> None:
        fills = palette.colour_graph(range(len(palette.FILLS)), [])
        assert sorted(fills.values()) == sorted(palette.FILLS)

    def test_more_neighbours_than_colours(self) -> None:
        pairs = itertools.combinations(range(20), 2)
        assert len(palette.colour_graph(range(20), pairs)) == 20

    def test_regions_across_a_wall_are_neighbours(self) -> None:
        owner = np.full((6, 20), NOBODY)
        owner[:, :5], owner[:, 8:12], owner[:, 19] = 0, 4, 2
        assert palette.touching(owner, 4) == {(0, 4)}
        assert palette.touching(owner, 8) == {(0, 4), (2, 4)}

    def test_shades(self) -> None:
        for fill in palette.FILLS:
            assert max(sum(palette.darker(fill)), sum(palette.vivid(fill))) < sum(fill)
            assert sum(fill) < sum(palette.paler(fill)) < 3 * 255


class TestOverview:
    def test_shows_what_it_should(self, result: MapResult) -> None:
        regions = result.regions
        image = render_overview(
            result.topology, regions, result.trajectory, result.labels, result.log
        )
        fills = palette.colours_of(result.topology, regions)
        assert len(set(fills.values())) == 3
        for id_, fill in fills.items():
            share = near(image, fill) / near(image, fills[0])
            area = regions.outline(id_).area_m2 / regions.outline(0).area_m2
            assert share == pytest.approx(area, rel=0.15)
        assert near(image, palette.TRAVERSED) > 100
        assert near(image, palette.CLOSURE) > 100
        assert near(image, palette.LOOSE) == 0

    def test_the_same_picture_every_time(self, result: MapResult) -> None:
        pictures = [
            render_overview(
                result.topology, result.regions, result.trajectory, result.labels, result.log
            )
            for _ in range(2)
        ]
        assert (pictures[0] == pictures[1]).all()

    @pytest.mark.parametrize("shape", [(20, 4000), (4000, 20), (5, 5), (2400, 2400)])
    def test_any_extent_fits_the_sheet(self, shape: tuple[int, int]) -> None:
        topology, regions = one_room(shape)
        image = render_segmentation(topology, regions, LogInfo("a plan with a long name" * 9))
        assert 1100 <= image.shape[1] <= LONG_SIDE + 2 * MARGIN
        assert image.shape[0] <= LONG_SIDE + 400
        assert near(image, palette.FILLS[0]) > 0

    def test_walls_of_one_cell_stay_visible_however_far_it_shrinks(self) -> None:
        topology, regions = one_room((5000, 5000))
        image = render_segmentation(topology, regions, LogInfo("plan"))
        row = image[TITLE + LONG_SIDE // 3].astype(int).sum(axis=-1)
        assert (row < 300).sum() >= 2

    def test_nothing_known(self) -> None:
        grid = GridMap(np.full((4, 4), UNKNOWN, dtype=np.uint8), 0.05)
        empty = Regions.of(grid, np.full((4, 4), NOBODY))
        nowhere = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        unlabelled = Labels(nowhere.stamps_ns, nowhere.poses, nowhere.stamps_ns)
        image = render_overview(TopologicalMap(), empty, nowhere, unlabelled, LogInfo("empty"))
        assert image.shape[2] == 3

    def test_places_lie_where_the_ground_was_painted(self) -> None:
        _, regions = one_room((40, 60))
        sheet = Sheet(*extent_of(regions), [])
        sheet.ground(regions, {0: palette.FILLS[3]})
        inner, wall = np.array([[0.1, 0.1], [2.9, 1.9]]), np.array([[0.025, 1.0], [2.975, 1.0]])
        for points, colour in ((inner, palette.FILLS[3]), (wall, palette.INK)):
            for x, y in sheet.pixels(points).astype(int):
                assert sheet.canvas.image[y, x].astype(int) == pytest.approx(colour, abs=8)

    @settings(max_examples=30, derandomize=True)
    @given(st.integers(1, 12), st.integers(0, 1000))
    def test_badges_do_not_overlap(self, count: int, seed: int) -> None:
        centres = np.random.default_rng(seed).uniform(0, 120, (count, 2))
        moved = spread(centres, symbols.BADGE_GAP)
        gaps = [float(np.linalg.norm(a - b)) for a, b in itertools.combinations(moved, 2)]
        assert all(gap >= symbols.BADGE_GAP * 0.9 for gap in gaps)

    def test_badges_with_room_stay(self) -> None:
        centres = np.array([(0.0, 0.0), (90.0, 0.0)])
        assert (spread(centres, symbols.BADGE_GAP) == centres).all()


class TestPredictions:
    def test_each_scan_has_the_colour_of_its_submap(self, result: MapResult) -> None:
        regions = result.regions
        labels = result.labels
        image = render_labels(
            labels.poses, labels.submaps, "t", map_with_regions=(result.topology, regions)
        )
        for fill in palette.colours_of(result.topology, regions).values():
            assert near(image, palette.vivid(fill)) > 50
        assert near(image, palette.WRONG) == 0

    def test_wrong_ones_are_marked_and_unknown_ones_are_not_wrong(self, result: MapResult) -> None:
        said = result.labels.submaps.copy()
        said[3:7], said[13:17] = 2, NO_SUBMAP
        image = render_labels(result.labels.poses, said, "t", truth=result.labels.submaps)
        once = near(image, palette.WRONG)
        said[13:17] = 1
        again = render_labels(result.labels.poses, said, "t", truth=result.labels.submaps)
        assert once == near(again, palette.WRONG) > 50

    def test_scans_without_a_place_are_left_out(self, result: MapResult) -> None:
        places = result.labels.poses.copy()
        places[5:25] = np.nan
        assert render_labels(places, result.labels.submaps, "t").shape[2] == 3
        assert render_labels(places[5:6], result.labels.submaps[5:6], "t").shape[2] == 3


class TestConfusion:
    def test_right_and_wrong(self) -> None:
        image = render_confusion(np.array([[9, 1, 0], [0, 10, 0]]), ["0", "1"], ["0", "1", "?"])
        assert near(image, palette.TRAVERSED) > 500  # all of row 1
        assert near(image, palette.SHADE) > 500

    @pytest.mark.parametrize("size", [0, 1, 150])
    def test_any_size(self, size: int) -> None:
        names = [f"submap {i}" for i in range(size)]
        image = render_confusion(np.eye(size) * 3, names)
        assert max(image.shape) < 3000

    def test_names_must_fit(self) -> None:
        with pytest.raises(ValueError, match="2 rows, 3 columns"):
            render_confusion(np.zeros((2, 2)), ["a", "b"], ["a", "b", "c"])


class TestCanvas:
    def test_dashes_have_gaps_and_reach_the_end(self) -> None:
        canvas = Canvas(220, 20)
        canvas.dashes(np.array([[10.0, 10.0], [200.0, 10.0]]), palette.INK, 3, 20.0, 20.0)
        dark = canvas.image[10, :, 0] < 128
        assert np.count_nonzero(np.diff(dark.astype(int)) == 1) == 5
        assert 85 <= np.count_nonzero(dark) <= 125

    def test_text_is_as_wide_as_it_says(self) -> None:
        canvas = Canvas(400, 60)
        canvas.text(390, 30, "42 rooms", 20, anchor="right")
        columns = np.flatnonzero((canvas.image < 128).any(axis=(0, 2)))
        assert columns[-1] <= 390
        assert columns[-1] - columns[0] == pytest.approx(text_width("42 rooms", 20), abs=6)

    def test_drawing_outside_is_cut_off(self) -> None:
        canvas = Canvas(30, 30)
        canvas.line(np.array([[-1e9, 5.0], [1e9, 5.0]]), palette.INK, 2)
        canvas.upright_text(2, 10, "much too long for this", 12)
        assert canvas.image.shape == (30, 30, 3)
        assert (canvas.image[5] < 128).any()


def test_a_jump_is_not_drawn_as_a_way(result: MapResult) -> None:
    """The robot was lost and turned up elsewhere: no line leads there."""
    poses = np.zeros((40, 3))
    poses[:20, 0], poses[20:, 0] = np.linspace(-5, -4, 20), np.linspace(4, 5, 20)
    stamps = np.arange(40)
    nowhere = Trajectory(stamps[:0], poses[:0])
    lost = Trajectory(stamps, poses)
    driven = Trajectory(stamps, np.linspace((-5.0, 0, 0), (5, 0, 0), 40))
    only = dataclasses.replace(result.topology, submaps={0: result.topology.submaps[0]}, edges={})
    none, broken, whole = (
        render_overview(only, result.regions, path, result.labels, result.log)[TITLE:]
        for path in (nowhere, lost, driven)
    )
    assert 100 < (broken != none).sum() < (whole != none).sum() / 2

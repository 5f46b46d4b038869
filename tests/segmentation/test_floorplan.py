"""Submaps of finished maps, and what is drawn of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage

from specmap_cli.core.errors import NoResultError
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.drawing.split_tests import draw_segmentation
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.segmentation.division import segment_floorplan, submap_grid

CONFIG = SegmentationConfig()
PlanBuilder = Callable[..., GridMap]


def test_two_rooms_are_two_submaps(two_rooms: GridMap) -> None:
    result = segment_floorplan(two_rooms, CONFIG)
    assert [submap.id for submap in result.submaps] == [0, 1]
    assert result.submaps[0].area_m2 == pytest.approx(20.1, abs=0.2)
    assert result.submaps[0].centroid == pytest.approx((2.8, 2.3), abs=0.1)


def test_polygons_enclose_their_regions(office: GridMap) -> None:
    for submap in segment_floorplan(office, CONFIG).submaps:
        area = cv2.contourArea(submap.polygon.astype(np.float32))
        assert area == pytest.approx(submap.area_m2, rel=0.06)


def test_the_grid_of_a_submap_is_its_region_where_it_lies(two_rooms: GridMap) -> None:
    moved = GridMap(two_rooms.cells, 0.05, (-3.0, 7.0))
    result = segment_floorplan(moved, CONFIG)
    for submap in result.submaps:
        grid = submap_grid(result, submap.id)
        assert grid.free_area_m2 == pytest.approx(submap.area_m2)
        assert (grid.cells == OCCUPIED).any()
        inside = grid.values_at(np.array([submap.centroid]))
        assert inside[0] == FREE
        other = result.submaps[1 - submap.id].centroid
        assert grid.values_at(np.array([other]))[0] == UNKNOWN


def test_a_map_without_room_for_a_node_says_so() -> None:
    cells = np.full((40, 40), OCCUPIED, dtype=np.uint8)
    cells[5:8] = FREE
    with pytest.raises(NoResultError) as caught:
        segment_floorplan(GridMap(cells, 0.05), CONFIG)
    assert str(caught.value) == (
        "no free space wider than 0.5 m in the map (0.3 m2 free): "
        "check the resolution and the thresholds"
    )


def test_a_divided_map_is_drawn(office: GridMap, tmp_path: Path) -> None:
    found = segment_floorplan(office, CONFIG).segmentation
    picture = draw_segmentation(office, found, CONFIG.eigenvalue_min)
    assert cv2.imwrite(str(tmp_path / "nodes.png"), picture)
    hues = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    coloured = hues[hues[..., 1] > 150][:, 0]
    assert len(np.unique(coloured)) >= found.count


def test_the_parts_of_a_result_agree(office: GridMap) -> None:
    result = segment_floorplan(office, CONFIG)
    labels = result.segmentation.labels
    assert [submap.id for submap in result.submaps] == list(range(result.segmentation.count))
    cell_m2 = office.resolution**2
    for submap in result.submaps:
        region = labels == submap.id
        assert submap.area_m2 == pytest.approx(region.sum() * cell_m2)
        assert ndimage.label(region, np.ones((3, 3)))[1] == 1
        cells = office.cells_of(submap.polygon)
        near = ndimage.binary_dilation(region, np.ones((3, 3)))
        assert near[cells[:, 0], cells[:, 1]].all()


def test_the_grids_of_all_submaps_show_all_that_is_labelled(office: GridMap) -> None:
    result = segment_floorplan(office, CONFIG)
    labelled = office.centres_of(np.argwhere((result.segmentation.labels >= 0) & office.free))
    seen = np.zeros(len(labelled), dtype=int)
    for submap in result.submaps:
        grid = submap_grid(result, submap.id)
        seen += grid.values_at(labelled) == FREE
        walls = grid.centres_of(np.argwhere(grid.occupied))
        assert (office.values_at(walls) == OCCUPIED).all()
        region = office.centres_of(np.argwhere(result.segmentation.labels == submap.id))
        low, high = region.min(axis=0), region.max(axis=0)
        assert (walls >= low - 0.11).all()  # no more than two cells of wall round it
        assert (walls <= high + 0.11).all()
    assert (seen == 1).all()


def test_of_a_region_in_scraps_the_largest_stays() -> None:
    cells = np.full((120, 200), OCCUPIED, dtype=np.uint8)
    cells[10:110, 10:110] = FREE
    cells[58:62, 110:150] = FREE  # a slit into a closet that is too small for a node
    cells[55:65, 150:160] = FREE
    wide = CONFIG.model_copy(update={"labels": "nearest", "fill": False})
    result = segment_floorplan(GridMap(cells, 0.05), wide)
    (room,) = result.submaps
    assert ndimage.label(result.segmentation.labels == 0, np.ones((3, 3)))[1] == 1
    assert room.area_m2 >= 25.0

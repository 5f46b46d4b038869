"""Submaps and doorways of finished maps, and what is drawn of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli.core.config import SegmentationConfig
from specmap_cli.core.errors import NoResultError
from specmap_cli.drawing.split_tests import draw_segmentation
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.segmentation.floorplan import label_image, segment_floorplan, submap_grid

CONFIG = SegmentationConfig()
PlanBuilder = Callable[..., GridMap]


def test_two_rooms_touch_at_their_door(two_rooms: GridMap) -> None:
    result = segment_floorplan(two_rooms, CONFIG)
    assert [submap.id for submap in result.submaps] == [0, 1]
    assert result.submaps[0].area_m2 == pytest.approx(20.1, abs=0.2)
    assert result.submaps[0].centroid == pytest.approx((2.8, 2.3), abs=0.1)
    (edge,) = result.edges
    assert (edge.source, edge.target) == (0, 1)
    (door,) = edge.doorways
    assert (door.x, door.y) == pytest.approx((5.4, 1.95), abs=0.15)
    assert door.width_m == pytest.approx(0.9, abs=0.1)


def test_polygons_enclose_their_regions(office: GridMap) -> None:
    for submap in segment_floorplan(office, CONFIG).submaps:
        area = cv2.contourArea(submap.polygon.astype(np.float32))
        assert area == pytest.approx(submap.area_m2, rel=0.06)


def test_every_room_of_an_office_touches_the_corridor_once(office: GridMap) -> None:
    result = segment_floorplan(office, CONFIG)
    corridor = int(result.segmentation.labels[round(5.5 / 0.05), round(7.0 / 0.05)])
    assert len(result.edges) == 6
    for edge in result.edges:
        assert corridor in (edge.source, edge.target)
        assert [door.width_m for door in edge.doorways] == [pytest.approx(0.9, abs=0.11)]


def test_two_doors_between_two_rooms_are_one_edge(plan: PlanBuilder) -> None:
    rooms = (0.3, 0.3, 5.3, 6.3), (5.5, 0.3, 9.5, 6.3)
    doors = (5.3, 0.8, 5.5, 1.7), (5.3, 4.4, 5.5, 5.1)
    (edge,) = segment_floorplan(plan(9.8, 6.6, *rooms, *doors), CONFIG).edges
    assert [door.width_m for door in edge.doorways] == pytest.approx([0.9, 0.7], abs=0.11)
    assert [door.y for door in edge.doorways] == pytest.approx([1.25, 4.75], abs=0.11)


def test_contacts_too_narrow_for_a_door_make_no_edge(two_rooms: GridMap) -> None:
    wide_only = CONFIG.model_copy(update={"door_min_m": 1.5})
    assert segment_floorplan(two_rooms, wide_only).edges == []


def test_the_label_picture_is_upright_and_counts_from_one(office: GridMap) -> None:
    result = segment_floorplan(office, CONFIG)
    picture = label_image(result)
    assert picture.dtype == np.uint16
    assert picture.shape == office.cells.shape
    np.testing.assert_array_equal(picture[::-1].astype(int) - 1, result.segmentation.labels)


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
    with pytest.raises(NoResultError, match="no free space wider than"):
        segment_floorplan(GridMap(cells, 0.05), CONFIG)


def test_a_divided_map_is_drawn(office: GridMap, tmp_path: Path) -> None:
    found = segment_floorplan(office, CONFIG).segmentation
    picture = draw_segmentation(office, found, CONFIG.eigenvalue_min)
    assert cv2.imwrite(str(tmp_path / "nodes.png"), picture)
    hues = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    coloured = hues[hues[..., 1] > 150][:, 0]
    assert len(np.unique(coloured)) >= found.count

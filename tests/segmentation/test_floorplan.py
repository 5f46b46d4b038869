"""Submaps of finished maps, and what is drawn of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from specmap_cli.core.errors import NoResultError
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.segmentation.division import region_grid, segment_floorplan

CONFIG = SegmentationConfig()


def test_a_map_without_room_for_a_node_says_so() -> None:
    cells = np.full((40, 40), OCCUPIED, dtype=np.uint8)
    cells[5:8] = FREE
    with pytest.raises(NoResultError) as caught:
        segment_floorplan(GridMap(cells, 0.05), CONFIG)
    assert str(caught.value) == (
        "no free space wider than 0.5 m in the map (0.3 m2 free): "
        "check the resolution and the thresholds"
    )


def test_the_grids_of_all_regions_show_all_that_is_labelled_where_it_lies(office: GridMap) -> None:
    moved = GridMap(office.cells, office.resolution, (-3.0, 7.0))
    found = segment_floorplan(moved, CONFIG)
    assert found.count == 7
    labelled = moved.centres_of(np.argwhere((found.labels >= 0) & moved.free))
    seen = np.zeros(len(labelled), dtype=int)
    for number in range(found.count):
        region = found.labels == number
        assert ndimage.label(region, np.ones((3, 3)))[1] == 1
        grid = region_grid(moved, region)
        seen += grid.values_at(labelled) == FREE
        walls = grid.centres_of(np.argwhere(grid.occupied))
        assert (moved.values_at(walls) == OCCUPIED).all()
        places = moved.centres_of(np.argwhere(region))
        assert (walls >= places.min(axis=0) - 0.11).all()  # no more than two cells of wall round it
        assert (walls <= places.max(axis=0) + 0.11).all()
    assert (seen == 1).all()


def test_of_a_region_in_scraps_the_largest_stays() -> None:
    cells = np.full((120, 200), OCCUPIED, dtype=np.uint8)
    cells[10:110, 10:110] = FREE
    cells[58:62, 110:150] = FREE  # a slit into a closet that is too small for a node
    cells[55:65, 150:160] = FREE
    wide = CONFIG.model_copy(update={"labels": "nearest", "fill": False})
    found = segment_floorplan(GridMap(cells, 0.05), wide)
    assert found.count == 1
    assert ndimage.label(found.labels == 0, np.ones((3, 3)))[1] == 1
    assert (found.labels == 0).sum() >= 10_000

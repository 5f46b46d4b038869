from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.geometry import Pose2
from specmap_cli.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.outputs.grids import lay_out
from specmap_cli.outputs.regions import NOBODY, Regions, divide
from specmap_cli.outputs.shape import outline
from specmap_cli.outputs.store import MapResult
from specmap_cli.outputs.tables import Labels
from specmap_cli.topomap import Submap


def grid_of(picture: list[str], resolution: float = 0.5) -> GridMap:
    """Free cells where a `.` is, the first line being the highest y."""
    cells = [[FREE if letter == "." else UNKNOWN for letter in line] for line in picture[::-1]]
    return GridMap(np.array(cells, dtype=np.uint8), resolution, (10.0, -4.0))


def area(polygon: NDArray[Any]) -> float:
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def test_a_rectangle() -> None:
    grid = GridMap(np.full((20, 30), FREE, dtype=np.uint8), 0.1, (1.0, 2.0))
    shape = outline(grid)
    assert shape.area_m2 == pytest.approx(6.0)
    assert len(shape.polygon) == 4
    assert area(shape.polygon) == pytest.approx(6.0, rel=0.06)  # counter-clockwise: positive
    assert shape.polygon.min(axis=0) == pytest.approx((1.0, 2.0), abs=0.05)
    assert shape.polygon.max(axis=0) == pytest.approx((4.0, 4.0), abs=0.05)
    assert shape.centroid == pytest.approx((2.5, 3.0), abs=0.06)


def test_the_centroid_lies_inside_an_l() -> None:
    shape = outline(grid_of(["...     ", "...     ", "...     ", "........", "........"]))
    assert shape.centroid is not None
    inside = cv2.pointPolygonTest(
        shape.polygon.astype(np.float32), tuple(shape.centroid.tolist()), False
    )
    assert inside > 0


def test_the_polygon_is_that_of_the_largest_part() -> None:
    shape = outline(grid_of(["....  .", "....   ", "      ."]))
    assert shape.area_m2 == pytest.approx(10 * 0.25)
    assert shape.polygon[:, 0].max() < 12.1
    assert shape.polygon[:, 1].min() > -3.6


@pytest.mark.parametrize("picture", [["."], ["...."], [".", "."]])
def test_thin_regions_keep_an_area(picture: list[str]) -> None:
    shape = outline(grid_of(picture))
    assert len(shape.polygon) >= 3
    assert area(shape.polygon) > 0


def test_nothing_free() -> None:
    shape = outline(grid_of(["  ", "  "]))
    assert (len(shape.polygon), shape.centroid, shape.area_m2) == (0, None, 0.0)


def test_shared_cells_go_to_the_nearest_keyframe() -> None:
    grid = GridMap(np.full((4, 10), FREE, dtype=np.uint8), 1.0)
    here = Pose2(0.0, 0.0, 0.0)
    submaps = [Submap(3, here, [0], [], grid), Submap(5, here, [1], [], grid)]
    poses = np.array([(1.5, 1.5, 0.0), (8.5, 1.5, 0.0)])
    labels = Labels(np.array([1, 2]), poses, np.array([3, 5]))
    regions = divide(grid, submaps, labels)
    assert (regions.owner[:, :5] == 3).all()
    assert (regions.owner[:, 5:] == 5).all()
    assert {id_: shape.area_m2 for id_, shape in regions.outlines.items()} == {3: 20.0, 5: 20.0}


def test_every_free_cell_of_the_layout_has_an_owner_who_saw_it(result: MapResult) -> None:
    submaps = result.topology.submaps
    whole = lay_out(submaps.values())
    regions = divide(whole, submaps.values(), result.labels)
    assert ((regions.owner != NOBODY) == whole.free).all()
    for id_, submap in submaps.items():
        cells = np.argwhere(regions.owner == id_)
        seen = submap.map_from_submap.inverse().apply(whole.centres_of(cells))
        assert (submap.grid.values_at(seen) == FREE).all()


def test_a_region_without_a_cell_has_no_outline() -> None:
    grid = GridMap(np.full((2, 2), FREE, dtype=np.uint8), 1.0)
    regions = Regions.of(grid, np.array([[0, 0], [NOBODY, 2]]))
    assert sorted(regions.outlines) == [0, 2]
    assert regions.outline(1).centroid is None

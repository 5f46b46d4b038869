"""Rings of corridors are cut into their sides; halls with pillars, and corridors, are none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import OCCUPIED, GridMap
from specmap_cli.segmentation.division import open_rings, segment
from specmap_cli.segmentation.visibility import LabelArray
from tests.segmentation.plans import plan, turned_by

TURNS = (0.0, 20.0, 45.0, 90.0)


def without_rings(labels: LabelArray) -> LabelArray:
    """The same regions, those that are rings opened."""
    found = labels.copy()
    open_rings(found)
    return found


def ring(width: float, height: float) -> GridMap:
    """A corridor round a solid core; it begins at (5, 5)."""
    wide = 1.6
    right, top = 5.0 + width + 2 * wide, 5.0 + height + 2 * wide
    return plan(
        *(right + 5.0, top + 5.0),
        *((5.0, 5.0, right, 5.0 + wide), (5.0, top - wide, right, top)),
        *((5.0, 5.0, 5.0 + wide, top), (right - wide, 5.0, right, top)),
    )


def hall(width: float, height: float, side: float, *pillars: tuple[float, float]) -> GridMap:
    """One room from (0.5, 0.5) on, with square pillars that begin at the places given."""
    grid = plan(width + 1.0, height + 1.0, (0.5, 0.5, width + 0.5, height + 0.5))
    for x, y in pillars:
        rows, columns = (slice(round(n / 0.05), round((n + side) / 0.05)) for n in (y, x))
        grid.cells[rows, columns] = OCCUPIED
    return grid


def divided(grid: GridMap, degrees: float, places: list[tuple[float, float]]) -> list[int]:
    """The number of regions of a map that lies turned, and which ones hold places in metres."""
    turned = turned_by(degrees, grid)
    found = segment(turned, SegmentationConfig())
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    middles = [np.array(one.cells.shape[::-1]) / 2 for one in (grid, turned)]
    at = np.array(places) / 0.05 - middles[0]
    at = at @ np.array([[cosine, -sine], [sine, cosine]]) + middles[1]
    return [found.count, *(int(found.labels[round(y), round(x)]) for x, y in at.tolist())]


@pytest.mark.parametrize("degrees", TURNS)
@pytest.mark.parametrize(("width", "height"), [(12.0, 8.0), (8.0, 12.0), (30.0, 24.0)])
def test_the_long_sides_of_a_ring_have_corners(width: float, height: float, degrees: float) -> None:
    x, y = ((5.8, side / 2 + 6.6, side + 7.4) for side in (width, height))
    sides = [(x[1], y[0]), (x[1], y[2]), (x[0], y[1]), (x[2], y[1])]
    corners = [(x[0], y[0]), (x[2], y[0]), (x[0], y[2]), (x[2], y[2])]
    count, low, high, left, right, *found = divided(ring(width, height), degrees, sides + corners)
    assert count == 4
    assert len({low, high, left, right}) == 4
    along = [low, low, high, high] if width > height else [left, right, left, right]
    assert found == along


@pytest.mark.parametrize("degrees", TURNS[:3])
@pytest.mark.parametrize(
    "grid",
    [
        hall(14.0, 10.0, 1.0, *((x, y) for x in (3.0, 6.5, 10.0) for y in (3.0, 7.0))),
        hall(12.0, 12.0, 3.0, (5.0, 5.0)),
        hall(8.0, 7.0, 2.6, (3.2, 2.7)),
        ring(4.2, 4.2),
        plan(20.0, 16.0, (1, 1, 19, 3), (1, 1, 3, 15), (17, 1, 19, 15)),  # open at one side
    ],
    ids=["pillars", "core", "island", "lobby", "horseshoe"],
)
def test_halls_round_little_and_open_corridors_stay_whole(grid: GridMap, degrees: float) -> None:
    assert divided(grid, degrees, [(1.5, 1.5)])[0] == 1


def test_corridors_round_two_courts_are_seven() -> None:
    cross = [(1, 1, 33, 3), (1, 17, 33, 19), (1, 1, 3, 19), (31, 1, 33, 19), (16, 1, 18, 19)]
    assert segment(plan(34.0, 20.0, *cross), SegmentationConfig()).count == 7


def around(core: int, wide: int) -> LabelArray:
    """Cells of a region round a square, in the middle of some that have no label."""
    labels = np.full((core + 2 * wide + 20, core + 2 * wide + 60), -1, dtype=np.int32)
    labels[10:-10, 10 : core + 2 * wide + 10] = 0
    labels[10 + wide : -10 - wide, 10 + wide : core + wide + 10] = -1
    return labels


def test_a_ring_goes_round_more_than_it_holds() -> None:
    assert len(np.unique(without_rings(around(48, 10)))) == 2  # 68^2 with the floor, 2 x 48^2
    assert len(np.unique(without_rings(around(49, 10)))) == 5


def test_no_cell_is_lost_and_what_lies_beside_a_ring_keeps_its_label() -> None:
    labels = around(60, 10)
    labels[0:5, 0:5] = 1  # another region
    labels[45:50, 95:99] = 0  # a scrap of the ring
    found = without_rings(labels)
    np.testing.assert_array_equal(found < 0, labels < 0)
    assert (found[0:5, 0:5] == 1).all()
    assert (found[45:50, 95:99] == 0).all()
    assert np.unique(found).tolist() == [-1, 0, 1, 2, 3, 4]
    sizes = np.sort(np.bincount(found[10:90, 10:90][labels[10:90, 10:90] == 0]))[1:]
    np.testing.assert_allclose(sizes, [600, 600, 800, 800], atol=20)  # a cut is one cell wide


def test_corridors_that_go_on_and_pillars_move_no_cut() -> None:
    plain = around(60, 10)
    expected = without_rings(plain)
    more = plain.copy()
    more[10:22, 90:] = 0  # a corridor goes on, wider by two cells than the ring is
    more[14:18, 12:17] = -1  # a pillar in a corner
    more[26:29, 12:17] = -1  # and one below it
    found = without_rings(more)
    ours = (plain >= 0) & (more >= 0)
    pairs = np.unique(found[ours] * 10 + expected[ours], return_counts=True)[1]
    assert np.sort(pairs)[-4:].sum() >= ours.sum() - 4 * 10  # cells of the cuts


@pytest.mark.parametrize("turns", range(4))
def test_a_ring_is_cut_alike_however_it_is_turned(turns: int) -> None:
    labels = around(60, 10)[:, 5:]
    labels[20:24, 20:70] = 0  # its hole is wider than high
    found, turned = np.rot90(without_rings(labels), turns), np.rot90(labels, turns)
    for one, other in ((found, turned), (found[::-1], turned[::-1])):
        pairs = np.unique(one * 10 + without_rings(other), return_counts=True)[1]
        assert np.sort(pairs)[-5:].sum() >= labels.size - 4 * 10  # cells of the cuts

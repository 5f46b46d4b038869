"""Nodes, sight lines, flooding, merging and clutter on small grids with known answers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.clutter import small_obstacles, working_grid
from specmap_cli.segmentation.flood import flood_labels, nearest_labels, spread_labels
from specmap_cli.segmentation.merging import border_widths, join_wide, local_widths
from specmap_cli.segmentation.visibility import near_pairs, sample_nodes, visible

seeds = st.integers(0, 10_000)


def clearance_of(free: BoolArray) -> FloatArray:
    padded = np.pad(free.astype(np.uint8), 1)
    return np.asarray(
        cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1], np.float64
    )


def dumbbell() -> BoolArray:
    """Rooms of 30 x 30 and 30 x 40 cells, joined by a passage of 6 x 9."""
    free = np.zeros((40, 90), dtype=bool)
    free[5:35, 5:35] = free[5:35, 41:81] = free[15:24, 35:41] = True
    return free


def cluttered(seed: int) -> BoolArray:
    free = np.zeros((60, 70), dtype=bool)
    free[2:-2, 2:-2] = True
    rng = np.random.default_rng(seed)
    for row, column in rng.integers(4, 50, (12, 2)):
        free[row : row + rng.integers(1, 9), column : column + rng.integers(1, 9)] = False
    return free


def test_a_node_stands_where_its_block_is_clearest() -> None:
    clearance = clearance_of(dumbbell())
    for row, column in sample_nodes(clearance, 7, 2.5, "clearest"):
        block = clearance[row // 7 * 7 : row // 7 * 7 + 7, column // 7 * 7 : column // 7 * 7 + 7]
        assert clearance[row, column] == block.max() > 2.5


def test_centre_nodes_stand_in_the_middle_of_free_blocks() -> None:
    nodes = sample_nodes(clearance_of(dumbbell()), 5, 0.0, "centre")
    assert (nodes % 5 == 2).all()
    assert dumbbell()[nodes[:, 0], nodes[:, 1]].all()


def test_near_pairs_are_all_pairs_in_reach() -> None:
    nodes = np.random.default_rng(0).integers(0, 40, (30, 2))
    distance = np.hypot(*(nodes[:, None] - nodes[None]).transpose(2, 0, 1))
    expected = np.argwhere(np.triu(distance <= 10.0, k=1))
    np.testing.assert_array_equal(near_pairs(nodes, 10.0), expected)
    assert near_pairs(nodes[:1], 10.0).shape == (0, 2)


@given(seed=seeds)
def test_sight_lines_are_those_of_a_cell_by_cell_check(seed: int) -> None:
    clearance = clearance_of(cluttered(seed))
    nodes = sample_nodes(clearance, 7, 1.5, "clearest")
    pairs = near_pairs(nodes, 60.0)
    seen = visible(clearance, nodes, pairs, 1.5)
    least = np.array([_least_clearance(clearance, nodes[i], nodes[j]) for i, j in pairs])
    assert not seen[least < 0.8].any()  # lines through or along something never pass
    assert seen[least > 2.3].all()  # and lines well clear of everything always do


def _least_clearance(clearance: FloatArray, start: np.ndarray, end: np.ndarray) -> float:
    share = np.linspace(0.0, 1.0, 400)[:, None]
    cells = np.rint(start + (end - start) * share).astype(int)
    return float(clearance[cells[:, 0], cells[:, 1]].min())


def test_fronts_meet_in_the_passage() -> None:
    free = dumbbell()
    nodes, labels = np.array([[20, 20], [20, 60]]), np.array([0, 1], dtype=np.int32)
    flooded = flood_labels(clearance_of(free), nodes, labels)
    np.testing.assert_array_equal(flooded >= 0, free)
    assert (flooded[5:35, 5:35] == 0).all()
    assert (flooded[5:35, 41:81] == 1).all()


def test_flooding_does_not_cross_walls() -> None:
    free = dumbbell()
    free[:, 38] = False
    flooded = flood_labels(clearance_of(free), np.array([[20, 20]]), np.zeros(1, dtype=np.int32))
    assert (flooded[5:35, 5:35] == 0).all()
    assert (flooded[:, 38:] == -1).all()


@given(seed=seeds)
def test_flooding_fills_every_piece_with_a_node_and_no_other(seed: int) -> None:
    free = cluttered(seed)
    free[30] = False
    nodes = sample_nodes(clearance_of(free), 9, 1.0, "clearest")[:3]
    flooded = flood_labels(clearance_of(free), nodes, np.arange(len(nodes), dtype=np.int32))
    _, piece = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
    with_node = np.isin(piece, piece[nodes[:, 0], nodes[:, 1]]) & free
    np.testing.assert_array_equal(flooded >= 0, with_node)


def test_nearest_labels_are_those_of_the_nearest_node() -> None:
    free = dumbbell()
    nodes = np.array([[10, 10], [30, 30], [20, 60]])
    labels = nearest_labels(free, nodes, np.array([4, 2, 7], dtype=np.int32))
    assert labels[6, 6] == 4
    assert labels[34, 34] == 2
    assert labels[20, 80] == 7
    assert (labels[~free] == -1).all()


def test_spreading_reaches_through_a_slit() -> None:
    free = np.zeros((30, 40), dtype=bool)
    free[5:25, 5:15] = free[5:25, 20:35] = free[12, 15:20] = True
    free[2, 2] = True
    labels = np.full(free.shape, -1, dtype=np.int32)
    labels[6:24, 6:14] = 3
    spread = spread_labels(labels, free)
    assert (spread[5:25, 20:35] == 3).all()
    assert spread[2, 2] == -1


def test_border_widths_are_the_clearance_where_labels_touch() -> None:
    labels = np.array([[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, -1, 1]], dtype=np.int32)
    clearance = np.arange(12, dtype=np.float64).reshape(3, 4)
    assert border_widths(labels, clearance) == {(0, 1): 5.0, (0, 2): 5.0}


def test_local_width_is_the_largest_disc_that_covers_a_node() -> None:
    pairs, lengths = np.array([[0, 1], [1, 2]]), np.array([3.0, 5.0])
    widths = local_widths(np.array([1.0, 4.0, 2.0]), lengths, pairs, 10.0)
    np.testing.assert_array_equal(widths, [4.0, 4.0, 2.0])
    np.testing.assert_array_equal(
        local_widths(np.array([1.0, 4.0, 2.0]), lengths, pairs, 3.0), [3.0, 3.0, 2.0]
    )


def test_only_clusters_with_a_wide_border_are_joined() -> None:
    borders = {(0, 1): 0.9, (1, 2): 0.4, (2, 3): 2.0}
    widths = [np.full(4, w) for w in (1.0, 1.0, 2.0, 2.2)]
    assert join_wide(borders, widths, 0.8, 60.0) == [0, 0, 1, 1]
    assert join_wide({}, widths, 0.8, 60.0) == [0, 1, 2, 3]


def test_borders_with_a_third_cluster_are_joined_too() -> None:
    borders = {(0, 1): 1.0, (0, 2): 0.3, (1, 2): 0.95}
    assert join_wide(borders, [np.ones(3)] * 3, 0.9, 60.0) == [0, 0, 0]


@pytest.mark.parametrize(("size", "small"), [(4, True), (10, True), (11, False)])
def test_small_obstacles_end_at_their_size(size: int, small: bool) -> None:
    free = np.zeros((60, 60), dtype=bool)
    free[5:55, 5:55] = True
    free[20 : 20 + size, 20:24] = False
    found = small_obstacles(free, 10.0)
    np.testing.assert_array_equal(
        found,
        ~free
        & (np.indices(free.shape).min(axis=0) >= 20)
        & (np.indices(free.shape)[1] < 24)
        & small
        & (np.indices(free.shape)[0] < 40),
    )


def test_what_touches_a_wall_or_the_edge_is_no_small_obstacle() -> None:
    free = np.ones((30, 30), dtype=bool)
    free[0:3, 10:13] = False
    assert not small_obstacles(free, 10.0).any()


def test_a_working_cell_is_free_when_all_of_it_is() -> None:
    free = np.ones((9, 11), dtype=bool)
    free[4, 4] = False
    work = working_grid(free, 0.05, 0.1)
    assert work.step == 2
    assert work.cell_m == pytest.approx(0.1)
    expected = np.ones((5, 6), dtype=bool)
    expected[2, 2] = expected[4, :] = expected[:, 5] = False
    np.testing.assert_array_equal(work.free, expected)
    fine = work.refine(np.arange(30).reshape(5, 6), free.shape)
    assert fine.shape == free.shape
    assert fine[8, 10] == 29

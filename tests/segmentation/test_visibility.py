"""Nodes and sight lines, on small grids with known answers or against loops."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.grids.gridmap import LengthArray, clearance_of
from specmap_cli.segmentation import visibility
from specmap_cli.segmentation.visibility import near_pairs, sample_nodes, visible
from tests.segmentation.plans import cluttered, dumbbell
from tests.strategies import few, seeds


@given(seed=seeds)
@few(15)
def test_sight_lines_are_those_of_a_cell_by_cell_check(seed: int) -> None:
    clearance = clearance_of(cluttered(seed))
    nodes = sample_nodes(clearance, 7, 1.5, "clearest")
    pairs = near_pairs(nodes, 60.0)
    seen = visible(clearance, nodes, pairs, 1.5)
    least = np.array([_least_clearance(clearance, nodes[i], nodes[j]) for i, j in pairs])
    assert not seen[least < 0.8].any()  # lines through or along something never pass
    assert seen[least > 2.3].all()  # and lines well clear of everything always do


def _least_clearance(clearance: LengthArray, start: np.ndarray, end: np.ndarray) -> float:
    cells = np.rint(start + (end - start) * np.linspace(0.0, 1.0, 400)[:, None]).astype(int)
    return float(clearance[cells[:, 0], cells[:, 1]].min())


@given(seed=seeds, choice=st.sampled_from(["clearest", "centre"]), step=st.integers(1, 9))
def test_a_block_has_one_node_or_none(seed: int, choice: str, step: int) -> None:
    rng = np.random.default_rng(seed)
    clearance = np.maximum(rng.normal(1.0, 1.5, (rng.integers(1, 25), rng.integers(1, 25))), 0.0)
    expected = []
    for row, column in itertools.product(*(range(0, side, step) for side in clearance.shape)):
        block = clearance[row : row + step, column : column + step]
        inner = divmod(int(block.argmax()), block.shape[1])
        if choice == "centre":
            inner = step // 2, step // 2
        inside = inner[0] < block.shape[0] and inner[1] < block.shape[1]
        if inside and block[inner] > 1.0:
            expected.append([row + inner[0], column + inner[1]])
    assert sample_nodes(clearance, step, 1.0, choice).tolist() == expected
    clearance = np.zeros((6, 6))
    clearance[1, 1] = 0.5
    for least in (0.0, -1.0):  # without a clearance asked for they still stand in free cells
        assert sample_nodes(clearance, 3, least, choice).tolist() == [[1, 1]]


@given(seed=seeds, sight=st.floats(1.0, 40.0))
def test_in_open_space_all_see_all_in_sight(seed: int, sight: float) -> None:
    nodes = np.unique(np.random.default_rng(seed).integers(0, 30, (20, 2)), axis=0)
    apart = np.hypot(*(nodes[:, None] - nodes[None]).transpose(2, 0, 1))
    expected = np.argwhere(np.triu(apart <= sight + 1e-9, k=1))
    graph = visibility.visibility_graph(np.full((30, 30), 9.0), nodes, sight, 1.0)
    for pairs in (graph.pairs, near_pairs(nodes, sight)):
        np.testing.assert_array_equal(pairs, expected)
    np.testing.assert_allclose(graph.lengths, apart[tuple(expected.T)])
    assert near_pairs(nodes[:1], sight).shape == (0, 2)


def test_nobody_sees_through_a_wall_however_thin_and_slanted() -> None:
    free = np.ones((40, 40), dtype=bool)
    rows = np.arange(40)
    free[rows, rows] = free[rows[1:], rows[:-1]] = False  # closed also over corners
    nodes = np.array([[5, 30], [10, 25], [30, 5], [25, 12], [2, 38]])
    pairs = near_pairs(nodes, 90.0)
    below = nodes[:, 0] < nodes[:, 1]
    apart = below[pairs[:, 0]] != below[pairs[:, 1]]
    np.testing.assert_array_equal(visible(clearance_of(free), nodes, pairs, 0.0), ~apart)


def test_more_pairs_than_are_traced_at_once() -> None:
    free = dumbbell()
    nodes = np.argwhere(free)[::4]
    pairs = near_pairs(nodes, 30.0)
    assert len(pairs) > 1 << 16
    clearance = clearance_of(free)
    whole = visible(clearance, nodes, pairs, 0.0)
    for part in (slice(0, 50), slice((1 << 16) - 20, (1 << 16) + 20), slice(-50, None)):
        np.testing.assert_array_equal(visible(clearance, nodes, pairs[part], 0.0), whole[part])

"""One division from several: what most of them agree on."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import OCCUPIED, GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.segmentation.cells import consensus
from specmap_cli.segmentation.division import segment
from specmap_cli.segmentation.visibility import LabelArray

ROOT = Path(__file__).parents[2]
seeds = st.integers(0, 10_000)


def labels(text: str) -> LabelArray:
    """Labels (1, w) from letters, '.' is no label."""
    return np.array([[-1 if c == "." else ord(c) - ord("a") for c in text]], dtype=np.int32)


def same_partition(one: LabelArray, other: LabelArray) -> bool:
    pairs = set(zip(one.ravel().tolist(), other.ravel().tolist(), strict=True))
    return len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})


def ragged(grid: GridMap, seed: int) -> GridMap:
    """The map with a tenth of the free cells beside walls blocked."""
    cells = grid.cells.copy()
    near = np.argwhere(grid.free & (grid.clearance() < 1.5 * grid.resolution))
    flipped = near[np.random.default_rng(seed).random(len(near)) < 0.1]
    cells[tuple(flipped.T)] = OCCUPIED
    return GridMap(cells, grid.resolution)


@pytest.mark.parametrize(
    ("divisions", "expected"),
    [
        (("aaabbb", "bbbaaa", "cccddd"), "aaabbb"),  # names do not matter
        (("aaabbb", "aaabbb", "aaaaaa"), "aaabbb"),  # two of three divide
        (("aaabbb", "aaaaaa", "aaaaaa"), "aaaaaa"),  # two of three do not
        (("aabbbb", "aaabbb", "aaaabb"), "aaabbb"),  # the border in the middle
        (("aa..bb", "aa..bb", "aa..bb"), "aa..bb"),  # what has no label gets none
        (("aa..", "aabb", "aabb"), "aabb"),  # a piece that one of them has no node in
        (("aab.b",), "aab.b"),
        # all have the left half: no majority for pairs of cells may join the halves
        (
            ("aaaaaabccccd", "aaaaaabbbbcc", "aabbcccccccc", "aaaabbbccccc", "aaabccccdddd"),
            "aaaaaabbbbbb",
        ),
    ],
)
def test_cells_are_together_where_most_say_so(divisions: tuple[str, ...], expected: str) -> None:
    assert same_partition(consensus([labels(text) for text in divisions]), labels(expected))


@given(seeds)
def test_the_consensus_of_equal_divisions_is_theirs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocks = rng.permutation(6).reshape(2, 3).astype(np.int32)
    division = np.kron(blocks, np.ones((4, 5), dtype=np.int32))
    renamed = [rng.permutation(9).astype(np.int32)[division] for _ in range(3)]
    assert same_partition(consensus(renamed), division)


@given(seeds)
def test_the_order_of_rare_and_common_names_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cuts = np.sort(rng.integers(3, 27, (3, 2)), axis=1)
    divisions = [np.digitize(np.arange(30), cut)[None].astype(np.int32) for cut in cuts]
    first = consensus(divisions)
    for names in itertools.permutations(range(3)):
        again = consensus([np.array(names, dtype=np.int32)[division] for division in divisions])
        assert same_partition(again, first)


@pytest.mark.parametrize("seed", range(4))
def test_a_few_ragged_cells_move_no_border(office: GridMap, seed: int) -> None:
    """Cells beside walls flip, as they do from one recording to the next."""
    config = SegmentationConfig()
    worn = ragged(office, seed)
    before, after = segment(office, config), segment(worn, config)
    common = (before.labels >= 0) & (after.labels >= 0) & worn.free
    shared = np.zeros((before.count, after.count))
    np.add.at(shared, (before.labels[common], after.labels[common]), 1.0)
    assert before.count == after.count
    assert shared.max(axis=1).sum() > 0.97 * shared.sum()


def test_what_no_majority_has_stays_apart_where_nothing_joins_it() -> None:
    found = consensus([labels("aaaabcde"), labels("aaaabbee"), labels("aaaaefgg")])
    assert same_partition(found[:, :4], labels("aaaa"))
    assert found[0, 0] not in found[0, 4:]


def test_cells_that_tipped_a_pairwise_majority_tip_no_election() -> None:
    """Shelves and open corners of the sample office are near ties: not all such cells are outvoted.

    These are one case in which a majority for each pair of cells lost a room, and the vote for
    whole regions does not.
    """
    grid = read_grid(ROOT / "sample_logs" / "office.yaml")
    config = SegmentationConfig()
    before = segment(grid, config)
    after = segment(ragged(grid, 5), config)
    both = (before.labels >= 0) & (after.labels >= 0)
    shared = np.zeros((before.count, after.count))
    np.add.at(shared, (before.labels[both], after.labels[both]), 1.0)
    either = shared.sum(axis=1)[:, None] + shared.sum(axis=0) - shared
    assert (shared / either > 0.5).sum() >= 0.9 * max(before.count, after.count)

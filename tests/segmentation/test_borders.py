"""Where regions touch, and which of them are joined, against loops over all cells and clusters."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.grids.gridmap import contacts
from specmap_cli.segmentation.cells import border_widths, join_wide, local_widths
from specmap_cli.segmentation.visibility import LabelArray

seeds = st.integers(0, 10_000)


def patches(seed: int) -> LabelArray:
    """Random labels -1 to 3 on a small grid."""
    rng = np.random.default_rng(seed)
    return rng.integers(-1, 4, (rng.integers(1, 8), rng.integers(1, 8)), dtype=np.int32)


def touching(labels: LabelArray) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """The pairs of cells that share a side and differ, both labelled."""
    found = set()
    for row, column in np.ndindex(*labels.shape):
        for other in ((row + 1, column), (row, column + 1)):
            if other[0] < labels.shape[0] and other[1] < labels.shape[1]:
                one = labels[row, column], labels[other]
                if one[0] != one[1] and min(one) >= 0:
                    found.add(((row, column), other))
    return found


@given(seeds)
def test_contacts_are_all_pairs_of_cells_that_touch_and_differ(seed: int) -> None:
    labels = patches(seed)
    found = contacts(labels)
    pairs = [
        (tuple(one), tuple(other))
        for one, other in zip(found.one.tolist(), found.other.tolist(), strict=True)
    ]
    assert len(set(pairs)) == len(pairs)
    assert set(pairs) == touching(labels)
    for (one, other), (low, high) in zip(pairs, found.labels.tolist(), strict=True):
        assert (low, high) == tuple(sorted((labels[one], labels[other])))


@given(seeds)
def test_a_border_is_as_wide_as_its_clearest_contact(seed: int) -> None:
    labels = patches(seed)
    clearance = np.random.default_rng(seed + 1).random(labels.shape)
    expected: dict[tuple[int, int], float] = {}
    for one, other in touching(labels):
        low, high = sorted((int(labels[one]), int(labels[other])))
        width = float(min(clearance[one], clearance[other]))
        expected[low, high] = max(width, expected.get((low, high), 0.0))
    assert border_widths(labels, clearance) == expected


@pytest.mark.parametrize("labels", [np.zeros((4, 5)), np.full((3, 3), -1), np.zeros((1, 1))])
def test_one_region_has_no_border(labels: LabelArray) -> None:
    assert contacts(labels.astype(np.int32)).labels.shape == (0, 2)
    assert border_widths(labels.astype(np.int32), np.ones(labels.shape)) == {}


@given(seeds)
def test_a_local_width_is_the_largest_visible_disc_that_covers_the_node(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(0, 20, (12, 2))
    clearance = rng.uniform(0.5, 8, 12)
    every = np.array(list(itertools.combinations(range(12), 2)))
    pairs = every[rng.random(len(every)) < 0.5]
    lengths = np.hypot(*(nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).T)
    seen = {(i, j): d for (i, j), d in zip(pairs.tolist(), lengths.tolist(), strict=True)}
    expected = []
    for node in range(12):
        discs = [clearance[node]]
        for other in range(12):
            gap = seen.get((min(node, other), max(node, other)), np.inf)
            discs += [clearance[other]] if gap < clearance[other] else []
        expected.append(min(max(discs), 6.0))
    np.testing.assert_allclose(local_widths(clearance, lengths, pairs, 6.0), expected)


def joined_one_by_one(
    borders: dict[tuple[int, int], float], widths: list[np.ndarray], ratio: float, percent: float
) -> list[set[int]]:
    """`join_wide` as sets: after each join all is computed anew."""
    groups = [{number} for number in range(len(widths))]
    while True:
        best = None
        for one, other in itertools.combinations(groups, 2):
            shared = [w for (a, b), w in borders.items() if {a, b} & one and {a, b} & other]
            sizes = [
                np.percentile(np.concatenate([widths[k] for k in sorted(group)]), percent)
                for group in (one, other)
            ]
            share = max(shared, default=0.0) / np.sqrt(sizes[0] * sizes[1])
            if shared and share >= ratio and (best is None or share > best[0]):
                best = share, one, other
        if best is None:
            return groups
        groups = [group for group in groups if group not in best[1:]] + [best[1] | best[2]]


@given(seeds, st.sampled_from([0.5, 0.8, 1.1]), st.sampled_from([50.0, 75.0]))
def test_clusters_are_joined_as_one_by_one(seed: int, ratio: float, percent: float) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    widths = [rng.uniform(1.0, 2.0, rng.integers(1, 6)) for _ in range(count)]
    borders = {
        pair: float(rng.uniform(0.3, 2.0))
        for pair in itertools.combinations(range(count), 2)
        if rng.random() < 0.5
    }
    names = join_wide(borders, widths, ratio, percent)
    found = [{k for k, name in enumerate(names) if name == group} for group in set(names)]
    expected = joined_one_by_one(borders, widths, ratio, percent)
    assert sorted(map(sorted, found)) == sorted(map(sorted, expected))
    assert names[0] == 0
    assert sorted(set(names)) == list(range(len(found)))


@pytest.mark.parametrize(("border", "joined"), [(0.8, True), (0.7999, False)])
def test_a_border_of_just_the_ratio_joins(border: float, joined: bool) -> None:
    names = join_wide({(0, 1): border}, [np.full(2, 0.5), np.full(2, 2.0)], 0.8, 60.0)
    assert (names == [0, 0]) == joined


def test_a_cluster_without_nodes_or_width_does_no_harm() -> None:
    widths = [np.zeros(3), np.zeros(0), np.ones(3)]
    assert join_wide({(0, 2): 0.1, (1, 2): 0.1}, widths, 0.8, 60.0) == [0, 0, 0]
    assert join_wide({}, [], 0.8, 60.0) == []

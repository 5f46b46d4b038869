"""Cells and furniture, on small grids with known answers or against loops."""

import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    BoolArray,
    GridMap,
    LengthArray,
    clearance_of,
    contacts,
    joined,
    nearest_values,
)
from specmap_cli.segmentation.cells import (
    border_widths,
    consensus,
    flood_labels,
    flooded_at,
    joined_wide,
    local_widths,
    nearest_labels,
    relief_of,
    spread_labels,
    without_dead_ends,
)
from specmap_cli.segmentation.division import segment
from specmap_cli.segmentation.obstacles import furniture, small_obstacles
from specmap_cli.segmentation.visibility import LabelArray, sample_nodes
from specmap_cli.segmentation.working_grid import reduced
from tests.segmentation.plans import OFFICE, cluttered, dumbbell, same_parts
from tests.strategies import few, grid_maps, seeds


@given(seed=seeds, asked=st.integers(0, 40))
def test_flooding_fills_pieces_with_a_node_and_some_cells_alike(seed: int, asked: int) -> None:
    rng, free = np.random.default_rng(seed), cluttered(seed)
    free[30] = False
    clearance = clearance_of(free)
    nodes = sample_nodes(clearance, 9, 1.0, "clearest")[: 3 + 5 * (asked % 2)]
    labels = rng.permutation(len(nodes)).astype(np.int32)
    flooded = flood_labels(relief_of(clearance), nodes, labels)
    _, piece = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
    with_node = np.isin(piece, piece[nodes[:, 0], nodes[:, 1]]) & free
    np.testing.assert_array_equal(flooded >= 0, with_node)
    corners = np.array([[0, 0], np.array(free.shape) - 1])
    cells = np.concatenate([corners, rng.integers(0, free.shape, (asked, 2))])
    if len(nodes):
        found = flooded_at(clearance, nodes, labels, cells)
        np.testing.assert_array_equal(found, flooded[tuple(cells.T)])
    assert (flood_labels(relief_of(clearance), nodes[:0], labels[:0]) == -1).all()
    assert (nearest_labels(free.view(np.uint8), nodes[:0], labels[:0]) == -1).all()
    part = np.array([[20, 10], [21, 60]])  # the flood looks no farther than nodes and cells lie
    free = dumbbell()
    found = flooded_at(clearance_of(free), part, np.arange(2, dtype=np.int32), part + 3)
    assert found.tolist() == [0, 1]


@given(seed=seeds)
def test_nearest_labels_are_those_of_the_nearest_node(seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = cluttered(seed)
    nodes, labels = rng.integers(0, 60, (6, 2)), rng.integers(0, 4, 6).astype(np.int32)
    found = nearest_labels(free.view(np.uint8), nodes, labels)
    for row, column in rng.integers(0, 60, (40, 2)):
        if not free[row, column]:
            assert found[row, column] == -1
            continue
        gaps = np.hypot(*(nodes - (row, column)).T)
        assert found[row, column] in labels[gaps == gaps.min()]


def narrowest(clearance: LengthArray, nodes: np.ndarray) -> FloatArray:
    """(n, h, w) the least clearance on the best way from each node to each cell."""
    found = np.zeros((len(nodes), *clearance.shape))
    for level in np.unique(clearance[clearance > 0.0]):
        pieces, _ = ndimage.label(clearance >= level)
        for number, node in enumerate(nodes):
            if pieces[tuple(node)]:
                found[number][pieces == pieces[tuple(node)]] = level
    return found


@given(seed=seeds)
@few(3)
def test_a_flooded_cell_belongs_to_the_node_with_the_widest_way_to_it(seed: int) -> None:
    """Where two fronts meet they stand a cell apart; in one world of many they shut a thin way."""
    shares = []
    for world in range(seed, seed + 5):
        clearance = np.round(clearance_of(cluttered(world)), 1)
        nodes = sample_nodes(clearance, 19, 1.0, "clearest")
        flooded = flood_labels(relief_of(clearance), nodes, np.arange(len(nodes), dtype=np.int32))
        ways = narrowest(clearance, nodes)
        mine = np.take_along_axis(ways, np.maximum(flooded, 0)[None], axis=0)[0]
        step = 2.0 * clearance.max() / 126  # heights are rounded, and each step counts two of them
        shares.append(np.mean((flooded >= 0) & (mine < ways.max(axis=0) - step)))
    assert np.median(shares) < 0.003


@given(seed=seeds, rings=st.integers(1, 6))
def test_labels_spread_to_their_whole_piece_and_change_none(seed: int, rings: int) -> None:
    rng = np.random.default_rng(seed)
    free = rng.random((20, 20)) < 0.6
    labels = np.where(free & (rng.random(free.shape) < 0.05), 7, -1).astype(np.int32)
    labels[(labels == 7) & (rng.random(free.shape) < 0.5)] = 2
    spread, crept = labels.copy(), labels.copy()
    spread_labels(spread, free, rings)
    spread_labels(crept, free, rings, everywhere=False)
    piece, _ = ndimage.label(free, np.ones((3, 3)))
    np.testing.assert_array_equal(spread >= 0, np.isin(piece, np.unique(piece[labels >= 0])) & free)
    np.testing.assert_array_equal(spread[labels >= 0], labels[labels >= 0])
    near = ndimage.binary_dilation(labels >= 0, np.ones((3, 3)), rings, mask=free)
    np.testing.assert_array_equal(crept >= 0, near | (labels >= 0))
    np.testing.assert_array_equal(crept[near], spread[near])
    piece, _ = ndimage.label(free)  # over sides alone
    expected = free & np.isin(piece, piece[labels == 2])
    np.testing.assert_array_equal(joined(free, labels == 2), expected)


def test_labels_creep_round_a_wall_as_far_as_they_are_told() -> None:
    free = np.ones((9, 21), dtype=bool)
    free[:, 10] = False
    free[0, 10] = True  # the two halves hang together at the top
    labels = np.full(free.shape, -1, dtype=np.int32)
    labels[5:, 9], labels[:, 20] = 1, 2  # on the wall's left side; far on its right
    round_it, through_it = labels.copy(), labels.copy()
    spread_labels(round_it, free, 9)
    spread_labels(through_it, free, 1)
    np.testing.assert_array_equal(round_it[5:, 11:], 2)
    assert (through_it[5:, 12] == 1).all()  # nearer, through the wall


@given(seed=seeds)
@few(8)
def test_labels_come_from_as_far_as_they_must(seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = np.ones((300, 700), dtype=bool)  # more than is looked at together
    labels = np.full(free.shape, -1, dtype=np.int16)
    spots = rng.integers((0, 0), free.shape, (4, 2))
    labels[tuple(spots.T)] = np.arange(4)
    free[rng.random(free.shape) < 0.05] = False
    nearest = nearest_values(labels + np.int16(1))[0] - np.int16(1)
    missing = free & (labels < 0)
    free[tuple(spots.T)] = True
    spread_labels(labels, free, 0)
    piece, _ = ndimage.label(free, np.ones((3, 3)))
    held = missing & np.isin(piece, piece[tuple(spots.T)])
    np.testing.assert_array_equal(labels[held], nearest[held])


@given(seed=seeds)
def test_the_nearest_value_is_that_of_a_cell_no_farther_than_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 40, (15, 18)) * (rng.random((15, 18)) < 0.1)
    values[rng.integers(15), rng.integers(18)] = 1
    found, _ = nearest_values(values.astype(np.uint16))
    spots = np.argwhere(values)
    gaps, _ = cKDTree(spots).query(np.argwhere(np.ones_like(values)))
    for (row, column), gap in zip(np.ndindex(15, 18), gaps, strict=True):
        same = spots[values[tuple(spots.T)] == found[row, column]]
        assert np.hypot(*(same - (row, column)).T).min() <= 1.03 * gap


def rectangles(cells: FloatArray) -> FloatArray:
    """Sides (n, 2), shorter first, of the least rectangles round cells (m, 2) along two of them."""
    steps = np.unique((cells[:, None] - cells[None]).reshape(-1, 2), axis=0)
    sides = np.array(
        [
            sorted(np.ptp(cells @ way) for way in ((np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))))
            for a in np.unique(np.arctan2(steps[:, 1], steps[:, 0]))
        ]
    )
    area = sides.prod(axis=1)
    return np.asarray(sides[area <= 1.001 * area.min() + 1e-6])


def isolated(
    free: BoolArray, largest: float, bulky: float, thick: float
) -> tuple[BoolArray, BoolArray]:
    """`small_obstacles` piece by piece with SciPy, and what may be taken or not, by a rounding."""
    piece, count = ndimage.label(np.pad(~free, 1, constant_values=True), np.ones((3, 3)))
    taken, undecided = np.zeros(piece.shape, dtype=bool), np.zeros(piece.shape, dtype=bool)
    for number in range(2, count + 1):  # the first is the outside
        mine = piece == number
        side = max(np.ptp(axis) + 1 for axis in np.nonzero(mine))
        short, long = rectangles(np.argwhere(mine).astype(np.float64)).T + 1.0
        solid = [
            (short >= thick - slack) & (2 * mine.sum() >= short * long - slack)
            for slack in (-1e-3, 1e-3)
        ]
        taken |= mine & (side <= largest or (side <= bulky and bool(solid[1].any())))
        undecided |= mine & bool(largest < side <= bulky and solid[1].any() != solid[0].all())
    return taken[1:-1, 1:-1], undecided[1:-1, 1:-1]


@given(seed=seeds, largest=st.integers(0, 12), bulky=st.integers(0, 25), thick=st.integers(1, 9))
def test_small_obstacles_piece_by_piece(seed: int, largest: int, bulky: int, thick: int) -> None:
    free = cluttered(seed)
    found = small_obstacles(free, largest, bulky, thick)
    taken, undecided = isolated(free, largest, bulky if bulky > largest else 0.0, thick)
    np.testing.assert_array_equal(found & ~undecided, taken & ~undecided)


@pytest.mark.parametrize(
    ("count", "gap", "is_furniture"), [(6, 1, False), (6, 2, False), (6, 4, True), (2, 1, True)]
)
def test_a_railing_is_a_wall_of_many_near_dashes(count: int, gap: int, is_furniture: bool) -> None:
    free = np.ones((60, 60 + 30 * count), dtype=bool)
    for first in range(20, 20 + count * (20 + gap), 20 + gap):
        free[30, first : first + 20] = False  # a thin piece of a metre
    found = furniture(free, 0.05, SegmentationConfig())
    np.testing.assert_array_equal(found, ~free if is_furniture else np.zeros_like(free))
    free[20:29, 40:76] = False  # a table a slit away from the row, solid, and longer than a chair
    found = furniture(free, 0.05, SegmentationConfig())
    assert found[20:29, 40:76].all()
    assert found[30].any() == is_furniture


@given(grid_maps(), st.integers(1, 4))
def test_coarse_cells_are_those_of_the_fine_ones_under_them(grid: GridMap, step: int) -> None:
    """No wall is lost, and half a cell has to be free."""
    coarse = reduced(grid.cells, step)
    for row, column in np.ndindex(coarse.shape):
        block = grid.cells[row * step : (row + 1) * step, column * step : (column + 1) * step]
        counts = np.bincount(block.flat, minlength=3)
        free = FREE if 2 * counts[FREE] >= step**2 else UNKNOWN
        assert coarse[row, column] == (OCCUPIED if counts[OCCUPIED] else free)


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
    """And a border is as wide as its clearest contact."""
    rng = np.random.default_rng(seed)
    labels = rng.integers(-1, 4, tuple(rng.integers(1, 8, 2)), dtype=np.int32)
    clearance = rng.random(labels.shape)
    found = contacts(labels)
    both = zip(found.one.tolist(), found.other.tolist(), strict=True)
    pairs = [(tuple(one), tuple(other)) for one, other in both]
    assert len(set(pairs)) == len(pairs)
    assert set(pairs) == touching(labels)
    expected: dict[tuple[int, int], float] = {}
    for (one, other), (low, high) in zip(pairs, found.labels.tolist(), strict=True):
        assert (low, high) == tuple(sorted((labels[one], labels[other])))
        width = float(min(clearance[one], clearance[other]))
        expected[low, high] = max(width, expected.get((low, high), 0.0))
    assert border_widths(labels, clearance) == expected
    for nothing in (np.zeros_like(labels), np.full_like(labels, -1)):
        assert contacts(nothing).labels.shape == (0, 2)
        assert border_widths(nothing, clearance) == {}


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


@given(seeds, st.sampled_from([0.5, 0.8, 1.1]))
def test_clusters_are_one_where_wide_borders_lead_to_each_other(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    widths = rng.uniform(0.0, 2.0, rng.integers(1, 9))
    every = itertools.combinations(range(len(widths)), 2)
    borders = {pair: float(rng.uniform(0.0, 2.0)) for pair in every if rng.random() < 0.5}
    joined = np.eye(len(widths), dtype=bool)
    for (one, other), border in borders.items():
        wide = border >= ratio * np.sqrt(widths[one] * widths[other])
        joined[one, other] = joined[other, one] = wide
    names = joined_wide(borders, widths.tolist(), ratio)
    ways = np.linalg.matrix_power(joined.astype(np.int64), len(widths)) > 0
    np.testing.assert_array_equal(names[:, None] == names, ways)
    assert set(names.tolist()) == set(range(names.max() + 1))


def test_a_border_of_just_the_ratio_joins_and_a_cluster_without_width_any() -> None:
    for border, names in ((0.3 * 3 / 1.25, [0, 0]), (0.7199, [0, 1])):
        assert joined_wide({(0, 1): border}, [0.5, 2.0], 0.72).tolist() == names
    assert joined_wide({(0, 1): 0.1}, [0.0, 1.0], 0.8).tolist() == [0, 0]
    assert joined_wide({}, [], 0.8).tolist() == []


def labels(text: str) -> LabelArray:
    """Labels (1, w) from letters, '.' is no label."""
    return np.array([[-1 if c == "." else ord(c) - ord("a") for c in text]], dtype=np.int32)


@pytest.mark.parametrize(
    ("smallest", "opening", "expected"),
    [
        (21, 3.0, "aaaabbcccc.d"),  # a small room on the way from one to another
        (41, 3.0, "aaaaaaaaaa.d"),
        (21, 0.5, "aaaacccccc.d"),  # nobody comes through on its left: it is a dead end
        (20, 0.5, "aaaabbcccc.d"),
        (999, 0.5, "aaaacccccc.d"),
    ],
)
def test_a_small_dead_end_is_part_of_the_next(smallest: int, opening: float, expected: str) -> None:
    found = np.repeat(labels("aaaabbcccc.d"), 10, axis=0)
    clearance = np.full(found.shape, 3.0)
    clearance[:, 3] = opening
    merged = without_dead_ends(found, clearance, 1.0, smallest)
    assert same_parts(merged, np.repeat(labels(expected), 10, axis=0))
    nothing = np.full_like(found, -1)
    np.testing.assert_array_equal(without_dead_ends(nothing, clearance, 1.0, 9), nothing)


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
        (("aab..", "aab..", "aabcc"), "aabcc"),  # a piece that one alone has a node in
        (("aaaabcde", "aaaabbee", "aaaaefgg"), "aaaabcdd"),  # no majority: the one most alike
        (("aaaccc", "bbbccc"), "aaabbb"),  # names with gaps
        (("....", "...."), "...."),
    ],
)
def test_cells_are_together_where_most_say_so(divisions: tuple[str, ...], expected: str) -> None:
    assert same_parts(consensus([labels(text) for text in divisions]), labels(expected))


@given(seeds)
def test_the_order_of_rare_and_common_names_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cuts = np.sort([rng.choice(np.arange(3, 27), 2, replace=False) for _ in range(3)], axis=1)
    divisions = [np.digitize(np.arange(30), cut)[None].astype(np.int32) for cut in cuts]
    first = consensus(divisions)
    for names in itertools.permutations(range(3)):
        again = consensus([np.array(names, dtype=np.int32)[division] for division in divisions])
        assert same_parts(again, first)


@pytest.mark.parametrize("seed", range(4))
def test_a_few_ragged_cells_move_no_border(seed: int) -> None:
    """A tenth of the cells beside walls flips, as they do from one recording to the next."""
    cells = OFFICE.cells.copy()
    near = np.argwhere(OFFICE.free & (OFFICE.clearance() < 1.5 * OFFICE.resolution))
    flipped = near[np.random.default_rng(seed).random(len(near)) < 0.1]
    cells[tuple(flipped.T)] = OCCUPIED
    one = segment(OFFICE, SegmentationConfig())
    other = segment(GridMap(cells, OFFICE.resolution), SegmentationConfig())
    both = (one.labels >= 0) & (other.labels >= 0)
    shared = np.zeros((one.count, other.count))
    np.add.at(shared, (one.labels[both], other.labels[both]), 1.0)
    assert one.count == other.count
    assert shared.max(axis=1).sum() > 0.97 * shared.sum()

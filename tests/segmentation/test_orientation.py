"""One window and one orientation, whatever copy of a map is given."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.working_grid import canonical
from tests.strategies import seeds

turns = st.integers(0, 3)


def blotch(seed: int) -> BoolArray:
    """A few free cells, one at the least."""
    rng = np.random.default_rng(seed)
    free = rng.random((rng.integers(1, 7), rng.integers(1, 7))) < 0.4
    free[rng.integers(free.shape[0]), rng.integers(free.shape[1])] = True
    return np.asarray(free)


@given(seeds, turns, st.tuples(*[st.integers(0, 5)] * 4))
def test_every_copy_of_a_map_looks_the_same(
    seed: int, turned: int, frame: tuple[int, int, int, int]
) -> None:
    free = blotch(seed)
    copy = np.pad(np.rot90(free, turned), (frame[:2], frame[2:]))
    np.testing.assert_array_equal(canonical(copy).apply(copy), canonical(free).apply(free))


@given(turns)
def test_the_free_space_lies_and_leans_whatever_single_cells_say(turned: int) -> None:
    free = np.zeros((40, 90), dtype=bool)
    free[5:35, 5:35] = free[15:24, 35:81] = True  # a room, and a corridor to the right of it
    ray = free.copy()
    ray[20, 81:90] = ray[0:5, 10] = True  # glimpses through a door and a window
    plain, seen = (canonical(np.rot90(picture, turned)).turns for picture in (free, ray))
    assert plain == seen == -turned % 4


@given(seeds, st.integers(1, 9))
def test_the_middle_of_the_free_space_is_the_corner_of_a_block(seed: int, block: int) -> None:
    free = np.kron(blotch(seed), np.ones((6, 6), dtype=bool))
    upright = canonical(free, block)
    rows, columns = upright.before
    assert 0 <= rows < block
    assert 0 <= columns < block
    turned = upright.apply(free)
    assert not turned[:rows].any()
    assert not turned[:, :columns].any()
    inner = ndimage.binary_erosion(turned, np.ones((5, 5)))
    middle = np.argwhere(inner if inner.any() else turned).mean(axis=0)
    assert (middle.astype(int) % block).tolist() == [0, 0]


@given(seeds)
def test_what_was_turned_is_put_back_where_it_was(seed: int) -> None:
    free = blotch(seed)
    upright = canonical(free)
    picture = np.arange(free.size).reshape(free.shape)
    turned, canvas = upright.apply(picture), np.full(free.shape, -1)
    back = upright.undo(turned, canvas)
    np.testing.assert_array_equal(back[upright.window], picture[upright.window])
    outside = np.ones(free.shape, dtype=bool)
    outside[upright.window] = False
    assert (back[outside] == -1).all()
    assert not free[outside].any()
    assert (canvas == -1).all()  # it is not changed itself
    cells = np.argwhere(np.ones(turned.shape, dtype=bool))
    rows, columns = upright.cells_in_grid(cells, turned.shape).astype(int).T
    np.testing.assert_array_equal(picture[rows, columns], turned.reshape(-1))
    nothing = canonical(np.zeros_like(free))  # without a free cell the window is empty
    assert nothing.apply(np.zeros_like(free)).shape == (0, 0)
    assert nothing.cells_in_grid(np.zeros((0, 2)), (0, 0)).shape == (0, 2)

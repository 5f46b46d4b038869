"""Correlation by Fourier transform against plain loops, and the peaks that are taken of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.grids.correlation import (
    Peak,
    Target,
    cell_counts,
    local_maxima,
    peaks,
)
from tests.strategies import seeds

sizes = st.tuples(st.integers(1, 12), st.integers(1, 12))


@given(seeds, st.integers(1, 3), sizes, st.tuples(st.integers(0, 9), st.integers(0, 9)))
def test_every_shift_is_the_sum_of_products(
    seed: int, layers: int, size: tuple[int, int], padding: tuple[int, int]
) -> None:
    rng = np.random.default_rng(seed)
    images = rng.normal(size=(layers, *size))
    target = Target.of(images, padding)
    assert target.size == size
    for length, given_, extra in zip(target.shape, size, padding, strict=True):
        assert length >= given_ + extra
    pictures = rng.normal(size=(layers, *target.shape))
    padded = np.zeros((layers, *target.shape))
    padded[:, : size[0], : size[1]] = images
    correlation = target.correlate(pictures)
    for row, column in rng.integers(0, target.shape, (4, 2)):
        moved = np.roll(pictures, (row, column), axis=(1, 2))
        assert correlation[row, column] == pytest.approx((padded * moved).sum())
    single = Target.of(images.astype(np.float32), padding)
    assert single.correlate(pictures.astype(np.float32)).dtype == np.float32


@given(seeds, st.integers(0, 40), sizes, st.sampled_from([0.05, 0.2, 1.0]))
def test_counts_are_of_cells_centred_on_the_origin_around_the_picture(
    seed: int, count: int, size: tuple[int, int], cell: float
) -> None:
    points = np.random.default_rng(seed).uniform(-20.0 * cell, 20.0 * cell, (count, 2))
    expected = np.zeros(size)
    for x, y in points.tolist():
        row, column = round(y / cell), round(x / cell)
        expected[row % size[0], column % size[1]] += 1
    assert cell_counts(points, cell, size).tolist() == expected.tolist()


@given(seeds, sizes)
def test_local_maxima_by_a_loop(seed: int, size: tuple[int, int]) -> None:
    picture = np.random.default_rng(seed).integers(0, 6, size).astype(float)
    found = local_maxima(picture)
    for row, column in np.ndindex(*size):
        near = picture[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        highest = picture[row, column] >= near.max()
        assert found[row, column] == (picture[row, column] if highest else -np.inf)


@given(seeds, sizes, st.integers(1, 6), st.integers(0, 3))
def test_peaks_come_highest_first_and_apart_around_the_edges(
    seed: int, size: tuple[int, int], count: int, apart: int
) -> None:
    total = size[0] * size[1]
    picture = np.random.default_rng(seed).permutation(total).reshape(size).astype(float)
    found = peaks(picture, size, 1.0, count, apart)
    values = [peak.value for peak in found]
    assert values == sorted(values, reverse=True)
    assert found[0].value == picture.max()
    assert len(found) <= count
    cells = [(round(peak.y - 0.5) % size[0], round(peak.x - 0.5) % size[1]) for peak in found]
    for k, (cell, value) in enumerate(zip(cells, values, strict=True)):
        assert picture[cell] == value
        assert all(gap(cell, other, size) > apart for other in cells[:k])
    if len(found) < count:  # every cell is too near to one of them
        for place in np.ndindex(*size):
            assert any(gap(place, cell, size) <= apart for cell in cells)


def gap(a: tuple[int, int], b: tuple[int, int], size: tuple[int, int]) -> int:
    """Rows or columns between two cells, the larger of both, around the edges."""
    apart = [abs(u - v) for u, v in zip(a, b, strict=True)]
    return max(min(d, n - d) for d, n in zip(apart, size, strict=True))


@pytest.mark.parametrize(
    ("cell", "place"),
    [
        ((0, 0), (0.5, 0.5)),
        ((3, 7), (7.5, 3.5)),
        ((10, 10), (10.5, 10.5)),  # halfway between the target's end and the picture's
        ((11, 11), (-0.5, -0.5)),  # nearer to the beginning, from below
    ],
)
def test_shifts_past_the_target_are_negative(
    cell: tuple[int, int], place: tuple[float, float]
) -> None:
    picture: Any = np.zeros((12, 12))
    picture[cell] = 1.0
    assert peaks(picture, (8, 8), 1.0, count=1) == [Peak(1.0, *place)]
    assert peaks(picture, (8, 8), 0.2, count=1)[0].x == pytest.approx(0.2 * place[0])


def test_ties_go_to_the_first_cell_and_cells_of_minus_infinity_are_no_peaks() -> None:
    flat = np.zeros((4, 5))
    first, *_ = peaks(flat, (4, 5), 1.0, count=3, apart=1)
    assert (first.x, first.y) == (0.5, 0.5)
    assert not flat.any()  # the correlation is left as it was
    picture = np.full((4, 4), -np.inf)
    assert peaks(picture, (4, 4), 1.0, count=3) == []
    picture[2, 1] = -5.0
    assert peaks(picture, (4, 4), 1.0, count=3) == [Peak(-5.0, 1.5, 2.5)]

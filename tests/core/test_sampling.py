"""Thinning is even, deterministic, and keeps the ends."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.arrays import evenly


@given(st.integers(0, 200), st.integers(1, 60))
def test_what_is_kept_is_spread_evenly(count: int, most: int) -> None:
    kept = evenly(np.arange(count), most)
    assert len(kept) == min(count, most)
    assert (np.diff(kept) > 0).all()
    if count > most > 1:
        assert (kept[0], kept[-1]) == (0, count - 1)
        gaps = np.diff(kept)
        assert gaps.max() - gaps.min() <= 1


def test_rows_are_kept_whole() -> None:
    rows = np.arange(20).reshape(10, 2)
    kept = evenly(rows, 3)
    assert kept.tolist() == [[0, 1], [8, 9], [18, 19]]
    assert evenly(rows, 10) is rows

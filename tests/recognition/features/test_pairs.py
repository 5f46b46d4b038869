"""Every pair of points at once."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from specmap_cli.recognition.features.returns import pair_windows


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 6, 110])
def test_each_pair_comes_once_and_what_is_missing_is_no_number(count: int) -> None:
    first, second = pair_windows(np.arange(float(count)))
    first, second = np.broadcast_arrays(first, second)
    ends = np.sort(np.stack([first.ravel(), second.ravel()]), axis=0)
    ends = ends[:, np.isfinite(ends).all(axis=0)]
    assert sorted(zip(*ends.tolist(), strict=True)) == list(combinations(range(count), 2))

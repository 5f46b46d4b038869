"""Eigenpairs where the iteration for a few of them does not end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.linalg import ArpackNoConvergence

from specmap_cli.segmentation import spectrum


def test_what_does_not_converge_is_solved_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    dense = rng.random((200, 200))
    matrix = csr_array(dense + dense.T)
    usual_values, usual = spectrum.largest_eigenpairs(matrix, 5)

    def never_ends(*_: Any, **__: Any) -> None:
        raise ArpackNoConvergence("No convergence", np.zeros(0), np.zeros((200, 0)))

    monkeypatch.setattr(spectrum, "eigsh", never_ends)
    values, vectors = spectrum.largest_eigenpairs(matrix, 5)
    assert (np.diff(values) <= 0.0).all()
    assert np.allclose(values, usual_values)
    assert np.allclose(vectors, usual, atol=1e-6)

"""Features cut into bins at their quantiles: what trees are grown on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray

BINS = 16  # more of them learn no better, and cost a round in proportion
CodeArray = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Quantiser:
    """Cuts every feature at its quantiles: `edges` (F, BINS - 1), padded with +inf."""

    edges: FloatArray

    @classmethod
    def of(cls, X: NDArray[Any]) -> Quantiser:
        """The quantiser of samples X (n, F)."""
        ordered = np.sort(np.asarray(X, dtype=np.float64), axis=0)
        at = np.linspace(0, len(ordered) - 1, BINS + 1)[1:-1]
        low = ordered[np.floor(at).astype(np.intp)]
        high = ordered[np.minimum(np.floor(at).astype(np.intp) + 1, len(ordered) - 1)]
        cuts = 0.5 * (low + high).T
        edges = np.full(cuts.shape, np.inf)
        for row, values in zip(edges, cuts, strict=True):
            distinct = np.unique(values)
            row[: len(distinct)] = distinct
        return cls(edges)

    def codes(self, X: NDArray[Any]) -> CodeArray:
        """(F, n) bin of every value: how many edges it reaches."""
        X = np.asarray(X, dtype=np.float64)
        codes = np.empty((X.shape[1], len(X)), dtype=np.uint8)
        for row, edges, values in zip(codes, self.edges, X.T, strict=True):
            row[:] = np.searchsorted(edges, values, side="right")
        return codes

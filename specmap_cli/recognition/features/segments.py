"""Arrays of many scans, one after another: sums, means and largest values of each scan's piece."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray

Indices = NDArray[np.intp]


@dataclass(frozen=True)  # without slots: some properties are computed once
class Segments:
    """n pieces of flat arrays (..., N): piece k is [starts[k], starts[k + 1]), it may be empty."""

    starts: Indices

    @classmethod
    def of_counts(cls, counts: NDArray[Any]) -> Segments:
        """Pieces with so many items (n,) each."""
        return cls(np.concatenate([[0], np.cumsum(counts)]).astype(np.intp))

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def counts(self) -> Indices:
        """(n,) items of each piece."""
        return np.diff(self.starts)

    @cached_property
    def owner(self) -> Indices:
        """(N,) the piece that each item is in."""
        return np.repeat(np.arange(len(self)), self.counts)

    @cached_property
    def place(self) -> Indices:
        """(N,) number of each item within its piece."""
        return np.arange(int(self.starts[-1])) - self.starts[self.owner]

    @cached_property
    def last(self) -> BoolArray:
        """(N,) whether an item is the last one of its piece."""
        last = np.zeros(int(self.starts[-1]), dtype=np.bool_)
        last[self.starts[1:][self._filled] - 1] = True
        return last

    @cached_property
    def following(self) -> Indices:
        """(N,) the item after each in its piece, the first one after the last."""
        after = np.arange(1, int(self.starts[-1]) + 1)
        after[self.starts[1:][self._filled] - 1] = self._heads
        return after

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """(..., N) for each item the value (..., n) of its piece."""
        return values.take(self.owner, axis=-1)

    @cached_property
    def _filled(self) -> BoolArray | slice:
        """Which pieces are not empty."""
        filled = self.counts > 0
        return slice(None) if filled.all() else filled

    @cached_property
    def _heads(self) -> Indices:
        """The first items of the pieces that are not empty."""
        return self.starts[:-1][self._filled]

    @cached_property
    def _sizes(self) -> FloatArray:
        """(n,) what sums are divided by for a mean: the count, or 1 without any item."""
        return np.maximum(self.counts, 1).astype(np.float64)

    def sum(self, values: NDArray[Any]) -> NDArray[Any]:
        """(..., n) sums of values (..., N), nought where empty; truth values are counted."""
        return self._reduced(np.add, values, np.intp if values.dtype == np.bool_ else values.dtype)

    def mean(self, values: NDArray[Any]) -> NDArray[Any]:
        """(..., n) means of values (..., N), nought where empty."""
        return self.sum(values) / self._sizes

    def max(self, values: FloatArray) -> FloatArray:
        """(..., n) the largest of values (..., N), nought where empty."""
        return self._reduced(np.maximum, values, values.dtype)

    def _reduced(self, function: np.ufunc, values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
        """(..., n) values (..., N) of each piece put together by a function, nought where empty."""
        together = np.zeros((*values.shape[:-1], len(self)), dtype=dtype)
        if len(self._heads):
            reduced = function.reduceat(values, self._heads, axis=-1, dtype=dtype)
            together[..., self._filled] = reduced
        return together

    def argmax(self, values: FloatArray) -> Indices:
        """(n,) the first item with the largest of values (N,), the start of a piece without any."""
        at = self.starts[:-1].copy()
        items = np.flatnonzero(values == self.spread(self.max(values)))[::-1]
        at[self.owner[items]] = items  # of several for one piece, the last written stays
        return at

    def cumsum(self, values: FloatArray) -> FloatArray:
        """(N,) the sum of values (N,) from the first of each piece on, added one by one."""
        sums = np.cumsum(self.padded(values, 0.0), axis=1)
        return np.asarray(sums[self.owner, self.place])

    def padded(self, values: NDArray[Any], fill: float, width: int = 0) -> NDArray[Any]:
        """(..., n, w) values (..., N) in rows, `fill` behind the last; at least `width` columns."""
        widest = int(self.counts.max(initial=width))
        rows = np.full((*values.shape[:-1], len(self), widest), fill, dtype=values.dtype)
        rows[..., self.owner, self.place] = values
        return rows

    def kept(self, mask: BoolArray) -> Segments:
        """The pieces of what is left of flat arrays once only `mask` (N,) of them is kept."""
        return Segments.of_counts(self.sum(mask))


def ratio(above: NDArray[Any], below: NDArray[Any]) -> FloatArray:
    """(n,) quotients, nought where `below` is not above nought."""
    quotients = np.zeros(len(below))
    np.divide(above, below, out=quotients, where=below > 0)
    return quotients

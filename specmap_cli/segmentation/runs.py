"""Runs of cells along the rows of a grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import BoolArray


@dataclass(frozen=True, slots=True)
class Runs:
    """Stretches of the rows of a grid: (n,) their `row`, their `first` and their `last` column."""

    row: IntArray
    first: IntArray
    last: IntArray

    @classmethod
    def of(cls, mask: BoolArray) -> Runs:
        """The longest stretches of set cells of a `mask` (H, W), row by row."""
        steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        row, first = np.nonzero(steps > 0)
        return cls(row, first, np.nonzero(steps < 0)[1] - 1)

    @property
    def lengths(self) -> IntArray:
        """(n,) their numbers of cells."""
        return self.last - self.first + 1

    def those(self, chosen: BoolArray) -> Runs:
        """The runs that are `chosen` (n,)."""
        return Runs(self.row[chosen], self.first[chosen], self.last[chosen])

    def painted(self, shape: tuple[int, ...], values: NDArray[Any]) -> NDArray[Any]:
        """A picture (H, W) with the value (n,) of each run on its cells, and zeros elsewhere.

        Runs without a cell are left out.
        """
        picture = np.zeros(shape, dtype=values.dtype)
        lengths = np.maximum(self.lengths, 0)
        run = np.repeat(np.arange(len(lengths)), lengths)
        along = np.arange(len(run)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        picture[self.row[run], self.first[run] + along] = values[run]
        return picture

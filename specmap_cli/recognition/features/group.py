"""A group of features: one function of scans' returns, and the names of its columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.returns import Returns, ReturnsBatch


class WrongCountError(Exception):
    """A group gives values too few or too many for its columns."""


@dataclass(frozen=True, slots=True)
class FeatureGroup:
    """What `compute` gives of a scan: a value for each of `columns`, in their order.

    The values are finite for every scan, an empty one too, and do not change when the robot turns
    on the spot. `histogram` names those columns that are shares of a histogram of the scan's shape,
    in [0, 1]: `learning.familiarity` tells by them whether a place is known at all.
    """

    compute: Callable[[Returns], Sequence[float]]
    columns: tuple[str, ...]
    histogram: tuple[str, ...] = ()

    def values(self, batch: ReturnsBatch) -> FloatArray:
        """(n, columns) of n scans. WrongCountError when a scan has a value too few or too many."""
        rows = [self.compute(batch[k]) for k in range(len(batch))]
        wrong = next((len(row) for row in rows if len(row) != len(self.columns)), None)
        if wrong is not None:
            raise WrongCountError(f"gives {wrong} values for its {len(self.columns)} columns")
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(self.columns))


@dataclass(frozen=True, slots=True)
class BatchGroup:
    """The same of many scans at once: `compute` gives (n, columns) of n scans.

    A scan's values do not depend on the scans beside it.
    """

    compute: Callable[[ReturnsBatch], FloatArray]
    columns: tuple[str, ...]
    histogram: tuple[str, ...] = ()

    def values(self, batch: ReturnsBatch) -> FloatArray:
        """(n, columns) of n scans. WrongCountError when it is of another shape."""
        values = self.compute(batch)
        if values.shape != (len(batch), len(self.columns)):
            found = " by ".join(map(str, values.shape[1:]))
            raise WrongCountError(f"gives {found} values for its {len(self.columns)} columns")
        return values

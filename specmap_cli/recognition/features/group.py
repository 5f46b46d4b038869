"""A group of features: one function of scans' returns, and the names of its columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.returns import Returns, ReturnsBatch


@dataclass(frozen=True, slots=True)
class FeatureGroup:
    """What `compute` gives of a scan: a value for each of `columns`, in their order.

    The values are finite for every scan, an empty one too, and do not change when the robot turns
    on the spot. `histogram` names those columns that are shares of a histogram of the scan's shape,
    in [0, 1]: `learning.Familiarity` tells by them whether a place is known at all.
    """

    compute: Callable[[Returns], Sequence[float]]
    columns: tuple[str, ...]
    histogram: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class BatchGroup:
    """The same of many scans at once: `compute` gives (n, columns) of n scans.

    A scan's values do not depend on the scans beside it.
    """

    compute: Callable[[ReturnsBatch], FloatArray]
    columns: tuple[str, ...]
    histogram: tuple[str, ...] = ()

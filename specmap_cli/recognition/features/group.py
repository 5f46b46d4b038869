"""A group of features: one function of a scan's returns, and the names of its columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from specmap_cli.recognition.features.returns import Returns


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

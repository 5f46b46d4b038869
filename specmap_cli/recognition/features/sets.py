"""Features of one planar scan: the sets by name and their computation.

`table1` is Table I of the paper; `shape` adds a finer distance histogram, pieces and cut ranges;
`pairs` is Table I with the point-pair histogram; `places` is all of these, which generalise to new
paths, and `full` adds the profile of the ranges, for views like those of the map's own scans. Every
column is documented where its group is defined, finite for every scan, and unchanged by turning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features import point_pairs, profile, shape, table1
from specmap_cli.recognition.features.returns import Outline, outline_of

Group = tuple[Callable[[Outline], list[float]], tuple[str, ...]]

_PAIRS: tuple[Group, ...] = ((point_pairs.point_pair_histogram, point_pairs.NAMES),)
FEATURE_GROUPS: dict[str, tuple[Group, ...]] = {
    "table1": table1.GROUPS,
    "pairs": table1.GROUPS + _PAIRS,
    "shape": table1.GROUPS + shape.GROUPS,
    "places": table1.GROUPS + shape.GROUPS + _PAIRS,
    "full": table1.GROUPS + shape.GROUPS + _PAIRS + profile.GROUPS,
}
FEATURE_SETS: dict[str, tuple[str, ...]] = {
    name: tuple(column for _, columns in groups for column in columns)
    for name, groups in FEATURE_GROUPS.items()
}


def scan_features(scan: PlanarScan, feature_set: str = "full") -> FloatArray:
    """(F,) features of one scan, the columns named by `FEATURE_SETS[feature_set]`; always finite.

    Raises UsageError for a set that does not exist.
    """
    outline = outline_of(scan)
    values: list[float] = []
    for function, _ in _groups(feature_set):
        values += function(outline)
    return np.array(values)


def scans_features(scans: Iterable[PlanarScan], feature_set: str = "full") -> FloatArray:
    """(n, F) features of several scans."""
    rows = [scan_features(scan, feature_set) for scan in scans]
    return np.array(rows).reshape(len(rows), len(FEATURE_SETS[feature_set]))


class KeyframeFeatures:
    """Features of the keyframes of a store, each computed once: some kilobytes a keyframe."""

    def __init__(self, store: KeyframeStore, feature_set: str) -> None:
        self.store, self.feature_set = store, feature_set
        self._rows: dict[int, FloatArray] = {}

    def of(self, numbers: Sequence[int]) -> FloatArray:
        """(n, F) features of some keyframes, by their numbers."""
        for number in numbers:
            if number not in self._rows:
                self._rows[number] = scan_features(self.store.scan(number), self.feature_set)
        return np.array([self._rows[number] for number in numbers])


def _groups(feature_set: str) -> tuple[Group, ...]:
    try:
        return FEATURE_GROUPS[feature_set]
    except KeyError:
        known = ", ".join(sorted(FEATURE_GROUPS))
        raise UsageError(f"unknown feature set {feature_set!r}: choose from {known}") from None

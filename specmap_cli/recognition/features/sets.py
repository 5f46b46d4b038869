"""Features of one planar scan: the sets by name, and their computation.

This table is the one place where sets are named. `table1` is Table I of the paper; `shape` adds a
finer distance histogram, pieces and cut ranges; `pairs` is Table I with the point-pair histogram;
`places` is all of these, which generalise to new paths; `full` adds the profile of the ranges, for
views like those of the map's own scans.

A package adds a set by an entry point of the group `specmap.features` that names a tuple of
`FeatureGroup`, or of `BatchGroup` for many scans at once; the set is then a value of the settings
`feature_set`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import PACKAGE, SETTING, UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.plugins import with_plugins
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features import shape, table1
from specmap_cli.recognition.features.group import BatchGroup, FeatureGroup
from specmap_cli.recognition.features.returns import ReturnsBatch

FeatureSet = tuple[FeatureGroup | BatchGroup, ...]
FeatureArray = NDArray[np.float32]

_KEPT = 4096  # keyframes whose features are kept: those of some sixty visits, 2 MB
_TOGETHER = 32  # scans in a batch: much more of them leave the caches of a processor
_LARGEST = float(np.finfo(np.float32).max)  # moments of odd scans are larger

ENTRY_POINTS = "specmap.features"
BUILT_IN: Mapping[str, FeatureSet] = {
    "table1": table1.GROUPS,
    "pairs": table1.GROUPS + shape.PAIR_GROUPS,
    "shape": table1.GROUPS + shape.GROUPS,
    "places": table1.GROUPS + shape.GROUPS + shape.PAIR_GROUPS,
    "full": table1.GROUPS + shape.GROUPS + shape.PAIR_GROUPS + shape.PROFILE_GROUPS,
}


@cache
def feature_sets() -> Mapping[str, FeatureSet]:
    """The sets by name: those of this package, then those of other packages.

    Read once a process. Raises UsageError for a package whose set cannot be used.
    """
    table = with_plugins(ENTRY_POINTS, BUILT_IN)
    sets: dict[str, FeatureSet] = {}
    for name, groups in table.items():
        listed = tuple(groups) if isinstance(groups, Iterable) else ()
        if not listed or not all(isinstance(group, FeatureGroup | BatchGroup) for group in listed):
            raise _unusable(name, "it is no tuple of FeatureGroup")
        columns = [column for group in listed for column in group.columns]
        if len(set(columns)) < len(columns):
            raise _unusable(name, "two of its columns have one name")
        if not all(g.columns and set(g.histogram) <= set(g.columns) for g in listed):
            raise _unusable(name, "a group has no columns, or histograms that are none of them")
        sets[name] = listed
    return sets


def check_feature_sets(config: Config) -> None:
    """Raise UsageError when a setting names a feature set that does not exist."""
    feature_names(config.recognition.feature_set, "recognition.feature_set")
    feature_names(config.localization.feature_set, "localization.feature_set")


def feature_names(feature_set: str, setting: str = "feature_set") -> tuple[str, ...]:
    """The names (F,) of a set's columns.

    Raises UsageError for a set that does not exist; `setting` is the key that named it.
    """
    groups = _groups_of(feature_set, setting)
    return tuple(column for group in groups for column in group.columns)


def histogram_columns(feature_set: str) -> list[int]:
    """Numbers of a set's columns that are histograms of the scan's shape, ascending."""
    wanted = {name for group in _groups_of(feature_set) for name in group.histogram}
    return [k for k, name in enumerate(feature_names(feature_set)) if name in wanted]


def scans_features(scans: Iterable[PlanarScan], feature_set: str) -> FeatureArray:
    """(n, F) features of scans, in the order of `feature_names(feature_set)`; always finite.

    They are rounded to single precision, and cut to its largest numbers. A processor that rounds a
    sum, a cosine or a logarithm otherwise changes only digits beyond it, and so no threshold that
    is learned from them.

    Raises UsageError for a set that does not exist, and for one whose functions break their word.
    """
    names, groups = feature_names(feature_set), _groups_of(feature_set)
    rows = [np.zeros((0, len(names)), dtype=np.float32)]
    left = iter(scans)
    while some := list(islice(left, _TOGETHER)):
        batch, parts = ReturnsBatch.of(some), []
        for group in groups:
            if isinstance(group, BatchGroup):
                values: Sequence[Sequence[float]] | FloatArray = group.compute(batch)
            else:
                values = [group.compute(batch[k]) for k in range(len(batch))]
            shapes, wanted = [np.shape(row) for row in values], (len(group.columns),)
            if shapes != [wanted] * len(batch):
                shape = next((one for one in shapes if one != wanted), np.shape(values))
                found = " by ".join(map(str, shape))
                raise _unusable(
                    feature_set,
                    f"the group of {group.columns[0]!r} gives {found} values for its "
                    f"{len(group.columns)} columns",
                )
            parts.append(np.asarray(values, dtype=np.float64))
        features = np.hstack(parts)
        finite = np.isfinite(features).all(axis=0)
        if not finite.all():
            first = names[int(np.argmin(finite))]
            raise _unusable(feature_set, f"{first!r} is not finite for a scan")
        cut = np.clip(features, -_LARGEST, _LARGEST)
        rows.append(cut.astype(np.float32))
    return np.vstack(rows)


class KeyframeFeatures:
    """Features of the keyframes of a store, each computed once while there is room.

    The first `most` are kept, half a kilobyte each. A robot that drives on all day has others
    computed again when they are asked for again.
    """

    def __init__(self, store: KeyframeStore, feature_set: str, most: int = _KEPT) -> None:
        self.store = store
        self.feature_set = feature_set
        self.most = most
        self._rows: dict[int, FeatureArray] = {}

    def among(self, store: KeyframeStore, first: int) -> KeyframeFeatures:
        """What is known, for a store that holds the same keyframes from number `first` on."""
        moved = KeyframeFeatures(store, self.feature_set, self.most)
        moved._rows = {number + first: row for number, row in self._rows.items()}
        return moved

    def knowing(self, numbers: NDArray[np.intp], features: NDArray[Any]) -> KeyframeFeatures:
        """What is known, with the features (k, F) of other keyframes (k,) of the store besides."""
        more = KeyframeFeatures(self.store, self.feature_set, self.most)
        others = dict(zip(numbers.tolist(), features.astype(np.float32), strict=True))
        more._rows = others | self._rows
        return more

    def known(self, numbers: Sequence[int]) -> list[int]:
        """Those of some keyframes whose features were computed already, in their order."""
        return [number for number in numbers if number in self._rows]

    def of(self, numbers: Sequence[int]) -> FeatureArray:
        """(n, F) features of some keyframes, by their numbers."""
        missing = [number for number in dict.fromkeys(numbers) if number not in self._rows]
        features = scans_features((self.store.scan(k) for k in missing), self.feature_set)
        new = dict(zip(missing, features, strict=True))
        rows = [self._rows[k] if k in self._rows else new[k] for k in numbers]
        self._rows.update(islice(new.items(), max(0, self.most - len(self._rows))))
        values = np.array(rows, dtype=np.float32)
        return values.reshape(len(numbers), len(feature_names(self.feature_set)))


def _groups_of(feature_set: str, setting: str = "feature_set") -> FeatureSet:
    table = feature_sets()
    if feature_set not in table:
        raise UsageError(
            f"unknown feature set {feature_set!r}",
            f"choose from {', '.join(sorted(table))}, or install the package that offers it",
            where=setting,
            code=SETTING,
        )
    return table[feature_set]


def _unusable(name: str, why: str) -> UsageError:
    return UsageError(
        f"feature set {name!r}: {why}",
        "mend or remove the package that offers it",
        mark=";",
        code=PACKAGE,
    )

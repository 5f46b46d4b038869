"""Does a scan look like any place of the map? The distance to the nearest of a few exemplars.

The margins of one-against-all classifiers say which submap fits best, not whether any does: a scan
of another building falls on some side of every threshold. The distance between histograms does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.sets import histogram_columns
from specmap_cli.recognition.learning.boosting import WrongPartError

_STEPS = 255  # square roots of shares are stored as whole numbers of 1 / 255
_MOST_LEFT = 600  # samples that the limit is taken from: enough for a quantile, and quick
_LEAST_LEFT = 20  # fewer of them say nothing about a quantile
_STRETCH_SHARE = 0.1  # of a submap's samples, before and after one that is held out
_TINY = 1e-9  # keeps a limit of nought, when all samples are alike, from dividing


class Familiarity:
    """Exemplars of a map's places; distance is the L1 distance of the square roots of histograms.

    `fit` keeps at most `per_submap` samples of a submap as exemplars. It learns `exemplars_`
    (k, D), whole numbers from 0 to 255, and `limit_`, the distance past which a scan looks like no
    place of the map: all but a share of `false_unknown` of the other samples lie within it. These
    are held out by stretches: exemplars taken just before or after one do not count for it. The
    fewer they are, the wider is the limit: by a standard error of the share.
    """

    def __init__(self, feature_set: str, false_unknown: float = 0.05, per_submap: int = 80) -> None:
        self.feature_set = feature_set
        self.false_unknown = false_unknown
        self.per_submap = per_submap
        self.exemplars_: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)
        self.limit_ = math.nan
        self._columns = histogram_columns(feature_set)
        self._places: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)

    def can_fit(self, samples: Mapping[int, FloatArray]) -> bool:
        """Whether the feature set holds histograms, and enough samples are left for a limit."""
        left = sum(len(X) - len(self._chosen(len(X))) for X in samples.values())
        return bool(self._columns) and left >= _LEAST_LEFT

    def fit(self, samples: Mapping[int, FloatArray]) -> Familiarity:
        """Learn from the features (n, F) of every submap's samples in turn; returns self."""
        chosen = {i: self._chosen(len(X)) for i, X in sorted(samples.items())}
        kept = np.vstack([samples[i][rows] for i, rows in chosen.items()])
        self._keep(np.round(self._roots(kept) * _STEPS).astype(np.uint8))
        # of samples that are no exemplars: how far the nearest one of another stretch is
        owners = np.concatenate([np.full(len(rows), i) for i, rows in chosen.items()])
        numbers = np.concatenate(list(chosen.values()))
        left = [
            (i, k)
            for i, X in sorted(samples.items())
            for k in np.setdiff1d(np.arange(len(X)), chosen[i])
        ]
        found = []
        for i, k in evenly(np.array(left), _MOST_LEFT).tolist():
            stretch = _STRETCH_SHARE * len(samples[i])
            other = (owners != i) | (np.abs(numbers - k) > stretch)
            if other.any():
                row = self._roots(np.asarray(samples[i][k : k + 1], dtype=np.float32))
                found.append(np.abs(self._places[other] - row).sum(axis=1).min())
        share = self.false_unknown
        error = math.sqrt(share * (1.0 - share) / len(found))  # of a share that n samples show
        within = np.quantile(np.array(found, dtype=np.float64), min(1.0, 1.0 - share + error))
        self.limit_ = round(float(within), 6)
        return self

    def strangeness(self, X: NDArray[Any]) -> FloatArray:
        """(n,) distance of features X (n, F) over the limit: above one where nothing fits."""
        roots = self._roots(np.asarray(X, dtype=np.float32))
        nearest = [np.abs(self._places - row).sum(axis=1).min() for row in roots]
        return np.array(nearest, dtype=np.float64) / max(self.limit_, _TINY)

    def to_dict(self) -> dict[str, Any]:
        """Limit and exemplars, ready for JSON."""
        return {"limit": self.limit_, "rows": [row.tobytes().hex() for row in self.exemplars_]}

    @classmethod
    def of(cls, feature_set: str, limit: float, rows: Sequence[str], where: str) -> Familiarity:
        """What `to_dict` described. Raises WrongPartError for rows that are not of the set."""
        known = cls(feature_set)
        width = len(known._columns)
        if not width or any(len(row) != 2 * width for row in rows):
            raise WrongPartError(f"{where}: rows are not of {width} values")
        coded = np.frombuffer(bytes.fromhex("".join(rows)), dtype=np.uint8)
        known._keep(coded.reshape(-1, width))
        known.limit_ = limit
        return known

    def _keep(self, exemplars: NDArray[np.uint8]) -> None:
        # column by column in memory, learned or from a file: sums are the same to the last bit
        self.exemplars_ = np.asfortranarray(exemplars)
        self._places = self.exemplars_.astype(np.float32) / np.float32(_STEPS)

    def _chosen(self, count: int) -> NDArray[np.intp]:
        """Which of `count` samples become exemplars: evenly spread, at most half of them."""
        return evenly(np.arange(count), min(self.per_submap, (count + 1) // 2))

    def _roots(self, X: NDArray[Any]) -> NDArray[Any]:
        """(n, D) square roots of the histograms of features X (n, F)."""
        return np.asarray(np.sqrt(np.clip(X[:, self._columns], 0.0, 1.0)))

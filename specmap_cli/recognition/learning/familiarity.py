"""Does a scan look like any place of the map? The distance to the nearest of a few exemplars.

The margins of one-against-all classifiers say which submap fits best, not whether any does: a scan
of another building falls on some side of every threshold. The distance between histograms does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.sampling import evenly
from specmap_cli.recognition.features.sets import FEATURE_SETS
from specmap_cli.recognition.learning.json_fields import number, objects, refuse

PER_SUBMAP = 80
_HISTOGRAMS = ("pairs_", "distance_", "fine_distance_")
_STEPS = 255  # square roots of shares are stored as whole numbers of 1 / 255


class Familiarity:
    """Exemplars of a map's places; `distance` is the L1 distance of the square roots of histograms.

    `limit` is the distance past which a scan looks like no place of the map; `exemplars` (k, D)
    whole numbers from 0 to 255.
    """

    def __init__(self, feature_set: str, exemplars: NDArray[Any], limit: float) -> None:
        self.feature_set = feature_set
        self.exemplars = np.asarray(exemplars, dtype=np.uint8)
        self.limit = limit
        self._columns = _columns(feature_set)
        self._places = self.exemplars.astype(np.float32) / _STEPS

    @classmethod
    def of(
        cls,
        feature_set: str,
        samples: Mapping[int, FloatArray],
        false_unknown: float,
    ) -> Familiarity | None:
        """Exemplars of every submap's samples (n, F), the limit from the samples left over.

        All but a share of `false_unknown` of these lie within it. None when the set has no
        histograms, or when there are too few samples.
        """
        if not _columns(feature_set):
            return None
        chosen = {
            i: evenly(np.arange(len(X)), min(PER_SUBMAP, (len(X) + 1) // 2))
            for i, X in sorted(samples.items())
        }
        rest = [np.delete(X, chosen[i], axis=0) for i, X in sorted(samples.items())]
        left = evenly(np.vstack(rest), 600)
        if len(left) < 20:
            return None
        known = cls(
            feature_set,
            _coded(np.vstack([samples[i][rows] for i, rows in chosen.items()]), feature_set),
            0.0,
        )
        known.limit = round(float(np.quantile(known.distance(left), 1.0 - false_unknown)), 6)
        return known

    def distance(self, X: NDArray[Any]) -> FloatArray:
        """(n,) distance of features X (n, F) to the nearest exemplar."""
        roots = np.sqrt(np.asarray(X, dtype=np.float32)[:, self._columns])
        nearest = [np.abs(self._places - row).sum(axis=1).min() for row in roots]
        return np.array(nearest, dtype=np.float64)

    def strangeness(self, X: NDArray[Any]) -> FloatArray:
        """(n,) distance over the limit: above one where nothing fits."""
        return self.distance(X) / max(self.limit, 1e-9)

    def to_dict(self) -> dict[str, Any]:
        """Limit and exemplars, ready for JSON."""
        return {"limit": self.limit, "rows": [row.tobytes().hex() for row in self.exemplars]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], feature_set: str) -> Familiarity:
        """What `to_dict` described; MapError names what makes no sense."""
        limit = number(data, "limit", "exemplars")
        width = len(_columns(feature_set))
        rows = objects(data, "rows", "exemplars")
        try:
            coded = [np.frombuffer(bytes.fromhex(row), dtype=np.uint8) for row in rows]
        except (TypeError, ValueError):
            raise refuse("exemplars", "a row is no hexadecimal text") from None
        if not coded or any(len(row) != width for row in coded) or limit < 0.0 or not width:
            raise refuse("exemplars", f"rows are not of {width} values")
        return cls(feature_set, np.array(coded), limit)


def _columns(feature_set: str) -> list[int]:
    """The columns of a feature set that are histograms of the scan's shape."""
    names = FEATURE_SETS[feature_set]
    return [k for k, name in enumerate(names) if name.startswith(_HISTOGRAMS)]


def _coded(X: FloatArray, feature_set: str) -> NDArray[np.uint8]:
    """(n, D) square roots of the histograms as whole numbers."""
    return np.round(np.sqrt(X[:, _columns(feature_set)]) * _STEPS).astype(np.uint8)

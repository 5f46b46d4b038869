"""Claims between submaps, eq. 4 and 5 of the paper, and the ranking of candidates by them.

What grows is kept small: a submap's classifier is trained again only when the map has grown, the
new submap's classifier is trained once for each of a few groups of old submaps and applied to the
group that was left out, and negatives are capped and evenly spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.config import RecognitionConfig
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.sampling import evenly
from specmap_cli.recognition.features.sets import FEATURE_SETS
from specmap_cli.recognition.learning.boosting import Booster, StumpBoost
from specmap_cli.recognition.learning.trees import CodeArray, Quantiser, TreeBoost

IndexArray = NDArray[np.intp]

_QUANTISED_FROM = 4000


@dataclass(frozen=True, slots=True)
class Claims:
    """How two submaps claim each other's scans: fractions of eq. 4, xi of eq. 5.

    `rank` orders candidates: the product of the mean chances instead of the fractions claimed, and
    `by_member` (k,) the second factor for every visit of the old submap.
    """

    new_by_old: float
    old_by_new: float
    rank: float
    by_member: FloatArray

    @property
    def xi(self) -> float:
        """The similarity of eq. 5."""
        return self.new_by_old * self.old_by_new  # eq. 5


@dataclass(slots=True)
class _Scans:
    """One visit's features (n, F), and their bins (F, n) once they are cut."""

    features: FloatArray
    codes: CodeArray | None = None

    def __len__(self) -> int:
        return len(self.features)


class ClaimRanker:
    """Scans and classifiers of the submaps so far, and a new one's claims on each of them."""

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.rng = rng
        self._submaps: dict[int, list[_Scans]] = {}
        self._classifiers: dict[int, tuple[int, int, Booster]] = {}
        self._quantiser: Quantiser | None = None
        self._quantised_at = 0

    def remember(self, submap: int, features: FloatArray) -> None:
        """A submap with the features (n, F) of its scans becomes one of the old ones."""
        self._submaps[submap] = [_Scans(features)]

    def merge(self, kept: int, gone: int) -> None:
        """The visits of submap `gone` become visits of `kept`."""
        self._submaps[kept].extend(self._submaps.pop(gone))
        self._classifiers.pop(gone, None)

    def claims(self, features: FloatArray) -> dict[int, Claims]:
        """The claims between a new submap's scans (n, F) and every old submap.

        With a single old submap there is nothing to tell it apart from: both claim all (the paper
        waits for a second one).
        """
        ids = sorted(self._submaps)
        if len(ids) < 2:
            return {i: Claims(1.0, 1.0, 1.0, np.ones(len(self._submaps[i]))) for i in ids}
        new = _Scans(features)
        self._quantise(new)
        groups = self.config.groups or len(ids)
        found: dict[int, Claims] = {}
        for group in range(min(groups, len(ids))):
            inside = ids[group::groups]
            rest = [i for i in ids if i not in inside]
            c_new = self._train([new], rest)
            for i in inside:
                found[i] = self._claim(c_new, self._classifier(i, ids), new, self._submaps[i])
        return found

    def _claim(
        self, c_new: Booster, c_old: Booster, new: _Scans, visits: Sequence[_Scans]
    ) -> Claims:
        of_new = c_old.margins(new.features)
        of_visits = [c_new.margins(visit.features) for visit in visits]
        of_old = np.concatenate(of_visits)
        by_member = np.array([_chance(margins) for margins in of_visits])
        return Claims(
            float((of_new > 0.0).mean()),  # eq. 4
            float((of_old > 0.0).mean()),  # eq. 4
            _chance(of_new) * float(by_member.max()),
            by_member,
        )

    def _classifier(self, submap: int, ids: Sequence[int]) -> Booster:
        """The old submap's classifier, trained again when the map or the submap has grown."""
        own = sum(len(visit) for visit in self._submaps[submap])
        cached = self._classifiers.get(submap)
        growth = 1.0 + self.config.refresh_growth
        if cached is not None and growth > 1.0:
            trained_among, trained_on, booster = cached
            if len(ids) < trained_among * growth and own < trained_on * growth:
                return booster
        booster = self._train(self._submaps[submap], [i for i in ids if i != submap])
        self._classifiers[submap] = (len(ids), own, booster)
        return booster

    def _train(self, own: Sequence[_Scans], others: Sequence[int]) -> Booster:
        """One submap's visits against other submaps, whose scans are thinned evenly to the cap."""
        config = self.config
        positive = _thinned(own, 2 * config.samples_per_submap)
        visits = [visit for i in others for visit in self._submaps[i]]
        negative = _thinned(visits, config.closure_negatives)
        y = np.repeat([1.0, -1.0], [sum(len(r) for _, r in part) for part in (positive, negative)])
        chosen = [*positive, *negative]
        names = FEATURE_SETS[config.feature_set]
        if config.booster == "stumps":
            X = np.vstack([visit.features[rows] for visit, rows in chosen])
            return StumpBoost(names, config.closure_rounds).fit(X, y)
        assert self._quantiser is not None
        codes = [v.codes[:, rows] for v, rows in chosen if v.codes is not None]
        seed = int(self.rng.integers(2**31))
        booster = TreeBoost(
            names, config.closure_rounds, config.closure_shrinkage, config.feature_share, seed
        )
        return booster.fit_codes(np.concatenate(codes, axis=1), self._quantiser, y)

    def _quantise(self, new: _Scans) -> None:
        """Cut the features of what is new; of everything, and anew, once the map has doubled."""
        if self.config.booster == "stumps":
            return
        visits = [visit for i in sorted(self._submaps) for visit in self._submaps[i]]
        if self._quantiser is None or len(visits) >= 2 * self._quantised_at:
            most = max(1, _QUANTISED_FROM // (len(visits) + 1))
            sampled = [evenly(visit.features, most) for visit in (*visits, new)]
            self._quantiser = Quantiser.of(np.vstack(sampled))
            self._quantised_at = len(visits)
            for visit in visits:
                visit.codes = None
        for visit in (*visits, new):
            if visit.codes is None:
                visit.codes = self._quantiser.codes(visit.features)


def _thinned(visits: Sequence[_Scans], most: int) -> list[tuple[_Scans, IndexArray]]:
    """At most `most` scans, evenly spread over the visits: each visit with its rows."""
    starts = np.concatenate([[0], np.cumsum([len(visit) for visit in visits])]).astype(np.intp)
    chosen = evenly(np.arange(int(starts[-1])), most)
    bounds = np.searchsorted(chosen, starts)
    return [
        (visit, chosen[a:b] - start)
        for visit, start, a, b in zip(visits, starts[:-1], bounds[:-1], bounds[1:], strict=True)
        if b > a
    ]


def _chance(margins: FloatArray) -> float:
    """Mean of the logistic function of the margins (n,); 0 without any."""
    return float((1.0 / (1.0 + np.exp(-margins))).mean()) if len(margins) else 0.0

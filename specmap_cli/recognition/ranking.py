"""Claims between submaps, eq. 4 and 5 of the paper, and the ranking of candidates by them.

What grows is kept small: a submap's classifier is trained again only when the map has grown, the
new submap's classifier is trained once for each of a few groups of old submaps and applied to the
group that was left out, and negatives are capped and evenly spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.config import RecognitionConfig
from specmap_cli.geometry import FloatArray
from specmap_cli.recognition.boosting import Booster, StumpBoost
from specmap_cli.recognition.features import FEATURE_SETS
from specmap_cli.recognition.sampling import evenly
from specmap_cli.recognition.trees import CodeArray, Quantiser, TreeBoost


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


class ClaimRanker:
    """Classifiers of the submaps so far, and the claims between a new one and each of them.

    Submaps are lists of visits, each visit the features (n, F) of its scans.
    """

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.rng = rng
        self._classifiers: dict[int, tuple[int, int, Booster]] = {}
        self._quantiser: Quantiser | None = None
        self._quantised_at = 0
        self._codes: dict[int, CodeArray] = {}

    def claims(self, new: FloatArray, old: dict[int, list[FloatArray]]) -> dict[int, Claims]:
        """The claims between a new submap's scans (n, F) and every old submap.

        With a single old submap there is nothing to tell it apart from: both claim all (the paper
        waits for a second one).
        """
        ids = sorted(old)
        if len(ids) < 2:
            return {i: Claims(1.0, 1.0, 1.0, np.ones(len(old[i]))) for i in ids}
        pooled = {i: np.vstack(old[i]) for i in ids}
        self._prepare(pooled, new)
        groups = self.config.groups or len(ids)
        found: dict[int, Claims] = {}
        for group in range(min(groups, len(ids))):
            inside = ids[group::groups]
            rest = [i for i in ids if i not in inside]
            c_new = self._train(new, [pooled[i] for i in rest])
            for i in inside:
                found[i] = self._claim(c_new, self._classifier(i, pooled), new, old[i])
        return found

    def forget(self, submap: int) -> None:
        """Drop the classifier of a submap that was merged into another."""
        self._classifiers.pop(submap, None)

    def _claim(
        self, c_new: Booster, c_old: Booster, new: FloatArray, visits: Sequence[FloatArray]
    ) -> Claims:
        of_new = c_old.margins(new)
        of_visits = [c_new.margins(visit) for visit in visits]
        of_old = np.concatenate(of_visits)
        by_member = np.array([_chance(margins) for margins in of_visits])
        return Claims(
            float((of_new > 0.0).mean()),  # eq. 4
            float((of_old > 0.0).mean()),  # eq. 4
            _chance(of_new) * float(by_member.max()),
            by_member,
        )

    def _classifier(self, submap: int, pooled: dict[int, FloatArray]) -> Booster:
        """The old submap's classifier, trained again when the map or the submap has grown."""
        own = len(pooled[submap])
        cached = self._classifiers.get(submap)
        if cached is not None:
            grown = len(pooled) >= cached[0] * (1.0 + self.config.refresh_growth) + 1e-9
            if not grown and own < cached[1] * (1.0 + self.config.refresh_growth) + 1:
                return cached[2]
        others = [pooled[i] for i in sorted(pooled) if i != submap]
        booster = self._train(pooled[submap], others)
        self._classifiers[submap] = (len(pooled), own, booster)
        return booster

    def _train(self, positive: FloatArray, others: Sequence[FloatArray]) -> Booster:
        """One submap against others, whose scans are thinned evenly to the cap."""
        config = self.config
        counts = np.array([len(o) for o in others])
        chosen = evenly(np.arange(int(counts.sum())), config.closure_negatives)
        starts = np.concatenate([[0], np.cumsum(counts)])
        negative = np.vstack(
            [
                o[chosen[(chosen >= a) & (chosen < b)] - a]
                for o, a, b in zip(others, starts[:-1], starts[1:], strict=True)
            ]
        )
        positive = evenly(positive, 2 * config.samples_per_submap)
        X = np.vstack([positive, negative])
        y = np.concatenate([np.ones(len(positive)), -np.ones(len(negative))])
        names = FEATURE_SETS[config.feature_set]
        if config.booster == "stumps":
            return StumpBoost(names, config.closure_rounds).fit(X, y)
        assert self._quantiser is not None
        booster = TreeBoost(
            names,
            config.closure_rounds,
            config.closure_shrinkage,
            config.feature_share,
            int(self.rng.integers(2**31)),
        )
        return booster.fit_codes(self._quantiser.codes(X), self._quantiser, y)

    def _prepare(self, pooled: dict[int, FloatArray], new: FloatArray) -> None:
        """Cut the features anew whenever the map has doubled."""
        if self.config.booster == "stumps" or len(pooled) < 2 * self._quantised_at:
            return
        everything = np.vstack([*(pooled[i] for i in sorted(pooled)), new])
        self._quantiser = Quantiser.of(evenly(everything, 4000))
        self._quantised_at = len(pooled)


def _chance(margins: FloatArray) -> float:
    """Mean of the logistic function of the margins (n,); 0 without any."""
    return float((1.0 / (1.0 + np.exp(-margins))).mean()) if len(margins) else 0.0

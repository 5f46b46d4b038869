"""Claims between submaps, eq. 4 and 5 of the paper, and the ranking of candidates by them.

What grows is kept small. A submap's classifier is trained again only when the map has grown. The
new submap's classifier is trained once for each of a few groups of old submaps, and applied to the
group that was left out. Negatives are capped and evenly spread.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.sampling import evenly
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import Booster, StumpBoost
from specmap_cli.recognition.learning.trees import CodeArray, Quantiser, TreeBoost

IndexArray = NDArray[np.intp]

_OWN_SAMPLES = 2  # times samples_per_submap: of all stays of the submap that is trained
_QUANTISED_FROM = 4000  # scans that the bins are cut from: enough for quantiles of 32 bins
_QUANTISED_GROWTH = 2  # the bins are cut anew once there are this many times the stays


@dataclass(frozen=True, slots=True, kw_only=True)
class Claims:
    """How two submaps claim each other's scans: fractions of eq. 4, xi of eq. 5.

    `rank` orders candidates: the product of the mean chances instead of the fractions claimed, and
    `by_stay` (k,) the second factor for every stay of the old submap.
    """

    new_by_old: float
    old_by_new: float
    rank: float
    by_stay: FloatArray

    @property
    def xi(self) -> float:
        """The similarity of eq. 5."""
        return self.new_by_old * self.old_by_new  # eq. 5

    @classmethod
    def alike(cls, share: float, stays: int) -> Claims:
        """Both submaps claim `share` of the other's scans, those of each of its stays."""
        return cls(new_by_old=share, old_by_new=share, rank=share, by_stay=np.full(stays, share))


@dataclass(frozen=True, slots=True)
class _Scans:
    """One stay's features (n, F), and their bins (F, n) once they are cut."""

    features: FloatArray
    codes: CodeArray | None = None

    def __len__(self) -> int:
        return len(self.features)


@dataclass(frozen=True, slots=True)
class _Trained:
    """An old submap's classifier, with the submaps there were and the scans of its own it saw."""

    booster: Booster
    among: int
    scans: int


class ClaimRanker:
    """Scans and classifiers of the submaps so far, and a new one's claims on each of them."""

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.rng = rng
        self._submaps: dict[int, list[_Scans]] = {}
        self._classifiers: dict[int, _Trained] = {}
        self._quantiser: Quantiser | None = None
        self._quantised_at = 0

    def remember(self, submap: int, features: FloatArray) -> None:
        """A submap with the features (n, F) of its scans becomes one of the old ones."""
        self._submaps[submap] = [_Scans(features)]

    def merge(self, kept: int, gone: int, remembered: Iterable[int] | None = None) -> None:
        """The stays of submap `gone` become stays of `kept`.

        Only those `remembered` are kept (None: all), by their numbers when those of `kept` come
        first.
        """
        stays = [*self._submaps[kept], *self._submaps.pop(gone)]
        self._submaps[kept] = stays if remembered is None else [stays[k] for k in remembered]
        self._classifiers.pop(gone, None)

    def claims(self, features: FloatArray) -> dict[int, Claims]:
        """The claims between a new submap's scans (n, F) and every old submap.

        With a single old submap there is nothing to tell it apart from: both claim all (the paper
        waits for a second one).
        """
        ids = sorted(self._submaps)
        if len(ids) < 2:
            return {i: Claims.alike(1.0, len(self._submaps[i])) for i in ids}
        new = self._quantised(_Scans(features))
        groups = self.config.groups or len(ids)
        found: dict[int, Claims] = {}
        for group in range(min(groups, len(ids))):
            inside = ids[group::groups]
            rest = [i for i in ids if i not in inside]
            c_new = self._train([new], rest)
            for i in inside:
                c_old = self._classifier(i, ids)
                found[i] = _claims(c_new, c_old, new, self._submaps[i])
        return found

    def _classifier(self, submap: int, ids: Sequence[int]) -> Booster:
        """The old submap's classifier, trained again when the map or the submap has grown."""
        own = sum(len(scans) for scans in self._submaps[submap])
        before = self._classifiers.get(submap)
        growth = 1.0 + self.config.refresh_growth
        # without growth allowed, nothing is kept: these are never less than themselves
        if before is not None and len(ids) < before.among * growth and own < before.scans * growth:
            return before.booster
        booster = self._train(self._submaps[submap], [i for i in ids if i != submap])
        self._classifiers[submap] = _Trained(booster, len(ids), own)
        return booster

    def _train(self, own: Sequence[_Scans], others: Sequence[int]) -> Booster:
        """One submap's stays against other submaps, whose scans are thinned evenly to the cap."""
        config = self.config
        positive = _thinned(own, _OWN_SAMPLES * config.samples_per_submap)
        stays = [scans for i in others for scans in self._submaps[i]]
        negative = _thinned(stays, config.closure_negatives)
        y = np.repeat([1.0, -1.0], [sum(len(r) for _, r in part) for part in (positive, negative)])
        chosen = [*positive, *negative]
        names = feature_names(config.feature_set)
        if config.booster == "stumps":
            X = np.vstack([scans.features[rows] for scans, rows in chosen])
            return StumpBoost(names, config.closure_rounds).fit(X, y)
        assert self._quantiser is not None
        codes = [scans.codes[:, rows] for scans, rows in chosen if scans.codes is not None]
        seed = int(self.rng.integers(2**31))
        booster = TreeBoost(
            names, config.closure_rounds, config.closure_shrinkage, config.feature_share, seed
        )
        return booster.fit_codes(np.concatenate(codes, axis=1), self._quantiser, y)

    def _quantised(self, new: _Scans) -> _Scans:
        """The new scans cut into bins, after all old ones have theirs; stumps need none.

        The bins are cut anew, for all scans, once the map has doubled.
        """
        if self.config.booster == "stumps":
            return new
        stays = [scans for i in sorted(self._submaps) for scans in self._submaps[i]]
        anew = self._quantiser is None or len(stays) >= _QUANTISED_GROWTH * self._quantised_at
        if self._quantiser is None or anew:
            most = max(1, _QUANTISED_FROM // (len(stays) + 1))
            sampled = [evenly(scans.features, most) for scans in (*stays, new)]
            self._quantiser = Quantiser.of(np.vstack(sampled))
            self._quantised_at = len(stays)
        quantiser = self._quantiser
        for i, own in self._submaps.items():
            self._submaps[i] = [_cut(scans, quantiser, anew) for scans in own]
        return _cut(new, quantiser, anew)


def _cut(scans: _Scans, quantiser: Quantiser, anew: bool) -> _Scans:
    """The scans with their bins; those that have some keep them unless cut anew."""
    if scans.codes is not None and not anew:
        return scans
    return replace(scans, codes=quantiser.codes(scans.features))


def _claims(c_new: Booster, c_old: Booster, new: _Scans, stays: Sequence[_Scans]) -> Claims:
    """The claims between a new submap and the stays of an old one by their two classifiers."""
    of_new = c_old.margins(new.features)
    of_stays = [c_new.margins(scans.features) for scans in stays]
    of_old = np.concatenate(of_stays)
    by_stay = np.array([_chance(margins) for margins in of_stays])
    return Claims(
        new_by_old=float((of_new > 0.0).mean()),  # eq. 4
        old_by_new=float((of_old > 0.0).mean()),  # eq. 4
        rank=_chance(of_new) * float(by_stay.max()),
        by_stay=by_stay,
    )


def _thinned(stays: Sequence[_Scans], most: int) -> list[tuple[_Scans, IndexArray]]:
    """At most `most` scans, evenly spread over the stays: each stay with its rows."""
    starts = np.concatenate([[0], np.cumsum([len(scans) for scans in stays])]).astype(np.intp)
    chosen = evenly(np.arange(int(starts[-1])), most)
    bounds = np.searchsorted(chosen, starts)
    return [
        (scans, chosen[a:b] - start)
        for scans, start, a, b in zip(stays, starts[:-1], bounds[:-1], bounds[1:], strict=True)
        if b > a
    ]


def _chance(margins: FloatArray) -> float:
    """Mean of the logistic function of the margins (n,); 0 without any."""
    return float((1.0 / (1.0 + np.exp(-margins))).mean()) if len(margins) else 0.0

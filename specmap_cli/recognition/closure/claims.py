"""Claims between submaps, eq. 4 and 5 of the paper, and the ranking of candidates by them.

What grows is kept small. A submap's classifier is trained again only when the map has grown. The
new submap's classifier is trained once for each of a few groups of old submaps, and applied to the
group that was left out. All classifiers that a new submap asks for are trained together, and take
their negatives from one pool, to which every submap gives alike: it is as large in a large building
as in a small one, and after many rounds as after the first.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import Booster, boosted, boosted_trees
from specmap_cli.recognition.learning.trees import CodeArray, Quantiser, Question

SAMPLES_PER_SUBMAP = 60  # scans of a submap used for ranking

IndexArray = NDArray[np.intp]

_POOL = 1.5  # times closure_negatives: as many are left without a group, of three
_LEAST_ASKED = 8  # scans of a stay: a mean of chances to a tenth or two
_OWN_SAMPLES = 2  # times SAMPLES_PER_SUBMAP: of all stays of the submap that is trained
_QUANTISED_FROM = 4000  # scans that the bins are cut from: enough for the quantiles of 16 bins
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

    features: NDArray[Any]
    codes: CodeArray | None = None

    def __len__(self) -> int:
        return len(self.features)

    def taken(self, rows: IndexArray) -> _Scans:
        """Some of the scans."""
        codes = None if self.codes is None else self.codes[:, rows]
        return _Scans(self.features[rows], codes)

    @classmethod
    def joined(cls, parts: Sequence[_Scans]) -> _Scans:
        """The scans of several, one after the other; with bins if all of them have some."""
        codes = [scans.codes for scans in parts if scans.codes is not None]
        features = np.concatenate([scans.features for scans in parts])
        cut = np.concatenate(codes, axis=1) if len(codes) == len(parts) else None
        return cls(features, cut)


@dataclass(frozen=True, slots=True)
class _Trained:
    """An old submap's classifier, with the submaps there were and the scans of its own it saw."""

    booster: Booster
    among: int
    scans: int


@dataclass(frozen=True, slots=True)
class _Pool:
    """Scans of all old submaps, some of each: what classifiers take their negatives from."""

    scans: _Scans
    owner: IndexArray  # (n,) the submap of each

    def without(self, submaps: Collection[int], most: int) -> IndexArray:
        """The rows of at most `most` scans of other submaps than these, evenly spread."""
        return evenly(np.flatnonzero(~np.isin(self.owner, list(submaps))), most)


class ClaimRanker:
    """Scans and classifiers of the submaps so far, and a new one's claims on each of them."""

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.rng = rng
        self._submaps: dict[int, list[_Scans]] = {}
        self._classifiers: dict[int, _Trained] = {}
        self._quantiser: Quantiser | None = None
        self._quantised_at = 0

    def remember(self, submap: int, features: NDArray[Any]) -> None:
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

    def claims(self, features: NDArray[Any]) -> dict[int, Claims]:
        """The claims between a new submap's scans (n, F) and every old submap.

        With a single old submap there is nothing to tell it apart from: both claim all (the paper
        waits for a second one).
        """
        ids = sorted(self._submaps)
        if len(ids) < 2:
            return {i: Claims.alike(1.0, len(self._submaps[i])) for i in ids}
        new = self._quantised(_Scans(features))
        count = min(self.config.groups or len(ids), len(ids))
        groups = [ids[k::count] for k in range(count)]
        c_new = self._taught(new, groups, ids)
        return {
            i: _claims(c_new[k], self._classifiers[i].booster, new, self._asked(i))
            for k, group in enumerate(groups)
            for i in group
        }

    def _taught(
        self, new: _Scans, groups: Sequence[Sequence[int]], ids: Sequence[int]
    ) -> list[Booster]:
        """The new submap's classifiers, one for each group that it is trained without.

        Old submaps whose classifiers are out of date are taught beside it.
        """
        stale = [i for i in ids if self._is_stale(i, len(ids))]
        own = [self._own([new])] * len(groups) + [self._own(self._submaps[i]) for i in stale]
        boosters = self._trained(own, [*groups, *([i] for i in stale)], self._pool(ids))
        for i, booster in zip(stale, boosters[len(groups) :], strict=True):
            self._classifiers[i] = _Trained(booster, len(ids), self._held(i))
        return boosters[: len(groups)]

    def _asked(self, submap: int) -> list[NDArray[Any]]:
        """The scans (n, F) of each stay of an old submap that a new one's classifier is asked.

        About as many of a submap that was visited often as of one that was visited twice.
        """
        stays = self._submaps[submap]
        most = _OWN_SAMPLES * SAMPLES_PER_SUBMAP
        each = max(_LEAST_ASKED, most // len(stays))
        return [evenly(scans.features, each) for scans in stays]

    def _is_stale(self, submap: int, among: int) -> bool:
        """Whether an old submap's classifier is to be trained: the map or the submap has grown."""
        before = self._classifiers.get(submap)
        growth = 1.0 + self.config.refresh_growth
        # without growth allowed, nothing is kept: these are never less than themselves
        return before is None or not (
            among < before.among * growth and self._held(submap) < before.scans * growth
        )

    def _held(self, submap: int) -> int:
        """How many scans of an old submap are remembered."""
        return sum(len(scans) for scans in self._submaps[submap])

    def _own(self, stays: Sequence[_Scans]) -> _Scans:
        """The scans that a submap's classifier claims, of all its stays."""
        return _thinned(stays, _OWN_SAMPLES * SAMPLES_PER_SUBMAP)

    def _pool(self, ids: Sequence[int]) -> _Pool:
        """The pool of negatives: alike many scans of every old submap, of all its stays."""
        each = math.ceil(_POOL * self.config.closure_negatives / len(ids))
        parts = [_thinned(self._submaps[i], each) for i in ids]
        return _Pool(_Scans.joined(parts), np.repeat(ids, [len(part) for part in parts]))

    def _trained(
        self, own: Sequence[_Scans], left_out: Sequence[Collection[int]], pool: _Pool
    ) -> list[Booster]:
        """Classifiers of several submaps' scans against the pool without some submaps each."""
        most = self.config.closure_negatives
        others = [pool.without(submaps, most) for submaps in left_out]
        ends = np.cumsum([len(pool.scans), *(len(scans) for scans in own)])
        questions = [
            Question(
                np.concatenate([np.arange(end - len(scans), end), rows]),
                np.repeat([True, False], [len(scans), len(rows)]),
            )
            for end, scans, rows in zip(ends[1:].tolist(), own, others, strict=True)
        ]
        scans = _Scans.joined([pool.scans, *own])
        names, rounds = feature_names(self.config.feature_set), self.config.closure_rounds
        if self._quantiser is None or scans.codes is None:
            return boosted(names, scans.features, questions, rounds)
        return boosted_trees(names, scans.codes, self._quantiser, questions, rounds, self.rng)

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


def _claims(c_new: Booster, c_old: Booster, new: _Scans, old: Sequence[NDArray[Any]]) -> Claims:
    """The claims between a new submap and scans (n, F) of an old one's stays by two classifiers."""
    of_new = c_old.margins(new.features)
    of_old = c_new.margins(np.concatenate(old))
    of_stays = np.split(of_old, np.cumsum([len(scans) for scans in old])[:-1])
    by_stay = np.array([_chance(margins) for margins in of_stays])
    return Claims(
        new_by_old=float((of_new > 0.0).mean()),  # eq. 4
        old_by_new=float((of_old > 0.0).mean()),  # eq. 4
        rank=_chance(of_new) * float(by_stay.max()),
        by_stay=by_stay,
    )


def _thinned(stays: Sequence[_Scans], most: int) -> _Scans:
    """At most `most` scans, evenly spread over the stays."""
    starts = np.concatenate([[0], np.cumsum([len(scans) for scans in stays])]).astype(np.intp)
    chosen = evenly(np.arange(int(starts[-1])), most)
    bounds = np.searchsorted(chosen, starts)
    parts = zip(stays, starts[:-1], bounds[:-1], bounds[1:], strict=True)
    return _Scans.joined([scans.taken(chosen[a:b] - start) for scans, start, a, b in parts])


def _chance(margins: FloatArray) -> float:
    """Mean of the logistic function of the margins (n,); 0 without any."""
    return float((1.0 / (1.0 + np.exp(-margins))).mean()) if len(margins) else 0.0

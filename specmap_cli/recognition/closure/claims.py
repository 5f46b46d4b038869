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
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import Booster, TreeBoost, boosted
from specmap_cli.recognition.learning.trees import CodeArray, Quantiser, Question, grown

SAMPLES_PER_SUBMAP = 60  # scans of a submap used for ranking

_POOL = 1.5  # times closure_negatives: as many are left without a group, of three
_LEAST_ASKED = 8  # scans of a stay: a mean of chances to a tenth or two
_OWN_SAMPLES = 2  # times SAMPLES_PER_SUBMAP: of all stays of a submap that is trained or asked
_QUANTISED_FROM = 4000  # scans that the bins are cut from: enough for the quantiles of 16 bins
_QUANTISED_GROWTH = 2  # the bins are cut anew once there are this many times the stays


@dataclass(frozen=True, slots=True, kw_only=True)
class Claims:
    """How two submaps claim each other's scans: fractions of eq. 4, xi of eq. 5."""

    new_by_old: float
    old_by_new: float

    @property
    def xi(self) -> float:
        """The similarity of eq. 5."""
        return self.new_by_old * self.old_by_new  # eq. 5


@dataclass(slots=True)
class _Scans:
    """One stay's features (n, F), and their bins (F, n) once they are cut."""

    features: NDArray[Any]
    codes: CodeArray | None = None

    @classmethod
    def joined(cls, parts: Sequence[_Scans], most: int | None = None) -> _Scans:
        """The scans of several, or `most` of them, evenly spread; with bins if all have some."""
        features = np.concatenate([scans.features for scans in parts])
        rows = slice(None) if most is None else evenly(np.arange(len(features)), most)
        codes = [scans.codes for scans in parts if scans.codes is not None]
        cut = np.concatenate(codes, axis=1)[:, rows] if len(codes) == len(parts) else None
        return cls(features[rows], cut)


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
            return {i: Claims(new_by_old=1.0, old_by_new=1.0) for i in ids}
        new = _Scans(features)
        if self.config.booster != "stumps":
            self._quantise(new)
        count = min(self.config.groups or len(ids), len(ids))
        groups = [ids[k::count] for k in range(count)]
        # beside it the old submaps are trained whose map, or own scans, have grown since;
        # without growth allowed that is all of them: nothing is less than itself
        held = {i: sum(len(scans.features) for scans in self._submaps[i]) for i in ids}
        growth = 1.0 + self.config.refresh_growth
        stale = [
            i
            for i in ids
            if (before := self._classifiers.get(i)) is None
            or not (len(ids) < before.among * growth and held[i] < before.scans * growth)
        ]
        trained = [[new]] * count + [self._submaps[i] for i in stale]
        boosters = self._trained(trained, [*groups, *([i] for i in stale)])
        for i, booster in zip(stale, boosters[count:], strict=True):
            self._classifiers[i] = _Trained(booster, len(ids), held[i])
        # about as many scans are asked of a submap visited often as of one visited twice
        most = _OWN_SAMPLES * SAMPLES_PER_SUBMAP
        found = {}
        for c_new, group in zip(boosters[:count], groups, strict=True):
            for i in group:
                each = max(_LEAST_ASKED, most // len(self._submaps[i]))
                old = [evenly(scans.features, each) for scans in self._submaps[i]]
                by_old = self._classifiers[i].booster.margins(new.features) > 0.0
                by_new = c_new.margins(np.concatenate(old)) > 0.0
                found[i] = Claims(  # eq. 4
                    new_by_old=float(by_old.mean()), old_by_new=float(by_new.mean())
                )
        return found

    def _trained(
        self, stays: Sequence[Sequence[_Scans]], left_out: Sequence[Collection[int]]
    ) -> list[Booster]:
        """Classifiers that claim the stays of several submaps, each without some old submaps."""
        own = [_Scans.joined(each, _OWN_SAMPLES * SAMPLES_PER_SUBMAP) for each in stays]
        most, ids = self.config.closure_negatives, sorted(self._submaps)
        pool = [_Scans.joined(self._submaps[i], math.ceil(_POOL * most / len(ids))) for i in ids]
        owner = np.repeat(ids, [len(scans.features) for scans in pool])
        scans = _Scans.joined([*pool, *own])
        ends = np.cumsum([len(owner), *(len(part.features) for part in own)]).tolist()
        questions = []
        for start, end, without in zip(ends[:-1], ends[1:], left_out, strict=True):
            others = evenly(np.flatnonzero(~np.isin(owner, list(without))), most)
            rows = np.concatenate([np.arange(start, end), others])
            answers = np.repeat([True, False], [end - start, len(others)])
            questions.append(Question(rows, answers))
        names, rounds = feature_names(self.config.feature_set), self.config.closure_rounds
        if self._quantiser is None or scans.codes is None:
            return boosted(names, scans.features, questions, rounds)
        forests = grown(scans.codes, self._quantiser, questions, rounds, self.rng)
        return [TreeBoost(names, forest) for forest in forests]

    def _quantise(self, new: _Scans) -> None:
        """Cut scans that have no bins yet; all of them anew once the map has doubled."""
        stays = [scans for i in sorted(self._submaps) for scans in self._submaps[i]]
        anew = self._quantiser is None or len(stays) >= _QUANTISED_GROWTH * self._quantised_at
        if self._quantiser is None or anew:
            most = max(1, _QUANTISED_FROM // (len(stays) + 1))
            sampled = [evenly(scans.features, most) for scans in (*stays, new)]
            self._quantiser = Quantiser.of(np.vstack(sampled))
            self._quantised_at = len(stays)
        for scans in (*stays, new):
            if anew or scans.codes is None:
                scans.codes = self._quantiser.codes(scans.features)

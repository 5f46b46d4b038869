"""Several places followed at once, until one leads: the walls tell look-alikes apart by the way.

Each hypothesis is moved by the robot's motion, matched with the walls, carried into the next submap
by the layout, and weighed by the walls and by the filter. A submap that was not searched yet counts
against all of them with the chance that the filter gives it. So it is searched, and only then is a
place believed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.features.virtual import WINDOW_M
from specmap_cli.recognition.localization.filtering import (
    LEAP,
    SMALLEST,
    novelty,
)
from specmap_cli.recognition.localization.places import SAME, LeadingPlace, Owners, Place
from specmap_cli.recognition.localization.unknown import FIT_SEARCH_M
from specmap_cli.recognition.localization.wall_fit import Fitted, View, WallFit

_HOPELESS = 8.0  # so much lighter than the heaviest: one in three thousand
_MOST = 8  # places followed at once: each costs a match a look
# Power of the filter's odds: it sums views that are nearly the same, and may be sure of a mistake
# for metres.
_TEMPER = 0.25
_MISSED = 0.1  # chance that a search does not find the place: people, and things that were moved
_LEAST_CHANCE = 0.005  # of a submap that is searched
_SLACK = 1.0  # log likelihood by which a place may fit worse in the next submap, and cross over


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """The robot is where the last view was `fitted`.

    `weight` is the log likelihood of all views against their being from elsewhere. `refused` is the
    submap that the place would belong to, if its walls explained the view as well.
    """

    fitted: Fitted
    weight: float
    refused: int | None = None

    @property
    def place(self) -> Place:
        """The place that is followed."""
        return self.fitted.place


class PlaceTracker:
    """The places where the robot may be, in a map whose submaps are `ids`.

    `lead` is the one that leads, in the last scan: None where none does clearly, or where the walls
    speak against it.
    """

    def __init__(
        self, ids: Sequence[int], fit: WallFit, owners: Owners, config: LocalizationConfig
    ) -> None:
        self.ids = list(ids)
        self.fit = fit
        self.owners = owners
        self.config = config
        self.restart()

    def restart(self) -> None:
        """Forget every place: the next pose has nothing to do with the last one."""
        self.lead: LeadingPlace | None = None
        self.hypotheses: list[Hypothesis] = []
        self._searched: dict[int, float] = {}  # where on the way each submap was
        self._driven_m, self._new = 0.0, 1.0  # the way, and the share of a view that is new on it
        self._at: Pose2 | None = None

    def update(self, posed: PosedScan, view: View | None, belief: FloatArray) -> FloatArray:
        """(m,) probabilities of the submaps by the places, given those by the filter, `belief`.

        `view` is what is matched of the scan, None where nothing is. Call for successive scans.
        """
        here = posed.map_from_base
        if not posed.lost:
            if self._at is not None:
                self._driven_m += (self._at.inverse() @ here).distance
            self._new = novelty(self._at, here, self._new)
            self._at = here
        if view is not None:
            self._look(view, belief)
        chances = self._chances(belief)
        self.lead = None
        if len(chances) and not posed.lost:
            best = int(chances.argmax())
            leader = self.hypotheses[best]
            if chances[best] >= self.config.lead and leader.fitted.fits:
                self.lead = LeadingPlace(leader.place, float(chances[best]))
        if not self.owners.known:
            return belief
        # those of the places, and of the filter for all else
        known = float(belief.sum())
        mixed = (1.0 - float(chances.sum())) * belief
        for each, chance in zip(self.hypotheses, chances.tolist(), strict=True):
            owner = self.owners.of(each.place.submap, each.place.moved(here).pose)
            owner = each.place.submap if owner == each.refused else owner
            mixed[self.ids.index(owner)] += chance * known
        return np.asarray(mixed)

    def _look(self, view: View, belief: FloatArray) -> None:
        """Weigh all places by one more view, and search for others while none of them leads."""
        share, self._new = min(1.0, self._new), 0.0
        self._keep([self._followed(view, each, share) for each in self.hypotheses], belief)
        prior = self._prior(belief)
        likely = [k for k in np.argsort(-prior, kind="stable") if prior[k] >= _LEAST_CHANCE]
        due = [self.ids[k] for k in likely if not self._is_searched(self.ids[k])]
        for submap in due[: self.config.fit_submaps]:
            if self._chances(belief).max(initial=0.0) >= self.config.lead:
                break
            self._searched[submap] = self._driven_m
            found = [fitted for fitted in self.fit.anywhere(view, submap) if fitted.fits]
            born = [Hypothesis(fitted, -fitted.against) for fitted in found]
            self._keep([*self.hypotheses, *born], belief)

    def _followed(self, view: View, before: Hypothesis, share: float) -> Hypothesis:
        """A hypothesis after one more view: in the next submap, where that is entered.

        A `share` of the view is new; all of it, when the place begins to fit or no longer does.
        """
        here = self.fit.followed(view, before.place, before.place.submap)
        assert here is not None  # the same submap
        fitted, refused = here, None
        owner = self.owners.of(here.place.submap, here.place.pose)
        if owner != here.place.submap:
            there = self.fit.followed(view, before.place, owner)
            if there is None or there.against > here.against + _SLACK:
                refused = owner
            else:
                fitted = there
        share = share if fitted.fits == before.fitted.fits else 1.0
        return Hypothesis(fitted, before.weight - share * fitted.against, refused)

    def _keep(self, hypotheses: Sequence[Hypothesis], belief: FloatArray) -> None:
        """Go on with the likeliest of some places that are not far behind, each of them once.

        No more is remembered in favour of a place than a leap away from it is unlikely. What they
        differ by stays as it is.
        """
        most = -math.log(LEAP)
        over = max(0.0, max((each.weight for each in hypotheses), default=most) - most)
        lighter = [replace(each, weight=each.weight - over) for each in hypotheses]
        kept: list[Hypothesis] = []
        for each in sorted(lighter, key=lambda h: -h.weight):
            if kept and each.weight < kept[0].weight - _HOPELESS:
                break
            if not any(each.place.is_near(h.place, self.fit.frames, *SAME) for h in kept):
                kept.append(each)
        self.hypotheses = kept
        best = np.argsort(-self._chances(belief), kind="stable")[:_MOST]
        self.hypotheses = [kept[k] for k in best.tolist()]

    def _is_searched(self, submap: int) -> bool:
        """Whether a submap was searched for what is seen now: the sooner again if nothing fits."""
        fits = any(each.fitted.fits for each in self.hypotheses)
        reach_m = WINDOW_M if fits else FIT_SEARCH_M
        return self._driven_m - self._searched.get(submap, -math.inf) < reach_m

    def _prior(self, belief: FloatArray) -> FloatArray:
        """(m,) chances of the submaps by the filter, its odds tempered."""
        tempered = np.array([max(chance, SMALLEST) ** _TEMPER for chance in belief.tolist()])
        return np.asarray(tempered / tempered.sum())

    def _chances(self, belief: FloatArray) -> FloatArray:
        """(n,) probabilities of the hypotheses; what they lack to one is that of all else."""
        prior = dict(zip(self.ids, self._prior(belief).tolist(), strict=True))
        heavy = [math.exp(h.weight) * prior[h.place.submap] for h in self.hypotheses]
        rest = sum(p * (_MISSED if self._is_searched(i) else 1.0) for i, p in prior.items())
        return np.asarray(np.array(heavy) / (sum(heavy) + rest), dtype=np.float64)

"""A hidden Markov model over the submaps: the future work of the paper's Section IV-B.

The robot stays in its submap or goes on to a neighbour in the topology. The likelihoods of each
view are what is observed: scans are grouped into views, since what a robot sees again without
moving says nothing new. One more state, the last, is "unknown": outside of the map.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, moved
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig

VIEW_M = 0.05  # motion to a new view; scans of one view are averaged, not summed
VIEW_RAD = 0.0524  # turn to a new view: a keyframe's, 3 degrees
INDEPENDENT_M = 1.0  # motion to a view that says something new
INDEPENDENT_RAD = 1.0  # turn to a view that says something new; a part of it counts so
LEAP = 0.0001  # chance to be anywhere next, by a way that was never driven
_LEAVE = 0.0001  # chance to leave the map, or to come back
_UNKNOWN_PRIOR = 0.5  # chance of unknown at the start
SMALLEST = 1e-300  # keeps a probability of nought out of a logarithm or a quotient


def novelty(before: Pose2 | None, now: Pose2, so_far: float = 0.0) -> float:
    """How much a view shows that one at `before` did not, on top of `so_far`: one is all of it.

    That is so after `INDEPENDENT_M` of motion, or after a turn by `INDEPENDENT_RAD`.
    """
    if before is None:
        return so_far
    step = before.inverse() @ now
    return so_far + step.distance / INDEPENDENT_M + abs(step.theta) / INDEPENDENT_RAD


class Clue:
    """One kind of clue: the mean of what is said in a view, by the motion since it last was."""

    def __init__(self) -> None:
        self._at: Pose2 | None = None
        self._motion = 1.0  # share of a view that says something new; what comes first does
        self._weight, self._sum, self._scans = 0.0, 0.0, 0
        self.last: float | None = None

    @property
    def worth(self) -> float:
        """What the view says so far; nothing as long as nothing was said of it."""
        return self._weight * self._sum / self._scans if self._scans else 0.0

    def see(self, posed: PosedScan, again: bool) -> None:
        """Take in where a scan was taken, and whether in the last view."""
        if not again:
            self._weight, self._sum, self._scans = 0.0, 0.0, 0
        if posed.lost:
            return
        self._motion = novelty(self._at, posed.map_from_base, self._motion)
        self._at = posed.map_from_base

    def add(self, said: float | None) -> None:
        """Take in what is said of a scan, if anything is."""
        if said is None:
            return
        if not self._scans:
            self._weight, self._motion = min(1.0, self._motion), 0.0
        self.last = said
        self._sum += said
        self._scans += 1


class ViewGrouping:
    """The views of a log. A view begins where the robot moved, and lasts until it moves again.

    `mean` of what is said of the scans of a view is what the view says, however many they are.
    `motion` is the `novelty` of the view after the one before, infinite for the first of a track.
    """

    def __init__(self) -> None:
        self._at: Pose2 | None = None
        self.motion = math.inf
        self._sum: FloatArray = np.zeros(0)
        self._scans = 0  # of the view

    def begins(self, posed: PosedScan) -> bool:
        """Whether the scan is a new view, which it then is; a lost one only if it is the first."""
        first = self._at is None
        if not first and (posed.lost or not moved(self._at, posed.map_from_base, VIEW_M, VIEW_RAD)):
            return False
        self.motion = math.inf if self._at is None else novelty(self._at, posed.map_from_base)
        self._at = posed.map_from_base
        self._sum, self._scans = np.zeros(0), 0
        return True

    def mean(self, said: NDArray[Any]) -> FloatArray:
        """The mean of what is said (k,) of the scans of this view, this one the last."""
        self._sum = self._sum + said if self._scans else np.asarray(said, dtype=np.float64)
        self._scans += 1
        return np.asarray(self._sum / self._scans)


class HiddenMarkovFilter:
    """Forward filter and smoother. States are the submaps `ids` in ascending order, then unknown.

    `adjacency` names the neighbours of every submap; `config` says how likely it is to stay, to
    leap anywhere and to leave the map. `transition` (m + 1, m + 1) holds rows that sum to one: the
    chance to go from the row's state to the column's.
    """

    def __init__(
        self, adjacency: Mapping[int, Collection[int]], config: LocalizationConfig
    ) -> None:
        self.ids = sorted(adjacency)
        m, number = len(self.ids), {submap: k for k, submap in enumerate(self.ids)}
        self.transition = np.zeros((m + 1, m + 1))
        inside = self.transition[:m, :m]
        for submap, k in number.items():
            neighbours = {number[n] for n in adjacency[submap] if n in number and n != submap}
            inside[k, k] = config.stay if neighbours else 1.0
            for n in neighbours:
                inside[k, n] = (1.0 - config.stay) / len(neighbours)
        inside *= 1.0 - LEAP - _LEAVE
        inside += LEAP / max(1, m)
        self.transition[:m, m] = _LEAVE
        self.transition[m, :m] = _LEAVE / max(1, m)
        self.transition[m, m] = 1.0 - (_LEAVE if m else 0.0)
        # before the first scan all submaps are as likely
        known = (1.0 - _UNKNOWN_PRIOR) / max(1, m)
        self._first = np.append(np.full(m, known), _UNKNOWN_PRIOR if m else 1.0)
        self._belief: FloatArray | None = None
        self._before: FloatArray | None = None  # the belief that the last update began with

    def reset(self) -> None:
        """Forget every scan."""
        self._belief = self._before = None

    def predicted(self, again: bool = False) -> FloatArray:
        """(m + 1,) probabilities of the states at the next scan, before it is seen.

        `again` means one that takes the place of the last.
        """
        before = self._before if again else self._belief
        return self._first if before is None else np.asarray(before @ self.transition)

    def with_unknown(self, known: NDArray[Any], worth: float, again: bool = False) -> FloatArray:
        """(m + 1,) the log likelihoods `known` (m,) of the submaps and, last, that of unknown.

        It is `worth` more than what the submaps, as likely as they are now, explain together: how
        well they are told apart says nothing about whether the scan is from any of them.
        """
        prior = self.predicted(again)[:-1]
        highest = float(np.max(known))
        together = float(prior @ np.exp(known - highest)) / max(float(prior.sum()), SMALLEST)
        return np.append(known, highest + np.log(max(together, SMALLEST)) + worth)

    def update(self, log_likelihoods: NDArray[Any], again: bool = False) -> FloatArray:
        """(m + 1,) probabilities of the states after one more scan of given log likelihoods.

        `again` takes back the last one: the same view is known better now.
        """
        evidence = np.asarray(log_likelihoods, dtype=np.float64)
        self._before = self._before if again else self._belief
        self._belief = _posterior(self.predicted(again=True), evidence)
        return self._belief

    def smooth(self, log_likelihoods: NDArray[Any]) -> FloatArray:
        """(T, m + 1) probabilities given all scans (T, m + 1), by forward and backward passes.

        They are those of a log of their own: what the filter has seen does not matter.
        """
        evidence = np.asarray(log_likelihoods, dtype=np.float64)
        likelihoods = np.exp(evidence - evidence.max(axis=1, keepdims=True))
        smoothed = np.empty(evidence.shape)
        prior = self._first
        for t, row in enumerate(evidence):
            belief = _posterior(prior, row)
            smoothed[t], prior = belief, np.asarray(belief @ self.transition)
        backward = np.ones(evidence.shape[1])
        for t in range(len(evidence) - 2, -1, -1):
            backward = self.transition @ (likelihoods[t + 1] * backward)
            backward /= backward.sum()
            smoothed[t] *= backward
            smoothed[t] /= smoothed[t].sum()
        return smoothed


def _posterior(prior: FloatArray, log_likelihoods: FloatArray) -> FloatArray:
    """Bayes' rule; evidence that rules out every state leaves the prior."""
    posterior = prior * np.exp(log_likelihoods - log_likelihoods.max())
    total = posterior.sum()
    return np.asarray(posterior / total if total > 0.0 else prior)

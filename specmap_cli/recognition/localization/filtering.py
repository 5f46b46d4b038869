"""A hidden Markov model over the submaps: the future work of the paper's Section IV-B.

The robot stays in its submap or goes on to a neighbour in the topology; each scan's classifier
margins are the evidence. One more state, the last, is "unknown": outside of the map.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray

_LEAP = 1e-4  # chance of arriving anywhere: kidnapped, or by an edge that was never driven
_LEAVE = 1e-4  # chance of leaving the map, or of coming back


class HiddenMarkovFilter:
    """Forward filter and smoother. States are the submaps `ids` in ascending order, then unknown.

    `adjacency` names the neighbours of every submap; `stay` is the chance to remain in a submap
    from one scan to the next. `transition_` (m + 1, m + 1) holds rows that sum to one.
    """

    def __init__(self, adjacency: Mapping[int, Collection[int]], stay: float = 0.97) -> None:
        self.adjacency = adjacency
        self.stay = stay
        self.ids = sorted(adjacency)
        self.transition_ = _transitions(self.ids, adjacency, stay)
        self._belief: FloatArray | None = None

    def reset(self) -> None:
        """Forget every scan."""
        self._belief = None

    def predicted(self) -> FloatArray:
        """(m + 1,) probabilities of the states at the next scan, before it is seen."""
        if self._belief is None:
            return np.full(len(self.ids) + 1, 1.0 / (len(self.ids) + 1))
        return np.asarray(self._belief @ self.transition_)

    def with_unknown(self, known: NDArray[Any], worth: float) -> FloatArray:
        """(m + 1,) the log likelihoods `known` (m,) of the submaps and, last, that of unknown.

        It is `worth` more than what the submaps, as likely as they are now, explain together: how
        well they are told apart says nothing about whether the scan is from any of them.
        """
        prior = self.predicted()[:-1]
        highest = float(np.max(known))
        together = float(prior @ np.exp(known - highest)) / max(float(prior.sum()), 1e-300)
        return np.append(known, highest + np.log(max(together, 1e-300)) + worth)

    def update(self, log_likelihoods: NDArray[Any]) -> FloatArray:
        """(m + 1,) probabilities of the states after one more scan of given log likelihoods."""
        evidence = np.asarray(log_likelihoods, dtype=np.float64)
        self._belief = _posterior(self.predicted(), evidence)
        return self._belief

    def smooth(self, log_likelihoods: NDArray[Any]) -> FloatArray:
        """(T, m + 1) probabilities given all scans, by forward and backward passes."""
        evidence = np.asarray(log_likelihoods, dtype=np.float64)
        likelihoods = np.exp(evidence - evidence.max(axis=1, keepdims=True))
        kept = self._belief
        self.reset()
        forward = np.array([self.update(row) for row in evidence]).reshape(evidence.shape)
        self._belief = kept
        smoothed = forward.copy()
        backward = np.ones(evidence.shape[1])
        for t in range(len(evidence) - 2, -1, -1):
            backward = self.transition_ @ (likelihoods[t + 1] * backward)
            backward /= backward.sum()
            smoothed[t] = forward[t] * backward
            smoothed[t] /= smoothed[t].sum()
        return smoothed


def _transitions(
    ids: list[int], adjacency: Mapping[int, Collection[int]], stay: float
) -> FloatArray:
    """(m + 1, m + 1) chance of going from the row's state to the column's."""
    m = len(ids)
    number = {submap: k for k, submap in enumerate(ids)}
    transition = np.zeros((m + 1, m + 1))
    for submap, k in number.items():
        neighbours = sorted(number[n] for n in adjacency[submap] if n in number and n != submap)
        transition[k, k] = stay if neighbours else 1.0
        for n in neighbours:
            transition[k, n] = (1.0 - stay) / len(neighbours)
    transition[:m, :m] *= 1.0 - _LEAP - _LEAVE
    transition[:m, :m] += _LEAP / max(1, m)
    transition[:m, m] = _LEAVE
    transition[m, :m] = _LEAVE / max(1, m)
    transition[m, m] = 1.0 - (_LEAVE if m else 0.0)
    return transition


def _posterior(prior: FloatArray, log_likelihoods: FloatArray) -> FloatArray:
    """Bayes' rule; evidence that rules out every state leaves the prior."""
    posterior = prior * np.exp(log_likelihoods - log_likelihoods.max())
    total = posterior.sum()
    return np.asarray(posterior / total if total > 0.0 else prior)

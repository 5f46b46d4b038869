"""Scans of pieces of the way, labelled by classifiers that learned without these pieces.

Single scans that are held out prove nothing: the scans just before and after them were learned. Of
a piece of some metres the map knows no more than it knows of another robot's way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, travelled
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.learning.calibration import HeldOutMargins
from specmap_cli.recognition.learning.one_vs_all import OneVsAll

_PIECE_M, _EVERY = 5.0, 4  # of the way a piece in four is held out; the first one never is
_UNCLAIMED = -1e3  # margin of a submap of which nothing was left to learn from


@dataclass(frozen=True, slots=True)
class Samples:
    """Features (n, F) of scans of a submap, and the keyframes (n,) where they were taken.

    Of scans cast in a grid the keyframes are the nearest ones.
    """

    features: NDArray[Any]
    keyframes: NDArray[np.intp]

    def rows(self, chosen: NDArray[Any]) -> Samples:
        """Some of the samples."""
        return Samples(self.features[chosen], self.keyframes[chosen])


class Pieces:
    """Which keyframes are held out, and which of these the rest of their submap comes near to."""

    def __init__(self, poses: FloatArray, reach_m: float) -> None:
        self.poses = poses
        self.reach_m = reach_m
        self.held_out = (travelled(poses) // _PIECE_M).astype(np.int64) % _EVERY == 1

    def rest(self, samples: Samples) -> Samples:
        """The samples to learn from."""
        return samples.rows(~self.held_out[samples.keyframes])

    def tested(self, samples: Samples) -> Samples:
        """The samples to test: those of places of the submap that the rest shows, too."""
        held_out = samples.rows(self.held_out[samples.keyframes])
        rest = np.unique(self.rest(samples).keyframes)
        if not len(rest):
            return held_out.rows(np.zeros(len(held_out.keyframes), dtype=bool))
        tree = cKDTree(self.poses[rest, :2])
        distance, _ = tree.query(self.poses[held_out.keyframes, :2])
        return held_out.rows(distance < self.reach_m)


def held_out_margins(
    learned: Mapping[int, Samples],
    tested: Mapping[int, Samples],
    feature_set: str,
    config: RecognitionConfig,
    rng: np.random.Generator,
) -> HeldOutMargins:
    """The margins of the samples `tested` by classifiers that learn from those `learned`.

    A submap that is not learned, since nothing is left of it, claims nothing. There are no margins
    where fewer than two submaps are left to tell apart.
    """
    ids = sorted(learned)
    rest = {i: samples.features for i, samples in learned.items() if len(samples.features)}
    asked = {i: samples for i, samples in tested.items() if i in rest and len(samples.features)}
    if len(rest) < 2 or not asked:
        return HeldOutMargins(np.zeros((0, len(ids))), np.zeros(0, dtype=np.intp))
    classifiers = OneVsAll(feature_set, config).fit(rest, rng)
    numbers = {i: k for k, i in enumerate(ids)}
    counts = [len(samples.features) for samples in asked.values()]
    margins = np.full((sum(counts), len(ids)), _UNCLAIMED)
    columns = [numbers[i] for i in classifiers.classes_]
    margins[:, columns] = classifiers.margins(np.vstack([s.features for s in asked.values()]))
    truth = np.repeat([numbers[i] for i in asked], counts).astype(np.intp)
    return HeldOutMargins(margins, truth)

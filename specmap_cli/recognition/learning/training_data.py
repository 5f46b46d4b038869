"""What the classifiers of a map learn from: features of scans, by keyframe.

A map that is made anew, with more scans or with other borders, learns from them again. The features
of a scan stay what they are, so they are not computed again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.records import BoolArray, IntArray


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


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Samples of all submaps: `raw` scans, from `beside` the way, virtual ones, and those `cast`.

    Virtual scans are `along` the track. Of scans cast in a grid, and of those from beside the way,
    the keyframes are the nearest ones. Without virtual scans there are none of the last two.
    """

    raw: Samples
    beside: Samples
    along: Samples
    cast: Samples

    @classmethod
    def of(cls, *kinds: Mapping[int, Samples]) -> TrainingData:
        """Those of every submap, a kind after the other."""
        return cls(*(together(kind) for kind in kinds))

    @property
    def kinds(self) -> tuple[Samples, ...]:
        """The samples of one kind after the other."""
        return self.raw, self.beside, self.along, self.cast

    def left(self, numbers: IntArray) -> TrainingData:
        """Those of the keyframes `numbers` (k,), ascending, which are 0, 1, ... from now on."""
        left = (own.rows(np.isin(own.keyframes, numbers)) for own in self.kinds)
        return TrainingData(
            *(Samples(own.features, np.searchsorted(numbers, own.keyframes)) for own in left)
        )

    @classmethod
    def joined(cls, parts: Sequence[TrainingData]) -> TrainingData:
        """Those of several maps in one."""
        of_kinds = zip(*(part.kinds for part in parts), strict=True)
        return cls(*(together(dict(enumerate(of_kind))) for of_kind in of_kinds))

    def numbered_from(self, first: int) -> TrainingData:
        """Those of the same keyframes, which are numbered from `first` on instead of from 0."""
        return TrainingData(*(replace(own, keyframes=own.keyframes + first) for own in self.kinds))

    def cast_near(self, keyframes: BoolArray) -> TrainingData:
        """Without the scans that were cast near other keyframes than some (n,)."""
        return replace(self, cast=self.cast.rows(keyframes[self.cast.keyframes]))


NO_SAMPLES = Samples(np.zeros((0, 0)), np.zeros(0, dtype=np.intp))
NO_TRAINING_DATA = TrainingData(NO_SAMPLES, NO_SAMPLES, NO_SAMPLES, NO_SAMPLES)


def together(samples: Mapping[int, Samples]) -> Samples:
    """The samples of all submaps, one after the other."""
    ordered = [samples[i] for i in sorted(samples) if len(samples[i].keyframes)]
    if not ordered:
        return NO_SAMPLES
    return Samples(
        np.vstack([own.features for own in ordered]),
        np.concatenate([own.keyframes for own in ordered]),
    )


def of_keyframes(samples: Samples, keyframes: Collection[int]) -> Samples:
    """The samples of some keyframes."""
    return samples.rows(np.isin(samples.keyframes, np.fromiter(keyframes, dtype=np.intp)))

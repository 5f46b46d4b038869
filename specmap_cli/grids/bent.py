"""A motion between two maps that were bent by drift: rigid, and a little off here and there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2

_REACH_M2 = 4.0  # two metres: within these a place's own motion counts alike
_AT_ONCE = 1 << 20  # points times places: bounds the memory to some 100 MB


@dataclass(frozen=True, slots=True)
class LocalMotion:
    """At `centre` (2,) of the source the motion is this one; `weight` says how sure that is."""

    centre: FloatArray
    motion: Pose2
    weight: float


@dataclass(frozen=True, slots=True)
class BentMotion:
    """`rigid` from one map to another, with the motions that hold at some places; it blends."""

    rigid: Pose2
    local: tuple[LocalMotion, ...] = ()

    def apply(self, points: FloatArray) -> FloatArray:
        """Points (N, 2) of one map in the other."""
        if not self.local:
            return self.rigid.apply(points)
        centres = np.array([one.centre for one in self.local])
        weights = np.array([one.weight for one in self.local])
        placed = np.zeros((len(points), 2))
        step = max(1, _AT_ONCE // len(self.local))
        for first in range(0, len(points), step):
            some, there = points[first : first + step], placed[first : first + step]
            squares = ((some[:, None, :] - centres[None]) ** 2).sum(axis=2)
            shares = weights / (_REACH_M2 + squares) ** 2  # far ones do not add up
            shares /= shares.sum(axis=1, keepdims=True)
            for k, one in enumerate(self.local):
                there += shares[:, k, None] * one.motion.apply(some)
        return placed

    def near(self, place: FloatArray) -> Pose2:
        """The rigid motion round a place (2,)."""
        here = place[None]
        shift = (self.apply(here) - self.rigid.apply(here))[0]
        x, y, theta = self.rigid
        return Pose2(x + float(shift[0]), y + float(shift[1]), theta)

    def inverse(self) -> BentMotion:
        """The motion back."""
        local = tuple(
            replace(
                one,
                centre=one.motion.apply(one.centre[None])[0],
                motion=one.motion.inverse(),
            )
            for one in self.local
        )
        return BentMotion(self.rigid.inverse(), local)

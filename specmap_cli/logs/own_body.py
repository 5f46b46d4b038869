"""What a laser sees of its own robot: posts, a bumper, the body beside it.

Such beams read the same short distance wherever the robot goes. Taken for walls, they are an
obstacle at every place where the robot was, until it looks there again; and the passes through one
place contradict each other, though the map is right.
"""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.logs.elsewhere import changed_share

_NEAR_M = 0.8  # as far as a robot reaches from its laser
_SAME_M = 0.1  # what readings of the body differ by, noise of a few centimetres included
_MARGIN_M = 0.05  # beyond the readings so far: those to come differ a little more
_PLACES = 25  # at which a beam read the same
_ELSEWHERE_M, _ELSEWHERE_SHARE = 0.2, 0.5  # other beams that change so, and how many of them


class OwnBody:
    """Finds the beams of one laser that see its robot; call `clear` for successive scans."""

    def __init__(self) -> None:
        self._there: FloatArray = np.zeros(0)  # the scan at the last place
        self._low: FloatArray = np.zeros(0)  # the shortest and the longest reading of each beam
        self._high: FloatArray = np.zeros(0)
        self._counts: IntArray = np.zeros(0, dtype=np.int64)  # places at which it read anything
        self._near: BoolArray = np.zeros(0, dtype=bool)  # beams that read nothing else so far
        self._seen: BoolArray = np.zeros(0, dtype=bool)  # those that read so at many places
        self._is_ruled_out = False  # every beam has read something else

    def clear(self, ranges: FloatArray) -> None:
        """Set the readings (B,) that are of the robot to NaN, in place."""
        if len(ranges) != len(self._there):
            self._low, self._high = np.full((2, len(ranges)), np.nan)
            self._counts = np.zeros(len(ranges), dtype=np.int64)
            self._learn(ranges)
        elif not self._is_ruled_out and self._is_elsewhere(ranges):
            self._learn(ranges)
        if self._seen.any():
            ranges[self._is_own(ranges)] = np.nan

    @property
    def notes(self) -> list[str]:
        """What a user should know of it: nothing while no beam sees the robot."""
        if not self._seen.any():
            return []
        low, high = float(self._low[self._seen].min()), float(self._high[self._seen].max())
        return [
            f"beams that read the same {low:.2f} to {high:.2f} m wherever the robot goes, which is "
            f"the robot itself: {np.count_nonzero(self._seen):,}; these readings are left out"
        ]

    def _learn(self, ranges: FloatArray) -> None:
        """Take in a scan at another place."""
        self._there = ranges.copy()
        read = np.where(np.isfinite(ranges), ranges, np.nan)
        self._low, self._high = np.fmin(self._low, read), np.fmax(self._high, read)
        self._counts += np.isfinite(ranges)
        self._near = (self._high < _NEAR_M) & (self._high - self._low <= _SAME_M)
        self._seen = self._near & (self._counts >= _PLACES)
        self._is_ruled_out = not (self._near | np.isnan(self._low)).any()

    def _is_elsewhere(self, ranges: FloatArray) -> bool:
        """Whether most beams that see no robot read other distances than at the last place."""
        others = ~self._near & ~(np.isnan(ranges) | np.isnan(self._there))
        changed = changed_share(ranges[others], self._there[others], _ELSEWHERE_M)
        return changed >= _ELSEWHERE_SHARE

    def _is_own(self, ranges: FloatArray) -> BoolArray:
        """Readings (B,) near those of the robot, on its beams and those beside: edges flicker."""
        low = _beside(np.where(self._seen, self._low, np.inf), np.minimum)
        high = _beside(np.where(self._seen, self._high, -np.inf), np.maximum)
        return (ranges >= low - _MARGIN_M) & (ranges <= high + _MARGIN_M)


def _beside(values: FloatArray, least: np.ufunc) -> FloatArray:
    """Each value (B,) or the ones beside it, by their minimum or maximum."""
    spread = values.copy()
    spread[1:] = least(spread[1:], values[:-1])
    spread[:-1] = least(spread[:-1], values[1:])
    return spread

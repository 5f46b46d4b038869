"""A distance that stands for no return although it is below the maximum that the scans claim.

Some drivers give a constant for it, such as 8.19 m where the scans claim 30 m, and some formats do
not tell the maximum. Taken for walls, such readings are an arc around the robot that goes with it,
and scan matching finds that it stands still. No wall looks like that: several beams read the
longest distance of all, to the last bit, and do so again when the robot is elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.elsewhere import changed_share

_BEAMS = 3  # of a scan that share its longest distance; of walls one does, or two
_PLACES = 4  # from which it was read: a robot that stands may see one wall again and again
_ELSEWHERE_M, _ELSEWHERE_SHARE = 0.1, 0.3  # readings that change so, and how many, when it drives


class Ceiling:
    """Finds such distances among the scans of one laser; call `clear` for each of them in turn.

    `values_m` are those found so far; of the readings of a scan, `cleared` were one of them.
    """

    def __init__(self, values_m: Iterable[float] = ()) -> None:
        self.values_m = tuple(values_m)
        self.cleared = 0
        self._longest = max(self.values_m, default=0.0)
        self._places = 0
        self._there: FloatArray = np.zeros(0)  # the scan at the last of these places

    def clear(self, ranges: FloatArray) -> None:
        """Set the readings (B,) that are one of these distances to +inf, in place."""
        self._look(ranges)
        for value in self.values_m:
            alike = ranges == value
            self.cleared += int(np.count_nonzero(alike))
            ranges[alike] = np.inf

    @property
    def notes(self) -> list[str]:
        """What a user should know of it: nothing where no reading was taken for no return."""
        if not self.cleared:
            return []
        values = " m, ".join(f"{value:g}" for value in self.values_m)
        return [
            f"readings of exactly {values} m, the longest distance of all, are taken for no "
            f"return, as several beams of one scan have it again and again: {self.cleared:,}"
        ]

    def _look(self, ranges: FloatArray) -> None:
        """Count the places from which several beams read the longest distance of all."""
        longest = float(ranges[np.isfinite(ranges)].max(initial=0.0))
        if longest > self._longest:
            self._longest, self._places = longest, 0
        if longest < self._longest or longest in self.values_m:
            return
        if np.count_nonzero(ranges == longest) >= _BEAMS and self._is_elsewhere(ranges):
            self._places += 1
            self._there = ranges.copy()
        if self._places >= _PLACES:
            self.values_m = (*self.values_m, longest)

    def _is_elsewhere(self, ranges: FloatArray) -> bool:
        """Whether the robot has moved since the last place, by what the laser reads."""
        if not self._places or len(ranges) != len(self._there):
            return True
        return changed_share(ranges, self._there, _ELSEWHERE_M) >= _ELSEWHERE_SHARE

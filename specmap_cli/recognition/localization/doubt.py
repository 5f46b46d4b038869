"""What speaks for unknown: scans that fit no walls, and views that look like no place of the map.

Both stay what they are for metres of the way. So they count by the motion since they counted last,
and a view of a robot that stands still counts once, by the mean of its scans.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.localization.views import INDEPENDENT_M, INDEPENDENT_RAD
from specmap_cli.recognition.localization.walls import WallCheck
from specmap_cli.recognition.localization.witness import Impression

_STRANGE_FROM = 0.87  # from this share of the limit on, a scan speaks for unknown
_STRANGE_GAIN = 2.0  # log likelihood for unknown, per share of the limit beyond that
_STRANGE_MOST = 1.0  # the most of that likelihood: views that are strange come in a row


class Doubt:
    """Log likelihood of unknown over known, a view after another."""

    def __init__(self, walls: WallCheck, config: LocalizationConfig) -> None:
        self.walls = walls
        self.config = config
        self._fits, self._looks = _Clue(), _Clue()

    @property
    def of_walls(self) -> float | None:
        """Log likelihood of unknown by the last scan matched with walls; None where none was."""
        return self._fits.last

    def restart(self) -> None:
        """Forget every scan."""
        self.walls.restart()
        self._fits, self._looks = _Clue(), _Clue()

    def worth(
        self, posed: PosedScan, evidence: Impression, likely: Sequence[int], again: bool
    ) -> float:
        """Log likelihood of the view that the scan is of; `again` when it is the last scan's view.

        `likely` are the submaps, the likeliest first.
        """
        for clue in (self._fits, self._looks):
            clue.see(posed, again)
        if self.config.fit_submaps:
            said = self.walls.unknown(posed, evidence.seen, likely)
            self._fits.add(said, instead=self.walls.found)
        self._looks.add(self._strange(evidence))
        return self._fits.worth + self._looks.worth

    def _strange(self, evidence: Impression) -> float | None:
        """Log likelihood of unknown by what a scan looks like."""
        if evidence.strange == -math.inf:
            return None
        most = _STRANGE_MOST
        worth = _STRANGE_GAIN * (evidence.strange - _STRANGE_FROM)
        if worth > 0.0:
            # what a short window of a narrow laser has seen so far looks strange anywhere
            worth *= evidence.shown**2
        return min(max(worth, -most), most)


class _Clue:
    """One kind of evidence: the mean of what is said in a view, by the motion since it last was."""

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
        if self._at is not None:
            step = self._at.inverse() @ posed.map_from_base
            self._motion += step.distance / INDEPENDENT_M
            self._motion += abs(step.theta) / INDEPENDENT_RAD
        self._at = posed.map_from_base

    def add(self, said: float | None, instead: bool = False) -> None:
        """Take in what is said of a scan, if anything is; `instead` of what was of its view."""
        if said is None:
            return
        if not self._scans:
            self._weight, self._motion = min(1.0, self._motion), 0.0
        self.last = said
        if instead:
            self._sum, self._scans = 0.0, 0
        self._sum += said
        self._scans += 1

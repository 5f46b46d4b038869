"""Scans grouped into views: what a robot sees again without moving is no new evidence."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, moved
from specmap_cli.core.records import PosedScan

VIEW_M = 0.05  # motion to a new view; scans of one view are averaged, not summed
VIEW_RAD = 0.0524  # turn to a new view: a keyframe's, 3 degrees
INDEPENDENT_M = 1.0  # motion to a view that says something new
INDEPENDENT_RAD = 1.0  # turn to a view that says something new; a part of it counts so


class ViewGrouping:
    """The views of a log. A view begins where the robot moved, and lasts until it moves again.

    `mean` of what is said of the scans of a view is what the view says, however many they are.
    `motion` is how much the view shows that the one before did not, by the motion between them: one
    after `INDEPENDENT_M` or `INDEPENDENT_RAD`, infinite for the first view of a track.
    `keep` stores the evidence of the view as it is known now; `tracks` returns that of all views.
    """

    def __init__(self) -> None:
        self._at: Pose2 | None = None
        self.motion = math.inf
        self._sum: FloatArray = np.zeros(0)
        self._scans = 0  # of the view
        self._tracks: list[list[FloatArray]] = [[]]  # of views, one for each unbroken track
        self._view_of: list[int] = []  # each scan's, counted over all tracks

    def restart(self) -> None:
        """The next scan begins a track of its own."""
        self._at = None
        self._tracks.append([])

    def begins(self, posed: PosedScan) -> bool:
        """Whether the scan is a new view, which it then is; a lost one only if it is the first."""
        first = not self._tracks[-1]
        far = moved(self._at, posed.map_from_base, VIEW_M, VIEW_RAD)
        if not first and (posed.lost or not far):
            return False
        self.motion = self._motion_to(posed.map_from_base)
        self._at = posed.map_from_base
        self._sum, self._scans = np.zeros(0), 0
        self._tracks[-1].append(np.zeros(0))
        return True

    def _motion_to(self, map_from_base: Pose2) -> float:
        if self._at is None:
            return math.inf
        step = self._at.inverse() @ map_from_base
        return step.distance / INDEPENDENT_M + abs(step.theta) / INDEPENDENT_RAD

    def mean(self, said: NDArray[Any]) -> FloatArray:
        """The mean of what is said (k,) of the scans of this view, this one the last."""
        self._sum = self._sum + said if self._scans else np.asarray(said, dtype=np.float64)
        self._scans += 1
        return np.asarray(self._sum / self._scans)

    def keep(self, evidence: FloatArray) -> None:
        """What this view says, with the scan that came last."""
        self._tracks[-1][-1] = evidence
        self._view_of.append(sum(len(track) for track in self._tracks) - 1)

    def tracks(self) -> list[FloatArray]:
        """The evidence (views, k) of every track."""
        return [np.array(track) for track in self._tracks if track]

    def of_scans(self, rows: list[FloatArray]) -> list[FloatArray]:
        """For each scan the row of its view; `rows` are those of the views of all tracks."""
        return [rows[view] for view in self._view_of]

"""The pose within a submap: the matcher on the submap's grid, followed from scan to scan."""

from __future__ import annotations

import math
from collections.abc import Mapping

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.sampling import evenly
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.matching import Match, ScoreField, Window, refine, search, search_everywhere

_MOST_POINTS = 180
_FOLLOW = Window(0.4, math.radians(12.0), 0.1, math.radians(2.0))
_LOST_SCORE = 0.55


class MetricTracker:
    """Poses of scans within the submaps they are labelled with, each with its score in [0, 1].

    `grids` are in the submaps' frames. A submap newly entered, or a score too low to go on from,
    is searched as a whole; otherwise the motion since the last scan says where to look.
    """

    def __init__(self, grids: Mapping[int, GridMap]) -> None:
        self.grids = grids
        self._fields: dict[int, ScoreField] = {}
        self._last: tuple[int, Pose2, Pose2] | None = None  # submap, its pose, map_from_base

    def locate(self, posed: PosedScan, submap: int) -> Match:
        """`submap_from_base` and its score; call for successive scans."""
        points = posed.base_from_laser.apply(evenly(posed.planar.hits(), _MOST_POINTS))
        field = self._field(submap)
        match: Match | None = None
        if self._last is not None and self._last[0] == submap and not posed.restarted:
            guess = self._last[1] @ (self._last[2].inverse() @ posed.map_from_base)
            match = search(field, points, guess, _FOLLOW)
            match = refine(field, points, match.pose)
        if match is None or match.score < _LOST_SCORE:
            match = self._anywhere(field, points, match)
        self._last = (submap, match.pose, posed.map_from_base)
        return match

    def _anywhere(self, field: ScoreField, points: FloatArray, fallback: Match | None) -> Match:
        found = search_everywhere(field, points, step=0.2)
        best = fallback or Match(Pose2(0.0, 0.0, 0.0), 0.0)
        for candidate in found:
            match = refine(field, points, candidate.pose)
            if match.score > best.score:
                best = match
        return best

    def _field(self, submap: int) -> ScoreField:
        if submap not in self._fields:
            self._fields[submap] = ScoreField.from_grid(self.grids[submap])
        return self._fields[submap]

"""The pose within a submap: the matcher on the submap's grid, followed from scan to scan."""

from __future__ import annotations

import math
from collections.abc import Mapping

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.sampling import evenly
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.matching import Match, ScoreField, Window, refine, search, search_everywhere
from specmap_cli.recognition.localization.place import Place

_MOST_POINTS = 180  # one every other degree: what a match costs grows with them
# Steps of the searches: what the refinement after them mends (0.3 m at the most).
_FOLLOW_STEP_M, _FOLLOW_STEP_RAD = 0.1, math.radians(2.0)
_SEARCH_STEP_M = 0.2


class MetricTracker:
    """Poses of scans within the submaps they are labelled with, each with its score in [0, 1].

    `grids` are in the submaps' frames, and `frames` are these in the layout. The motion since the
    last scan says where to look, also in a submap newly entered. Where that is not known, or its
    score is too low to go on from, the submap is searched as a whole.
    """

    def __init__(
        self,
        grids: Mapping[int, GridMap],
        config: LocalizationConfig,
        frames: Mapping[int, Pose2] | None = None,
    ) -> None:
        self.grids = grids
        self.config = config
        self.frames = frames or {}
        self._fields: dict[int, ScoreField] = {}
        self._last: Place | None = None

    def locate(self, posed: PosedScan, submap: int) -> Match:
        """`submap_from_base` and its score; call for successive scans."""
        points = posed.base_from_laser.apply(evenly(posed.planar.hits(), _MOST_POINTS))
        field = self.field(submap)
        guess = None
        if self._last is not None and not posed.restarted:
            guess = self._last.led_to(submap, posed.map_from_base, self.frames)
        match = None if guess is None else self._near(field, points, guess)
        if match is None or match.score < self.config.lost_score:
            match = _anywhere(field, points, match)
        self._last = Place(submap, match.pose, posed.map_from_base)
        return match

    def _near(self, field: ScoreField, points: FloatArray, guess: Pose2) -> Match:
        """The match near a guess, which is searched for when the guess leads to none at once."""
        match = refine(field, points, guess)
        if match.score >= self.config.follow_score:
            return match
        match = search(field, points, guess, self._window())
        return refine(field, points, match.pose)

    def _window(self) -> Window:
        """Where a scan is sought about the pose that the motion since the last one gives."""
        return Window(
            distance_m=self.config.follow_m,
            angle_rad=self.config.follow_rad,
            step_m=_FOLLOW_STEP_M,
            angle_step_rad=_FOLLOW_STEP_RAD,
        )

    def field(self, submap: int) -> ScoreField:
        """The walls of a submap, in its frame."""
        if submap not in self._fields:
            self._fields[submap] = ScoreField.from_grid(self.grids[submap])
        return self._fields[submap]


def _anywhere(field: ScoreField, points: FloatArray, fallback: Match | None) -> Match:
    """The best refined match anywhere on the field, unless the fallback is as good."""
    best = fallback or Match(IDENTITY, 0.0)
    for candidate in search_everywhere(field, points, step=_SEARCH_STEP_M):
        match = refine(field, points, candidate.pose)
        if match.score > best.score:
            best = match
    return best

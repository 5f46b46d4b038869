"""The pose within a submap, with its covariance: the place that leads, matched at every scan."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.matching import Match, Window, refine, search
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.localization.estimate import Estimate, information
from specmap_cli.recognition.localization.place import Place

_FOLLOW_M = 0.4  # a pose in a submap is sought this near where motion says it is
_FOLLOW_RAD = 0.2094  # a pose in a submap is sought turned this much at the most
_FOLLOW_SCORE = 0.8  # from this score on, a pose to which the motion leads is not sought
_LOST_SCORE = 0.55  # below this score the whole submap is searched
_MOST_POINTS = 180  # one every other degree: what a match costs grows with them
# Steps of the search: what the refinement after it mends (0.3 m at the most).
_FOLLOW_STEP_M, _FOLLOW_STEP_RAD = 0.1, math.radians(2.0)
# What a place is good to that the walls of the last metres led to, and how far it may be from the
# pose that was followed before that is taken for wrong.
_PLACE_M, _PLACE_RAD = 0.1, 0.05
_APART_M, _APART_RAD = 0.3, 0.1


@dataclass(frozen=True, slots=True)
class Fix:
    """A scan's pose in a submap, its covariance (3, 3) in x, y and angle, its score in [0, 1]."""

    submap: int
    pose: Pose2
    covariance: FloatArray
    score: float


class MetricTracker:
    """Poses of successive scans; `field` gives the walls of each submap, in its own frame.

    `frames` are the frames of the submaps in the layout.
    """

    def __init__(
        self,
        field: Callable[[int], ScoreField],
        frames: Mapping[int, Pose2],
    ) -> None:
        self.field = field
        self.frames = frames
        self._last: tuple[Place, Estimate] | None = None

    def locate(self, posed: PosedScan, place: Place | None, submap: int | None) -> Fix | None:
        """The pose in a submap of a scan, by a `place` of another scan of the same track.

        None where no place or no submap is known, or where the scan fits no walls. Call for
        successive scans.
        """
        if posed.restarted:  # this pose has nothing to do with the last one
            self._last = None
        if place is None or submap is None or posed.lost:
            return None
        guess = place.led_to(submap, posed.map_from_base, self.frames)
        points = posed.base_from_laser.apply(evenly(posed.planar.hits(), _MOST_POINTS))
        if guess is None or not len(points):
            return None
        prior = self._expected(posed, submap, guess)
        field = self.field(submap)
        match = self._near(field, points, prior.pose)
        told = information(field, points, match.pose)
        if not prior.agrees_with(match.pose, told):
            prior = Estimate.about(prior.pose, _PLACE_M, _PLACE_RAD)
        estimate = prior.corrected(match.pose, told)
        self._last = Place(submap, estimate.pose, posed.map_from_base), estimate
        if match.score < _LOST_SCORE:
            return None
        return Fix(submap, estimate.pose, estimate.covariance, match.score)

    def _expected(self, posed: PosedScan, submap: int, guess: Pose2) -> Estimate:
        """Where the motion since the last scan leads, if that is where the place is."""
        if self._last is not None:
            place, estimate = self._last
            moved = estimate.moved(place.map_from_base.inverse() @ posed.map_from_base)
            there = place.led_to(submap, posed.map_from_base, self.frames)
            if there is not None:
                off = there.inverse() @ guess
                if off.distance < _APART_M and abs(off.theta) < _APART_RAD:
                    return moved.within(there @ moved.pose.inverse())
        return Estimate.about(guess, _PLACE_M, _PLACE_RAD)

    def _near(self, field: ScoreField, points: FloatArray, guess: Pose2) -> Match:
        """The match near a guess, which is searched for when the guess leads to none at once."""
        match = refine(field, points, guess)
        if match.score >= _FOLLOW_SCORE:
            return match
        window = Window(
            distance_m=_FOLLOW_M,
            angle_rad=_FOLLOW_RAD,
            step_m=_FOLLOW_STEP_M,
            angle_step_rad=_FOLLOW_STEP_RAD,
        )
        found = refine(field, points, search(field, points, guess, window).pose)
        return max(match, found, key=lambda each: each.score)

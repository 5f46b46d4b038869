"""The pose within a submap, with its covariance: the place that leads, matched at every scan.

A pose is moved by the robot's motion and corrected by matches with walls: the steps of an extended
Kalman filter, the correction in its information form. Along a wall, where a match says nothing, the
motion alone counts. What a match does not know is how far all walls of a grid are off together: so
neighbouring points count little, and the filter forgets quickly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, inverse3, product, wrap_angle
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.matching import Window, refine, search
from specmap_cli.grids.score_field import Sample, ScoreField
from specmap_cli.recognition.localization.places import Place

# What the motion may be off by: between any two scans, after a metre, after a radian. Registration
# is better than that, but for slips of some centimetres, which are to be followed.
_STILL_M, _STILL_RAD = 0.01, 0.005
_DRIFT_M, _DRIFT_RAD, _TURN_RAD = 0.05, 0.05, 0.05
_INDEPENDENT = 0.1  # of the points: the others lie on the same walls of the same grid
_LEAST_MISS = 0.02  # mean square of what a field misses under points: cells are no finer
_LEAST_INFORMATION = 1e-3  # of a match, a square metre or radian: it is never singular
_SURPRISE = 7.81  # chi-square of three degrees of freedom: one in twenty is larger
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
class Estimate:
    """A pose and its covariance (3, 3) of x and y, metres, and of the angle, radians."""

    pose: Pose2
    covariance: FloatArray

    @classmethod
    def about(cls, pose: Pose2, distance_m: float, angle_rad: float) -> Estimate:
        """A pose with the given standard deviations."""
        return cls(pose, np.diag(np.square([distance_m, distance_m, angle_rad])))

    def moved(self, motion: Pose2) -> Estimate:
        """After a motion in the robot's own frame."""
        pose = self.pose @ motion
        turned = np.eye(3)
        turned[0, 2], turned[1, 2] = self.pose.y - pose.y, pose.x - self.pose.x
        off = _STILL_M**2 + _DRIFT_M**2 * motion.distance
        angle = _STILL_RAD**2 + _DRIFT_RAD**2 * motion.distance + _TURN_RAD**2 * abs(motion.theta)
        carried = product(product(turned, self.covariance), turned.T)
        return Estimate(pose, carried + np.diag([off, off, angle]))

    def within(self, other_from_own: Pose2) -> Estimate:
        """The same in another frame."""
        rotation = np.eye(3)
        rotation[:2, :2] = other_from_own.rotation()
        covariance = product(product(rotation, self.covariance), rotation.T)
        return Estimate(other_from_own @ self.pose, covariance)

    def agrees_with(self, match: Pose2, information: FloatArray) -> bool:
        """Whether a match lies where it may be expected."""
        off = self._off(match)[:, None]
        spread = self.covariance + inverse3(information)
        return float((off * product(inverse3(spread), off)).sum()) <= _SURPRISE

    def corrected(self, match: Pose2, information: FloatArray) -> Estimate:
        """With a match, of which the inverse (3, 3) of the covariance is known."""
        covariance = inverse3(inverse3(self.covariance) + information)
        shift = product(product(covariance, information), self._off(match)[:, None])
        x, y, turn = (np.array(self.pose) + shift[:, 0]).tolist()
        return Estimate(Pose2(x, y, wrap_angle(turn)), covariance)

    def _off(self, match: Pose2) -> FloatArray:
        """(3,) what a match differs by."""
        turn = wrap_angle(match.theta - self.pose.theta)
        return np.array([match.x - self.pose.x, match.y - self.pose.y, turn])


def information(field: ScoreField, points: FloatArray, pose: Pose2) -> FloatArray:
    """(3, 3) inverse of the covariance with which points (N, 2) on a field tell their pose.

    The normal matrix of Gauss-Newton over the mean square of what the field misses.
    """
    equations = Sample.of(field, np.ascontiguousarray(points.T), pose).equations()
    sums = product(equations, equations.T)
    miss = sums[3, 3] / max(1, len(points)) + _LEAST_MISS
    return np.asarray(_INDEPENDENT * sums[:3, :3] / miss + _LEAST_INFORMATION * np.eye(3))


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
        match = refine(field, points, prior.pose)
        if match.score < _FOLLOW_SCORE:  # the guess does not lead to it at once
            window = Window(
                distance_m=_FOLLOW_M,
                angle_rad=_FOLLOW_RAD,
                step_m=_FOLLOW_STEP_M,
                angle_step_rad=_FOLLOW_STEP_RAD,
            )
            found = refine(field, points, search(field, points, prior.pose, window).pose)
            match = max(match, found, key=attrgetter("score"))
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

"""A pose with its covariance: moved by the robot's motion, corrected by matches with walls.

The steps of an extended Kalman filter, the correction in its information form: along a wall, where
a match says nothing, the motion alone counts. What a match does not know is how far all walls of a
grid are off together: so neighbouring points count little, and the filter forgets quickly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, inverse3, product, wrap_angle
from specmap_cli.grids.score_field import Sample, ScoreField

# What the motion may be off by: between any two scans, after a metre, after a radian. Registration
# is better than that, but for slips of some centimetres, which are to be followed.
_STILL_M, _STILL_RAD = 0.01, 0.005
_DRIFT_M, _DRIFT_RAD, _TURN_RAD = 0.05, 0.05, 0.05
_INDEPENDENT = 0.1  # of the points: the others lie on the same walls of the same grid
_LEAST_MISS = 0.02  # mean square of what a field misses under points: cells are no finer
_LEAST_INFORMATION = 1e-3  # of a match, a square metre or radian: it is never singular
_SURPRISE = 7.81  # chi-square of three degrees of freedom: one in twenty is larger


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

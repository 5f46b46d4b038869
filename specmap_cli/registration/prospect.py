"""Where a sweep is expected: by odometry, by the motion before, or by odometry driven backwards."""

from __future__ import annotations

from dataclasses import dataclass

from specmap_cli.core.geometry import FloatArray, Pose2, product
from specmap_cli.registration.agreement import agrees
from specmap_cli.registration.expected_motion import ExpectedMotion
from specmap_cli.registration.reliance import UNKNOWN, Reliance
from specmap_cli.registration.scene import Fit, Scene

_GUESS_MARGIN = 0.05  # score by which steady motion must beat odometry as the guess
SEARCH_RAD = 0.35  # half angle of the search: a clock apart, in a turn

# What alignments mend at any scan: half a voxel, and as much at the walls of a room.
_SMALL_M, _SMALL_RAD = 0.05, 0.02
BEYOND_DOUBT = 0.85  # score of a place that is right without odometry: most right ones have more


@dataclass(frozen=True, slots=True, kw_only=True)
class Prospect:
    """Where a sweep is expected: at `guess` (4, 4), with what is known of the motion there.

    `by_motion` is the place that the expected motions since the last keyframe lead to. `reverse`
    (4, 4) is where the sweep was taken if odometry reports backing up as driving forward, and
    `unturned` (4, 4) if it reports a turn that the robot did not make; None if neither can be.
    """

    guess: FloatArray
    expected: ExpectedMotion
    by_motion: Pose2
    reliance: Reliance = UNKNOWN
    reverse: FloatArray | None = None
    unturned: FloatArray | None = None

    @property
    def trusted(self) -> bool:
        """Whether odometry measured the motion, and is worth its name."""
        return self.expected.measured and self.reliance.trusted

    def agrees(self, fit: Fit, slacks: float = 1.0) -> bool:
        """Whether a result agrees with the motion expected, to within so many slacks."""
        guess = Pose2.from_matrix(self.guess)
        return agrees(guess, fit.planar, self.expected, self.reliance, slacks)

    def denies(self, fit: Fit) -> bool:
        """Whether odometry that is worth its name, or at least its way, speaks against a result."""
        if not self.expected.measured:
            return False
        away = Pose2.from_matrix(self.guess).inverse() @ fit.planar
        elsewhere = self.reliance.place_slacks(self.expected.motion, away) >= 1.0
        if self.reliance.trusted_place and elsewhere:
            return True
        return self.reliance.trusted and not self.agrees(fit)

    def slacks(self, place: Pose2, fit: Fit) -> float:
        """How many slacks of odometry a result is away from a place."""
        return self.reliance.slacks(self.expected.motion, place.inverse() @ fit.planar)


def best_guess(scene: Scene, before: FloatArray, expected: ExpectedMotion) -> FloatArray:
    """The pose (4, 4) expected after the pose `before`: by odometry or by the motion before.

    The motion before is carried on where odometry puts the sweep visibly off the walls. Stamps of
    wheels and laser may be apart: in turns odometry is then off by many degrees.
    """
    guess = product(before, expected.motion.matrix())
    if not expected.measured:
        return guess
    other = product(before, expected.carried.matrix())
    apart = expected.motion.inverse() @ expected.carried
    if abs(apart.theta) > SEARCH_RAD or _is_small(apart):
        return guess
    places = [Pose2.from_matrix(p) for p in (guess, other)]
    by_odometry, by_motion = (scene.score(place) for place in places)
    better = by_motion > by_odometry + _GUESS_MARGIN
    if better and by_motion < BEYOND_DOUBT:  # there may be new space
        better = scene.gain(*places) > _GUESS_MARGIN
    return other if better else guess


def _is_small(apart: Pose2) -> bool:
    """Whether an alignment leads to the same place from either of two guesses so far apart."""
    return apart.distance < _SMALL_M and abs(apart.theta) < _SMALL_RAD


def reversed_guess(before: FloatArray, expected: ExpectedMotion) -> FloatArray | None:
    """The pose (4, 4) after the same motion driven backwards, turns kept; None if unmeasured."""
    if not expected.measured:
        return None
    x, y, theta = expected.motion
    return product(before, Pose2(-x, -y, theta).matrix())


def unturned_guess(before: FloatArray, expected: ExpectedMotion) -> FloatArray | None:
    """The pose (4, 4) after the motion before, carried on, where odometry's turn is unheard of.

    None otherwise. The heading of some odometry jumps, when it is corrected or begins anew.
    """
    if not (expected.measured and expected.unheard_of):
        return None
    return product(before, expected.carried.matrix())

"""Where a sweep is expected, how far a result may be from there, and where searches look."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from specmap_cli.core.geometry import FloatArray, Pose2, product
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import Window
from specmap_cli.registration.local_map import Bounds, Fit, Scene
from specmap_cli.registration.motion import UNKNOWN, ExpectedMotion, Reliance

_GUESS_MARGIN = 0.05  # score by which steady motion must beat odometry as the guess
# What alignments mend at any scan: half a voxel, and as much at the walls of a room.
_SMALL_M, _SMALL_RAD = 0.05, 0.02
BEYOND_DOUBT = 0.85  # score of a place that is right without odometry: most right ones have more

# How far a motion carried on may be off, by how much a robot speeds up and turns in from one scan
# to the next: metres and radians, and shares of the motion.
_CARRIED_M, _CARRIED_RAD = 0.1, 0.12
_SHARE_OF_DISTANCE, _SHARE_OF_TURN = 0.2, 0.3

SEARCH_M = 0.25  # half width of the search: odometry's error
_SEARCH_RAD = 0.35  # half angle of the search: a clock apart, in a turn
_BACKED_UP = (1.0, 0.5)  # shares of a step that are tried as driven backwards
_BLIND_SEARCH_M = 0.3  # half width of the search without odometry
_BLIND_SEARCH_RAD = 0.5  # half angle of the search without odometry
_WIDE_SEARCH_M = 1.0  # half width of the wide search: a hole in the log
_WIDE_SEARCH_RAD = 1.6  # half angle of the wide search

# Steps of the two searches: about a cell of the score field, no finer, and a rough one.
_STEP_M, _WIDE_STEP_M = 0.05, 0.1
# Score that a place loses for each m^2 and rad^2 from the guess: of places that fit alike the
# nearest is taken. The wide search is for holes in the log, where the guess says little.
_PER_M2, _PER_RAD2 = 1.0, 0.4
_WIDE_PER_M2, _WIDE_PER_RAD2 = 0.15, 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionGuess:
    """Where a sweep is expected: at `pose` (4, 4), after `before` (4, 4) and a motion.

    `by_motion` is the place that the expected motions since the last keyframe lead to, `reliance`
    what odometry has been worth.
    """

    pose: FloatArray
    before: FloatArray
    expected: ExpectedMotion
    by_motion: Pose2
    reliance: Reliance = UNKNOWN
    planar: Pose2 = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "planar", Pose2.from_matrix(self.pose))

    @property
    def trusted(self) -> bool:
        """Whether odometry measured the motion, and is worth its name."""
        return self.expected.measured and self.reliance.trusted

    @property
    def misread(self) -> list[FloatArray]:
        """Poses (4, 4) that odometry may have misread, where a search around its own looks not.

        Wheels that only count tell nothing of the direction in which they turn: a step of the log
        may be driven backwards as a whole, or half of it. The heading of some odometry jumps, when
        it is corrected or begins anew: there the motion before goes on.
        """
        expected, places = self.expected, []
        if expected.motion.distance > SEARCH_M:
            x, y, theta = expected.motion
            backwards = product(self.before, Pose2(-x, -y, theta).matrix())
            for share in _BACKED_UP:
                place = self.pose.copy()
                place[:3, 3] += share * (backwards[:3, 3] - self.pose[:3, 3])
                places.append(place)
        if abs((expected.motion.inverse() @ expected.carried).theta) > _SEARCH_RAD:
            places.append(product(self.before, expected.carried.matrix()))
        return places if expected.measured else []

    def agrees(self, fit: Fit, slacks: float = 1.0) -> bool:
        """Whether a result is as near the guess as the robot's motion can have been.

        Odometry is held to what it has been worth, at any length of the motion, `slacks` times
        that.
        """
        motion, away = self.expected.motion, self.planar.inverse() @ fit.planar
        if self.expected.measured:
            return self.reliance.slacks(motion, away) < slacks
        near = away.distance < slacks * (_CARRIED_M + _SHARE_OF_DISTANCE * motion.distance)
        turn_rad = slacks * (_CARRIED_RAD + _SHARE_OF_TURN * abs(motion.theta))
        return near and abs(away.theta) < turn_rad

    def denies(self, fit: Fit) -> bool:
        """Whether odometry that is worth its name, or at least its way, speaks against a result."""
        if not self.expected.measured:
            return False
        away = self.planar.inverse() @ fit.planar
        elsewhere = self.reliance.place_slacks(self.expected.motion, away) >= 1.0
        if self.reliance.trusted_place and elsewhere:
            return True
        return self.reliance.trusted and not self.agrees(fit)


def best_guess(scene: Scene, before: FloatArray, expected: ExpectedMotion) -> FloatArray:
    """The pose (4, 4) expected after the pose `before`: by odometry or by the motion before.

    The motion before is carried on where odometry puts the sweep visibly off the walls. Stamps of
    wheels and laser may be apart: in turns odometry is then off by many degrees.
    """
    guess = product(before, expected.motion.matrix())
    if not expected.measured:
        return guess
    apart = expected.motion.inverse() @ expected.carried
    alike = apart.distance < _SMALL_M and abs(apart.theta) < _SMALL_RAD  # aligned to one place
    if alike or abs(apart.theta) > _SEARCH_RAD:
        return guess
    other = product(before, expected.carried.matrix())
    places = [Pose2.from_matrix(pose) for pose in (guess, other)]
    by_odometry, by_motion = (scene.score(place) for place in places)
    better = by_motion > by_odometry + _GUESS_MARGIN
    if better and by_motion < BEYOND_DOUBT:  # there may be new space
        better = scene.gain(*places) > _GUESS_MARGIN
    return other if better else guess


def near_window(*, measured: bool) -> Window:
    """Where odometry's errors, or the changes of an unmeasured motion, can have led."""
    return Window(
        distance_m=SEARCH_M if measured else _BLIND_SEARCH_M,
        angle_rad=_SEARCH_RAD if measured else _BLIND_SEARCH_RAD,
        step_m=_STEP_M,
        penalty_per_m2=_PER_M2,
        penalty_per_rad2=_PER_RAD2,
    )


def wide_search(guess: MotionGuess, config: RegistrationConfig) -> tuple[Window, Bounds]:
    """Where the robot can have come in a hole of the log, or by wheels that slipped; and bounds.

    Trusted odometry does not err by a wide turn, but wheels may have turned in vain. Without it a
    result may be as far from the guess as the search looks.
    """
    free, slipped_m = not guess.trusted, _WIDE_SEARCH_M + guess.expected.motion.distance
    window = Window(
        distance_m=_WIDE_SEARCH_M if free else min(config.max_shift_m, slipped_m),
        angle_rad=_WIDE_SEARCH_RAD if free else _SEARCH_RAD,
        step_m=_WIDE_STEP_M,
        penalty_per_m2=_WIDE_PER_M2,
        penalty_per_rad2=_WIDE_PER_RAD2,
    )
    bounds = Bounds.around(guess.pose, config)
    if not free:
        return window, bounds
    corner_m = math.hypot(_WIDE_SEARCH_M, _WIDE_SEARCH_M)
    shift_m = max(bounds.shift_m, corner_m + _WIDE_STEP_M)
    shift_rad = max(bounds.shift_rad, _WIDE_SEARCH_RAD + _SEARCH_RAD)
    return window, replace(bounds, shift_m=shift_m, shift_rad=shift_rad)

"""Where a sweep is expected: the motion since the one before, how far it may be off, the searches.

The motion is odometry's, or the motion before carried on. Registrations that are certain are
compared with the motion that odometry measured: along the way, across it, and in turn. A deviation
counts in shares of the slack that an unknown odometry has, which grows with the motion. So what
short steps showed holds for long ones, too.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, product, wrap_angle
from specmap_cli.core.odometry import SIGMAS, Slack, unknown_slack
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import Window, observability
from specmap_cli.registration.local_map import QUICK_KERNEL_VOXELS, Bounds, Fit, Scene

_S_PER_NS = 1e-9
_LATEST = 30  # sweeps whose motions and times are remembered
_HOLE = 2.0  # an interval so much longer than all of these but one is a hole in the log
_CARRIED_S = 1.0  # a longer one is none to go on in: at 1 m/s^2 a robot is 0.5 m off by then
_FASTER = 1.5  # of the largest motion seen, and no more, may be carried on: robots speed up

_REMEMBERED = 60  # latest deviations that count: some 20 m and more, so that a new floor shows
_PRIOR = 12  # deviations that an unknown odometry is taken to have had: they wear off slowly
_QUANTILE, _QUANTILE_SIGMAS = 0.8, 1.2816  # of |z| for a normal z: a fifth may be wrong
_NARROWEST, _WIDEST = 0.5, 3.0  # slacks: registration itself errs by as much; a third is no measure
_WORTHLESS = 1.5  # slacks from which on odometry is worth less than was supposed of it
_STILL_M = 1e-3  # below it a motion has no direction, and the base's own counts

# Information along a direction, beside the most in any. Noise of the ranges turns the normals of
# bare walls by some 0.1 rad and makes 0.01 of it; a wall across a corridor makes more than this.
_LEAST_SHARE = 0.05
_UNIT_NOISE_M = 1.0  # only ratios count, and heading against place at this arm

_GUESS_MARGIN = 0.05  # score by which steady motion must beat odometry as the guess
# What alignments mend at any scan: half a voxel, and as much at the walls of a room.
_SMALL_M, _SMALL_RAD = 0.05, 0.02
BEYOND_DOUBT = 0.85  # score of a place that is right without odometry: most right ones have more

# How far a motion carried on may be off, by how much a robot speeds up and turns in from one scan
# to the next: metres and radians, and shares of the motion.
_CARRIED_M, _CARRIED_RAD = 0.1, 0.12
_CARRIED_SHARE, _CARRIED_TURN_SHARE = 0.2, 0.3

SEARCH_M = 0.25  # half width of the search: odometry's error
SEARCH_RAD = 0.35  # half angle of the search: a clock apart, in a turn
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
class ExpectedMotion:
    """The motion of the base expected since the sweep before, `interval_s` seconds.

    `motion` is odometry's `increment` where that was `measured`, less what walls told while it
    hung; else both are `carried`: the motion before carried on, in a short `hole` of the log as far
    as in as long a time before it. `during` is the motion to de-skew with. `jumped` tells of an
    odometry increment too large to be a motion, `shortened` of a motion before that was too large
    to be carried on as it was.
    """

    motion: Pose2
    increment: Pose2
    carried: Pose2
    during: Pose2
    interval_s: float
    measured: bool
    jumped: bool
    shortened: bool
    hole: bool


class MotionModel:
    """Expects the next motion; tell it by `conclude` what the motion turned out to be.

    Increments are per sweep and never divided by time: stamps of some logs come in bursts or step
    backwards. A hole is longer than the bursts of its log.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self._config = config
        self._odometry: Pose2 | None = None
        self._stamp_ns: int | None = None
        self._interval_s = 0.0
        self._latest = deque([(0.0, IDENTITY)] * 2, maxlen=_LATEST)  # seconds and motions
        self._silent, self._unread = False, IDENTITY  # motion that odometry has not told yet
        # forward, sideways and in turn the two largest confirmed motions: one may be an error
        self._largest = [(0.0, 0.0)] * 3

    def expect(self, sweep: Sweep) -> ExpectedMotion:
        """The motion expected since the sweep before."""
        config, before, now = self._config, self._odometry, sweep.odom_from_base
        gap_ns = 0 if self._stamp_ns is None else sweep.stamp_ns - self._stamp_ns
        interval_s = max(0.0, gap_ns * _S_PER_NS)
        increment = None if before is None or now is None else before.inverse() @ now
        self._odometry, self._stamp_ns, self._interval_s = now, sweep.stamp_ns, interval_s
        self._silent = increment is not None and before == now
        left = self._left_of(increment) if increment is not None else None
        farthest_m = config.odometry_jump_m + config.odometry_jump_mps * interval_s
        jumped = left is not None and not left.distance <= farthest_m  # or it is NaN
        # the settings limit what may be carried on until walls have confirmed larger motions
        settings = config.carried_forward_m, config.carried_sideways_m, config.carried_rad
        both = zip(settings, self._largest, strict=True)
        limits = Pose2(*(max(limit, _FASTER * second) for limit, (_, second) in both))
        # Odometry, whose clock may be apart from the laser's, draws walls double in turns. The last
        # motion alone feeds each error back with its sign turned: a robot at rest would seem to
        # swing, ever wider. The mean of the last two lets go of what alternates.
        (_, a), (_, b) = self._latest[-2], self._latest[-1]
        steady = Pose2((a.x + b.x) / 2, (a.y + b.y) / 2, (a.theta + b.theta) / 2)
        # within limits: what is carried on must not grow from scan to scan by an error
        carried, during = (
            Pose2(*(max(-m, min(m, v)) for v, m in zip(motion, limits, strict=True)))
            for motion in (b, steady)
        )
        # sweeps are missing, so few that the robot will have kept its motion
        known = sorted(interval_s for interval_s, _ in self._latest)
        hole = len(known) == _LATEST and _HOLE * known[-2] < interval_s <= _CARRIED_S
        if hole:
            carried = self._carried_for(interval_s)
        measured = left is not None and not jumped
        timed = sweep.planar.beam_times_s is not None or sweep.cloud_times_s is not None
        return ExpectedMotion(
            motion=left if left is not None and measured else carried,
            increment=increment if increment is not None and measured else carried,
            carried=carried,
            during=during,
            interval_s=interval_s,
            measured=measured,
            jumped=jumped,
            shortened=(not (measured or hole) and carried != b) or (timed and during != steady),
            hole=hole,
        )

    def _left_of(self, increment: Pose2) -> Pose2:
        """What is left of odometry's increment where it hung and now makes up for it.

        Walls told the rest meanwhile, more than odometry errs by. Wheels that stood while the robot
        was pushed make up for nothing: steady motion tells which.
        """
        unread, (_, steady) = self._unread, self._latest[-1]
        if self._silent or UNKNOWN.slacks(increment, unread) < 1.0:
            return increment
        left = unread.inverse() @ increment
        apart = [steady.inverse() @ motion for motion in (left, increment)]
        hung, pushed = (motion.distance + abs(motion.theta) for motion in apart)
        return left if hung < pushed else increment

    def _carried_for(self, seconds: float) -> Pose2:
        """The motion in as long a time before."""
        motion, left_s = IDENTITY, seconds
        for interval_s, step in reversed(self._latest):
            motion, left_s = step @ motion, left_s - interval_s
            if left_s < 0.5 * interval_s:
                break
        return motion

    def conclude(self, motion: Pose2, *, confirmed: bool = False) -> None:
        """Remember the motion since the sweep before; walls may have `confirmed` it."""
        self._latest.append((self._interval_s, motion))
        self._unread = self._unread @ motion if self._silent else IDENTITY
        if confirmed:
            sizes = zip(self._largest, motion, strict=True)
            ranked = [sorted((*pair, abs(value)), reverse=True) for pair, value in sizes]
            self._largest = [(first, second) for first, second, _ in ranked]


@dataclass(frozen=True, slots=True)
class Reliance:
    """The latest deviations from odometry, in slacks of an unknown odometry; never changed.

    `limits` are the deviations that still agree, in the same slacks.
    """

    along: tuple[float, ...] = field(default=())
    across: tuple[float, ...] = field(default=())
    turn: tuple[float, ...] = field(default=())
    limits: Slack = field(init=False)

    def __post_init__(self) -> None:
        sizes, usual = [], _QUANTILE_SIGMAS / SIGMAS  # 1 for an odometry of which nothing is known
        for deviations in (self.along, self.across, self.turn):
            known = sorted((*(usual,) * _PRIOR, *deviations))
            sigma = known[int(_QUANTILE * len(known))] / _QUANTILE_SIGMAS
            sizes.append(min(_WIDEST, max(_NARROWEST, SIGMAS * sigma)))
        object.__setattr__(self, "limits", Slack(*sizes))

    @property
    def trusted(self) -> bool:
        """Whether odometry is worth what is supposed of an unknown one, or more."""
        return self.trusted_place and self.limits.turn_rad < _WORTHLESS

    @property
    def trusted_place(self) -> bool:
        """The same of its way alone: wheels may measure that well and turns badly."""
        return max(self.limits.along_m, self.limits.across_m) < _WORTHLESS

    def slack(self, motion: Pose2) -> Slack:
        """How far the truth can be from a motion that odometry measured."""
        unknown = unknown_slack(motion)
        return Slack(
            along_m=self.limits.along_m * unknown.along_m,
            across_m=self.limits.across_m * unknown.across_m,
            turn_rad=self.limits.turn_rad * unknown.turn_rad,
        )

    def slacks(self, motion: Pose2, away: Pose2) -> float:
        """How many slacks a result so far `away` from odometry's place is off, place or turn."""
        turn = abs(_in_slacks(motion, away)[2]) / self.limits.turn_rad
        return max(self.place_slacks(motion, away), turn)

    def place_slacks(self, motion: Pose2, away: Pose2) -> float:
        """How many slacks it is off in its place alone."""
        along, across, _ = _in_slacks(motion, away)
        return math.hypot(along / self.limits.along_m, across / self.limits.across_m)

    def after(
        self, motion: Pose2, away: Pose2, aligned: Pose2, fixed: tuple[bool, bool]
    ) -> Reliance:
        """The reliance after a certain registration, so far `away` from the motion measured.

        `aligned` is the same of walls alone. They err, too, and what odometry has pulled flatters
        it: of errors o of odometry and w of walls, the one deviates by o + w, the other by the
        share o^2 / (o^2 + w^2) of that. The geometric mean of both is o.
        `fixed` says whether walls fix the place along the way, and whether across it. A direction
        that they do not fix says nothing about odometry.
        """
        known = [self.along, self.across, self.turn]
        both = zip(_in_slacks(motion, away), _in_slacks(motion, aligned), strict=True)
        for k, (pair, counts) in enumerate(zip(both, (*fixed, True), strict=True)):
            if counts:
                known[k] = (*known[k], math.sqrt(abs(math.prod(pair))))[-_REMEMBERED:]
        return Reliance(*known)


def direction_of(motion: Pose2) -> tuple[float, float]:
    """The unit vector along a motion, in the frame in which the motion ends."""
    if motion.distance < _STILL_M:
        return 1.0, 0.0
    c, s = math.cos(motion.theta), math.sin(motion.theta)
    x, y = motion.x / motion.distance, motion.y / motion.distance
    return c * x + s * y, c * y - s * x


def _in_slacks(motion: Pose2, away: Pose2) -> tuple[float, float, float]:
    """A deviation, seen from the end of a motion, in slacks of an unknown odometry.

    Along the way, across it, and in turn.
    """
    unknown, (x, y) = unknown_slack(motion), direction_of(motion)
    along, across = away.x * x + away.y * y, away.y * x - away.x * y
    turn = wrap_angle(away.theta) / unknown.turn_rad
    return along / unknown.along_m, across / unknown.across_m, turn


UNKNOWN = Reliance()  # nothing was compared yet


def fixed_directions(scan: PlanarScan, base_from_laser: Pose2, motion: Pose2) -> tuple[bool, bool]:
    """Whether a scan's walls fix the place along a motion that ends there, and across it."""
    fisher = observability(base_from_laser.apply(scan.hits()), _UNIT_NOISE_M)
    arm, moment = fisher[:2, 2], float(fisher[2, 2])
    place = fisher[:2, :2] - np.outer(arm, arm) / moment if moment > 0.0 else fisher[:2, :2]
    most = float(np.trace(place))
    x, y = direction_of(motion)
    along, across = np.array([x, y]), np.array([-y, x])
    shares = [float(way @ place @ way) for way in (along, across)]
    return shares[0] > _LEAST_SHARE * most, shares[1] > _LEAST_SHARE * most


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionGuess:
    """Where a sweep is expected: at `pose` (4, 4), after `before` (4, 4) and a motion.

    `by_motion` is the place that the expected motions since the last keyframe lead to, `since` what
    they sum up to, or without odometry the usual one. `reliance` is what odometry has been worth.
    """

    pose: FloatArray
    before: FloatArray
    expected: ExpectedMotion
    by_motion: Pose2
    since: Pose2 = IDENTITY
    reliance: Reliance = UNKNOWN
    planar: Pose2 = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "planar", Pose2.from_matrix(self.pose))

    @property
    def trusted(self) -> bool:
        """Whether odometry measured the motion, and is worth its name."""
        return self.expected.measured and self.reliance.trusted

    @property
    def beyond_search(self) -> bool:
        """Whether odometry measured so long a motion that its error may exceed every search."""
        slack = self.reliance.slack(self.expected.motion)
        beyond = slack.place_m > _WIDE_SEARCH_M or slack.turn_rad > SEARCH_RAD
        return self.expected.measured and beyond

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
        if abs((expected.motion.inverse() @ expected.carried).theta) > SEARCH_RAD:
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
        near = away.distance < slacks * self.carried_slack_m
        turn_rad = slacks * (_CARRIED_RAD + _CARRIED_TURN_SHARE * abs(motion.theta))
        return near and abs(away.theta) < turn_rad

    def agrees_since_keyframe(self, fit: Fit) -> bool:
        """Whether odometry's whole motion since the last keyframe can have led to a result."""
        away = self.by_motion.inverse() @ fit.planar
        return self.expected.measured and self.reliance.slacks(self.since, away) < 1.0

    @property
    def carried_slack_m(self) -> float:
        """How far the place can be from where a motion carried on leads."""
        return _CARRIED_M + _CARRIED_SHARE * self.expected.motion.distance

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
    wheels and laser may be apart: in turns odometry is then off by many degrees. In a hole of the
    log wheels may have turned without being read.
    """
    guess = product(before, expected.motion.matrix())
    if not expected.measured:
        return guess
    other = product(before, expected.carried.matrix())
    if expected.hole:
        window = near_window(measured=True)
        found = [
            scene.search(place, window, QUICK_KERNEL_VOXELS, Bounds.around(place, scene.config))
            for place in (guess, other)
        ]
        is_better = scene.gain(*(fit.planar for fit in found)) > _GUESS_MARGIN
        return found[1].pose if is_better else guess
    apart = expected.motion.inverse() @ expected.carried
    alike = apart.distance < _SMALL_M and abs(apart.theta) < _SMALL_RAD  # aligned to one place
    if alike or apart.distance > _WIDE_SEARCH_M or abs(apart.theta) > SEARCH_RAD:
        return guess
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
        angle_rad=SEARCH_RAD if measured else _BLIND_SEARCH_RAD,
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
        angle_rad=_WIDE_SEARCH_RAD if free else SEARCH_RAD,
        step_m=_WIDE_STEP_M,
        penalty_per_m2=_WIDE_PER_M2,
        penalty_per_rad2=_WIDE_PER_RAD2,
    )
    bounds = Bounds.around(guess.pose, config)
    if not free:
        return window, bounds
    corner_m = math.hypot(_WIDE_SEARCH_M, _WIDE_SEARCH_M)
    shift_m = max(bounds.shift_m, corner_m + _WIDE_STEP_M)
    shift_rad = max(bounds.shift_rad, _WIDE_SEARCH_RAD + SEARCH_RAD)
    return window, replace(bounds, shift_m=shift_m, shift_rad=shift_rad)

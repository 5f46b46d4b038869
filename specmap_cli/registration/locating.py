"""Where a sweep was taken: from the guess to the best pose that can be found on the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, product
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import Window
from specmap_cli.registration.expected_motion import ExpectedMotion
from specmap_cli.registration.scene import Fit, Scene

# Steps of the two searches: about a cell of the score field, no finer, and a rough one.
_STEP_M, _WIDE_STEP_M = 0.05, 0.1
# Score that a place loses for each m^2 and rad^2 from the guess: of places that fit alike the
# nearest is taken. The wide search is for holes in the log, where the guess says little.
_PER_M2, _PER_RAD2 = 1.0, 0.4
_WIDE_PER_M2, _WIDE_PER_RAD2 = 0.15, 0.05
_WIDER = 2.0  # first kernel after a wide search, in widest kernels: its steps are coarser
_ALIKE = 0.01  # scores this near speak for two places alike
_SHARES = (1.0, 0.75, 0.5, 0.25)  # of the way to odometry's place, tried in this order


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """The best pose found, and which searches the doubts about it called for."""

    fit: Fit
    searched: bool
    wide_searched: bool


def best_guess(scene: Scene, before: FloatArray, expected: ExpectedMotion) -> FloatArray:
    """The pose (4, 4) expected after the pose `before`: by odometry or by the motion before.

    The motion before is carried on where odometry puts the sweep visibly off the walls. Stamps of
    wheels and laser may be apart: in turns odometry is then off by many degrees.
    """
    guess = product(before, expected.motion.matrix())
    if not expected.measured:
        return guess
    other = product(before, expected.carried.matrix())
    by_odometry, by_motion = (scene.score(Pose2.from_matrix(pose)) for pose in (guess, other))
    return other if by_motion > by_odometry + scene.config.guess_margin else guess


def locate(scene: Scene, guess: FloatArray, expected: ExpectedMotion, by_motion: Pose2) -> Located:
    """The best pose found from a guess (4, 4).

    `by_motion` is the place that the expected motions since the last keyframe lead to.
    """
    config, kernels = scene.config, scene.config.kernel_voxels
    fit = scene.align(guess, kernels)
    doubted = _is_doubted(guess, fit, config)
    if doubted:
        window = _window(config, measured=expected.measured)
        fit = fit.or_better(scene.search(guess, window, kernels))
    poor = fit.score < config.poor_score
    if poor:
        wider = (_WIDER * kernels[0], *kernels)
        fit = fit.or_better(scene.search(guess, _wide_window(config), wider))
    if expected.measured and not doubted:
        fit = _slid(scene, fit, by_motion)
    return Located(fit=fit, searched=doubted, wide_searched=poor)


def _is_doubted(guess: FloatArray, fit: Fit, config: RegistrationConfig) -> bool:
    """Whether an alignment scores too low, or ended too far from its guess, to be just taken."""
    away = Pose2.from_matrix(guess).inverse() @ fit.planar
    far = away.distance >= config.doubt_m or abs(away.theta) >= config.doubt_rad
    return far or fit.score <= config.good_score


def _window(config: RegistrationConfig, *, measured: bool) -> Window:
    """Where odometry's errors, or the changes of an unmeasured motion, can have led."""
    distance_m = config.search_m if measured else config.blind_search_m
    angle_rad = config.search_rad if measured else config.blind_search_rad
    return Window(
        distance_m=distance_m,
        angle_rad=angle_rad,
        step_m=_STEP_M,
        penalty_per_m2=_PER_M2,
        penalty_per_rad2=_PER_RAD2,
    )


def _wide_window(config: RegistrationConfig) -> Window:
    """Where the robot can have come in a hole of the log."""
    distance_m, angle_rad = config.wide_search_m, config.wide_search_rad
    return Window(
        distance_m=distance_m,
        angle_rad=angle_rad,
        step_m=_WIDE_STEP_M,
        penalty_per_m2=_WIDE_PER_M2,
        penalty_per_rad2=_WIDE_PER_RAD2,
    )


def _slid(scene: Scene, fit: Fit, by_motion: Pose2) -> Fit:
    """The place nearest the one by odometry that the walls speak for as well as for `fit`.

    Along a bare corridor all places score alike and registration stays behind, a little at every
    sweep: how far the robot came since the last keyframe is believed from odometry, as long as
    the score does not object. Heading and offset from the walls stay those of `fit`.
    """
    here = fit.planar
    forward = np.array([np.cos(here.theta), np.sin(here.theta)])
    behind = float(np.dot((by_motion.x - here.x, by_motion.y - here.y), forward))
    if abs(behind) < scene.config.slip_m:
        return fit
    for share in _SHARES:
        place = here @ Pose2(share * behind, 0.0, 0.0)
        score = scene.score(place)
        if score >= fit.score - _ALIKE:
            pose = product((place @ here.inverse()).matrix(), fit.pose)
            return Fit(pose=pose, score=score, refused=fit.refused)
    return fit

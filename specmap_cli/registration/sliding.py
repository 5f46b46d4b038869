"""Along a bare corridor: how far the robot came is not for the walls to say.

All places along it score alike, and registration stays behind, a little at every sweep.
"""

from __future__ import annotations

import math

import numpy as np

from specmap_cli.core.geometry import Pose2, product
from specmap_cli.grids.matching import weakest_direction
from specmap_cli.registration.prospect import BEYOND_DOUBT
from specmap_cli.registration.scene import Fit, Scene

_SLIP_M = 0.08  # a result this far behind odometry may have slipped in a corridor
_ALIKE = 0.01  # scores this near speak for two places alike
# Score that walls lose at a place they object to; what noise of the last scan, seen again at the
# same place, seems to prove is less.
_OBJECTS = 0.05
_SHARES = (1.0, 0.75, 0.5, 0.25)  # of the way to odometry's place, tried in this order


def slid(scene: Scene, fit: Fit, by_motion: Pose2) -> Fit:
    """The place nearest the one by odometry that the walls speak for as well as for `fit`.

    Along a bare corridor all places score alike and registration stays behind, a little at every
    sweep: how far the robot came since the last keyframe is believed from odometry, as long as
    the score does not object. Heading and offset from the walls stay those of `fit`.
    """
    here = fit.planar
    forward = np.array([np.cos(here.theta), np.sin(here.theta)])
    behind = float(np.dot((by_motion.x - here.x, by_motion.y - here.y), forward))
    if abs(behind) < _SLIP_M:
        return fit
    if not scene.local.sensor.in_space:
        along = carried_along(scene, fit, by_motion)
        if along is not fit:
            return along
    for share in _SHARES:
        place = here @ Pose2(share * behind, 0.0, 0.0)
        score = scene.score(place)
        alike = score >= fit.score - _ALIKE
        if not alike and fit.score < BEYOND_DOUBT:  # there may be new space
            alike = scene.gain(here, place) >= -_ALIKE
        if alike:
            pose = product((place @ here.inverse()).matrix(), fit.pose)
            return Fit(pose=pose, score=score, refused=fit.refused)
    return fit


def carried_along(scene: Scene, fit: Fit, by_motion: Pose2) -> Fit:
    """A result that comes as far as the motion expected, along what the walls do not fix.

    Along a bare corridor registration stays behind at every sweep, and the robot seems to stand
    still. The place is taken only if the sweep's walls fit as well there.
    """
    view, here = scene.view, fit.planar
    weakest = weakest_direction(view.base_from_laser.apply(view.planar.hits()))
    if not weakest.open:
        return fit
    heading = here.theta + weakest.heading
    x, y = math.cos(heading), math.sin(heading)
    along = (by_motion.x - here.x) * x + (by_motion.y - here.y) * y
    place = Pose2(here.x + along * x, here.y + along * y, here.theta)
    score = scene.score(place)
    if score < fit.score - _OBJECTS and scene.gain(here, place) < -_OBJECTS:
        return fit
    pose = product((place @ here.inverse()).matrix(), fit.pose)
    return Fit(pose=pose, score=score, refused=fit.refused)

"""Where a sweep was taken: from the guess to the best pose that can be found on the local map."""

from __future__ import annotations

from dataclasses import dataclass, replace

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.prospect import BEYOND_DOUBT, Prospect
from specmap_cli.registration.scene import Bounds, Fit, Scene, Support
from specmap_cli.registration.search_windows import SEARCH_M, near_window, wide_bounds, wide_window
from specmap_cli.registration.sliding import carried_along, slid

_KERNEL_VOXELS = (2.0, 1.0, 0.5, 0.25)  # widths of the robust kernel, in voxels, coarse to fine
GOOD_SCORE = 0.75  # up to this score a search is made
_DOUBT_M = 0.15  # a search is also made when the result is this far from its guess
_DOUBT_RAD = 0.1  # a search is also made when the result is turned this far from its guess
POOR_SCORE = 0.5  # below this score the wide search is made, too
SURE_SCORE = 0.7  # score needed against odometry once a search was made, or the scan is lost
FAIR_SCORE = 0.6  # score needed without odometry, or the scan is lost
_WIDER = 2.0  # first kernel after a wide search, in widest kernels: its steps are coarser
_FINE_KERNELS = (0.5, 0.25)  # voxels: they follow only walls near by, not new ones from afar
# Share of a sweep's walls that could be seen, from which on they say something; and with which they
# say as much as all of them.
ENOUGH, MOST = 0.2, 0.5
_NEARLY_ALL = 0.9  # share of a sweep's walls that could be seen, from which on none are new
# Slacks within which odometry and the walls that could be seen prove a place together; and those of
# odometry that is trusted.
_NEARLY, _ROUGHLY = 2.0, 3.0
_PER_SLACK = 0.05  # score that a place must have more for each slack away from odometry's
# Score that another place must have more to refute trusted odometry's: wheels that slip make 0.4.
_REFUTES = 0.25
_BACKED_UP = (1.0, 0.5)  # shares of a step that are tried as driven backwards


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """The best pose found, and which searches the doubts about it called for.

    `agrees`: it agrees with the motion expected. `support` is what the walls say of it that could
    be seen there. `unaligned`: it is the guess itself, as the walls do not lead to a better pose.
    """

    fit: Fit
    searched: bool
    wide_searched: bool
    agrees: bool
    support: Support
    unaligned: bool = False


def locate(scene: Scene, prospect: Prospect) -> Located:
    """The best pose found for a sweep, never farther from its guess than the bounds allow."""
    config, guess = scene.config, prospect.guess
    kernels, bounds = _KERNEL_VOXELS, Bounds.around(guess, config)
    fit = _first_fit(scene, prospect, bounds)
    doubted = _is_doubted(guess, fit) and not _is_settled(scene, prospect, fit)
    if doubted:
        window = near_window(measured=prospect.expected.measured)
        found = scene.search(guess, window, kernels, bounds)
        fit = _better(scene, prospect, fit, found, guess)
        fit = _backed_up(scene, prospect, fit)
        fit = _unturned(scene, prospect, fit)
    wide = doubted and _calls_for_wide_search(scene, prospect, fit)
    if wide:
        wider = (_WIDER * kernels[0], *kernels)
        far = not prospect.trusted or prospect.expected.hole
        reach = wide_bounds(guess, config) if far else bounds
        window = wide_window(prospect, config, free=far)
        if not far and _speaks_against(scene.support(fit.planar), config):
            window = replace(window, angle_rad=config.max_shift_rad)
        fit = fit.or_better(scene.search(guess, window, wider, reach))
    if prospect.expected.measured and not doubted:
        fit = slid(scene, fit, prospect.by_motion)
    elif not prospect.expected.measured and not scene.local.sensor.in_space:
        fit = carried_along(scene, fit, prospect.by_motion)
    return _concluded(scene, prospect, fit, searched=doubted, wide_searched=wide)


def _first_fit(scene: Scene, prospect: Prospect, bounds: Bounds) -> Fit:
    """The alignment from the guess: a quick one where that leaves no doubt, else by all kernels.

    A motion carried on may err by more than a quick one mends, and streets look alike.
    """
    guess = prospect.guess
    if prospect.expected.measured:
        quick = scene.align_quickly(guess, bounds)
        sure = quick.score >= BEYOND_DOUBT and not quick.refused
        if sure and not _is_far(guess, quick):
            return quick
    return scene.align(guess, _KERNEL_VOXELS, bounds)


def _concluded(
    scene: Scene, prospect: Prospect, fit: Fit, *, searched: bool, wide_searched: bool
) -> Located:
    """The result, or trusted odometry's own place where that is the better one."""
    support = _support(scene, fit)
    near = prospect.agrees(fit) or _agrees_with_walls(prospect, fit, support)
    unaligned = False
    doubted = searched or fit.score < SURE_SCORE
    if prospect.trusted and doubted and not near:
        own = _by_odometry(scene, prospect)
        there = scene.support(own.planar)
        if _is_tenable(scene, own, there, fit):
            fit, support, near = replace(own, refused=fit.refused), there, True
            unaligned = True
    return Located(
        fit=fit,
        searched=searched,
        wide_searched=wide_searched,
        agrees=near,
        support=support,
        unaligned=unaligned,
    )


def _by_odometry(scene: Scene, prospect: Prospect) -> Fit:
    """Odometry's own place, on walls near by if that agrees with it."""
    guess = prospect.guess
    closer = scene.align(guess, _FINE_KERNELS)
    if prospect.agrees(closer):
        return closer
    return Fit(pose=guess, score=scene.score(Pose2.from_matrix(guess)))


def _is_tenable(scene: Scene, own: Fit, support: Support, other: Fit) -> bool:
    """Whether trusted odometry's own place may be the right one, and not another far from it.

    The walls may object to it only if they are clearly better explained at the other place, over
    those that could be seen from both. Rooms and corridors that look alike explain new walls well.
    """
    config = scene.config
    if _speaks_against(support, config):
        return False
    explained = support.share >= ENOUGH and support.score >= SURE_SCORE
    if other.score < SURE_SCORE or explained:
        return True
    return scene.gain(own.planar, other.planar) < _REFUTES


def _agrees_with_walls(prospect: Prospect, fit: Fit, support: Support) -> bool:
    """Whether a result is a little too far from odometry's place, but the walls speak for it."""
    if not prospect.expected.measured or support.share < MOST:
        return False
    near = prospect.agrees(fit, _ROUGHLY if prospect.trusted else _NEARLY)
    return near and support.score >= SURE_SCORE


def _support(scene: Scene, fit: Fit) -> Support:
    """What the walls say of a result; where nearly all fit, all of them."""
    if fit.score > GOOD_SCORE:
        return Support(score=fit.score, share=1.0, count=len(scene.view.probe))
    return scene.support(fit.planar)


def _speaks_against(support: Support, config: RegistrationConfig) -> bool:
    """Whether the walls that could be seen are enough to say no, and do."""
    enough = support.count >= config.min_points and support.share >= ENOUGH
    return enough and support.score < POOR_SCORE * min(1.0, support.share / MOST)


def _is_settled(scene: Scene, prospect: Prospect, fit: Fit) -> bool:
    """Whether a result scores low for new space alone: what could be seen speaks for it."""
    if not prospect.agrees(fit):
        return False
    support = scene.support(fit.planar)
    share = ENOUGH if prospect.trusted else MOST
    return support.share >= share and support.score > GOOD_SCORE


def _better(scene: Scene, prospect: Prospect, fit: Fit, found: Fit, place: FloatArray) -> Fit:
    """The better one of a result and of what a search around a place (4, 4) found.

    A place that agrees with trusted odometry and that the walls speak for is not given up for one
    that does not agree: new walls that lie on old ones somewhere else do not prove it. Where hardly
    any wall is new, it is given up for a place that fits better by so much that odometry errs so.
    """
    if not (prospect.agrees(fit) and prospect.denies(found)):
        return fit.or_better(found)
    support = scene.support(fit.planar)
    if support.share < _NEARLY_ALL:
        kept = support.share >= ENOUGH and support.score >= FAIR_SCORE
    else:
        needed = fit.score + _PER_SLACK * prospect.slacks(Pose2.from_matrix(place), found)
        kept = found.score < needed
    return replace(fit, refused=fit.refused + found.refused) if kept else fit.or_better(found)


def _backed_up(scene: Scene, prospect: Prospect, fit: Fit) -> Fit:
    """The better one of a doubtful result and of a place behind it.

    Wheels that only count tell nothing of the direction in which they turn. A step of the log may
    be driven backwards as a whole, or half of it.
    """
    config, reverse = scene.config, prospect.reverse
    step_m = prospect.expected.motion.distance
    if reverse is None or fit.score >= BEYOND_DOUBT or step_m <= SEARCH_M:
        return fit
    for share in _BACKED_UP:
        forward = share * (reverse[:3, 3] - prospect.guess[:3, 3])
        place = prospect.guess.copy()
        place[:3, 3] += forward
        window = near_window(measured=True)
        bounds = Bounds.around(place, config)
        found = scene.search(place, window, _KERNEL_VOXELS, bounds)
        if found.score >= BEYOND_DOUBT:
            fit = _better(scene, prospect, fit, found, place)
    return fit


def _unturned(scene: Scene, prospect: Prospect, fit: Fit) -> Fit:
    """A poor result, or the place without odometry's turn, if most walls there are known and fit.

    Where odometry's turn is right, walls come into sight that are new at the other place.
    """
    if prospect.unturned is None or fit.score >= POOR_SCORE:
        return fit
    found = scene.align(prospect.unturned, _KERNEL_VOXELS)
    support = scene.support(found.planar)
    certain = support.share >= MOST and support.score > GOOD_SCORE
    return fit.or_better(found) if certain else replace(fit, refused=fit.refused + found.refused)


def _calls_for_wide_search(scene: Scene, prospect: Prospect, fit: Fit) -> bool:
    """Whether a result is poor or contradicts the motion expected, and not for new space alone.

    Before a contradiction is believed, the robot is looked for wherever it can have come.
    """
    agreeing = prospect.agrees(fit)
    if fit.score >= (SURE_SCORE if agreeing else BEYOND_DOUBT):
        return False
    support = scene.support(fit.planar)
    new = support.share < _NEARLY_ALL or not prospect.expected.measured
    if agreeing and fit.score >= POOR_SCORE and new:
        return False
    return not (agreeing and support.share >= MOST and support.score >= FAIR_SCORE)


def _is_doubted(guess: FloatArray, fit: Fit) -> bool:
    """Whether an alignment scores too low, or ended too far from its guess, to be just taken."""
    return _is_far(guess, fit) or fit.score <= GOOD_SCORE


def _is_far(guess: FloatArray, fit: Fit) -> bool:
    """Whether an alignment ended farther from its guess than most do."""
    away = Pose2.from_matrix(guess).inverse() @ fit.planar
    return away.distance >= _DOUBT_M or abs(away.theta) >= _DOUBT_RAD

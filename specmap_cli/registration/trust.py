"""The best pose found for a sweep, and whether it can be believed.

It is judged by its score, how well the sweep's walls lie on the local map's, together with whether
it agrees with the expected motion. Neither alone will do: a robot that enters a room scores 0.35 to
0.5 at the right pose, and a wrong pose in a corridor can score 0.8. Along a bare corridor how far
the robot came is not for the walls to say at all, see `_carried_along`.

A map is founded when a second sweep fits its first one; until then its scans are held back. A first
sweep that was spoiled, by a person before the laser or a driver that starts, would else be the
truth that all others are lost against.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.odometry import SIGMAS
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.guess import (
    BEYOND_DOUBT,
    MotionGuess,
    near_window,
    wide_search,
)
from specmap_cli.registration.local_map import Bounds, Fit, Scene, Support

_KERNEL_VOXELS = (2.0, 1.0, 0.5, 0.25)  # widths of the robust kernel, in voxels, coarse to fine
GOOD_SCORE = 0.75  # up to this score a search is made
_DOUBT_M = 0.15  # a search is also made when the result is this far from its guess
_DOUBT_RAD = 0.1  # a search is also made when the result is turned this far from its guess
POOR_SCORE = 0.5  # below this score the wide search is made, too
SURE_SCORE = 0.7  # score needed against odometry once a search was made, or the scan is lost
FAIR_SCORE = 0.6  # score needed without odometry, or the scan is lost
_WIDER_KERNELS = (4.0, *_KERNEL_VOXELS)  # after a wide search, whose steps are coarser
_FINE_KERNELS = (0.5, 0.25)  # voxels: they follow only walls near by, not new ones from afar
# Share of a sweep's walls that could be seen, from which on they say something; and with which they
# say as much as all of them.
ENOUGH, MOST = 0.2, 0.5
_NEARLY_ALL = 0.9  # share of a sweep's walls that could be seen, from which on none are new
# Slacks within which odometry and the walls that could be seen prove a place together; and those of
# odometry that is trusted.
_NEARLY, _ROUGHLY = 2.0, 3.0
_PER_SLACK = 0.05  # score that a place must have more for each slack away from odometry's
_POINTS_PER_SLACK = 2.5  # the same in points that fit better, where a sweep is narrow
# Score that another place must have more to refute trusted odometry's: wheels that slip make 0.4.
_REFUTES = 0.25

_READING_M = 0.05  # error of a reading that is matched: neighbours err alike
_LEAST_SHARE = 0.02  # of a motion expected that is worth a look
_CLOSED_SHARE = 0.95  # of beams that return: walls close around such a scan
_SLIP_M = 0.08  # a result this far behind odometry may have slipped in a corridor
_ALIKE = 0.01  # scores this near speak for two places alike
_SHARES = (1.0, 0.75, 0.5, 0.25)  # of the way to odometry's place, tried in this order
# Score that walls lose at a place they object to; what noise of the last scan, seen again at the
# same place, seems to prove is less.
_OBJECTS = 0.05

_PROVES = 0.85  # score that proves a motion by itself: most right results have more
_BEHIND_M = 0.3  # a beam that ends farther behind a wall has looked through it: noise is less
_HOPELESS = 0.15  # below it no agreement helps: points thrown at random score as much


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """The best pose found, and which searches the doubts about it called for.

    `agrees`: it agrees with the motion expected. `overrules`: the walls that could be seen leave no
    doubt that trusted odometry errs. `support` is what they say of it. `unaligned`: it is the guess
    itself, as the walls do not lead to a better pose. `loose` (2,) points, in the map, where walls
    fix the place least. As long as it is, of 1, the motion expected counts, and not the walls.
    """

    fit: Fit
    searched: bool
    wide_searched: bool
    agrees: bool
    support: Support
    overrules: bool = False
    unaligned: bool = False
    loose: FloatArray = field(default_factory=lambda: np.zeros(2))


def locate(scene: Scene, guess: MotionGuess) -> Located:
    """The best pose found for a sweep, never farther from its guess than the bounds allow."""
    config, measured = scene.config, guess.expected.measured
    bounds = Bounds.around(guess.pose, config)
    # a motion carried on may err by more than a quick alignment mends, and streets look alike
    fit = scene.align_quickly(guess.pose, bounds) if measured else None
    if fit is None or fit.score < BEYOND_DOUBT or fit.refused or _is_far(guess, fit):
        fit = scene.align(guess.pose, _KERNEL_VOXELS, bounds)
    doubted = fit.score <= GOOD_SCORE or _is_far(guess, fit)
    if doubted and guess.agrees(fit):  # no longer if the walls that could be seen speak for it
        support = scene.support(fit.planar)
        share = ENOUGH if guess.trusted else MOST
        doubted = support.share < share or support.score <= GOOD_SCORE
    if doubted:
        fit = _searched(scene, guess, fit, bounds)
    agreeing = guess.agrees(fit)
    # before a contradiction is believed, the robot is looked for wherever it can have come
    wide = doubted and fit.score < (SURE_SCORE if agreeing else BEYOND_DOUBT)
    if wide and agreeing:  # not if the score is low for new space alone
        support = scene.support(fit.planar)
        new = support.share < _NEARLY_ALL or not measured
        known = support.share >= MOST and support.score >= FAIR_SCORE
        wide = not known and not (new and fit.score >= POOR_SCORE)
    if wide:
        window, reach = wide_search(guess, config)
        contradicted = _speaks_against(scene.support(fit.planar), config)
        if guess.trusted and contradicted:
            window = replace(window, angle_rad=config.max_shift_rad)
        found = scene.search(guess.pose, window, _WIDER_KERNELS, reach)
        # wheels give way to walls that object to their place, not to few that fit elsewhere, too
        if contradicted and not scene.is_narrow:
            fit = fit.or_better(found)
        else:
            fit = _better(scene, guess, fit, found, guess.planar)
    loose = np.zeros(2)
    if not measured:
        fit, loose = _carried_along(scene, guess, fit)
    elif scene.is_narrow:
        fit = _fused(scene, guess, fit)
    elif not doubted:
        fit = _slid(scene, guess, fit)
    located = _concluded(scene, guess, fit, searched=doubted, wide_searched=wide)
    return located if located.unaligned else replace(located, loose=loose)


def _concluded(
    scene: Scene, guess: MotionGuess, fit: Fit, *, searched: bool, wide_searched: bool
) -> Located:
    """The result, or trusted odometry's own place where that is the better one.

    Walls speak for a result a little too far from it, and against its own only if they are clearly
    better explained: all of them where hardly any is new, else those that could be seen from both,
    as rooms that look alike explain new walls.
    """
    if fit.score > GOOD_SCORE:  # nearly all walls fit: they all count
        support = Support(score=fit.score, share=1.0, count=len(scene.view.probe))
    else:
        support = scene.support(fit.planar)
    agrees, overrules, unaligned = guess.agrees(fit), False, False
    if scene.is_narrow:
        agrees = agrees or guess.agrees_since_keyframe(fit)
    spoken_for = support.share >= MOST and support.score >= SURE_SCORE
    weighed = scene.is_narrow and guess.trusted
    if guess.expected.measured and spoken_for and not (agrees or weighed):
        agrees = guess.agrees(fit, _ROUGHLY if guess.trusted else _NEARLY)
    if guess.trusted and not agrees and (searched or fit.score < SURE_SCORE):
        own = scene.align(guess.pose, _FINE_KERNELS)  # on walls near by, if that agrees
        if not guess.agrees(own):
            own = Fit(pose=guess.pose, score=scene.score(guess.planar))
        there = scene.support(own.planar)
        explained = there.share >= ENOUGH and there.score >= SURE_SCORE
        overrules = weighed and _outweighs(scene, guess, fit, own, guess.planar)
        sure = not weighed and (fit.score >= SURE_SCORE or spoken_for)
        if sure and there.share >= _NEARLY_ALL:
            overrules = _outdoes(guess, fit, own, guess.planar)
        if sure and not (explained or overrules):
            overrules = scene.gain(own.planar, fit.planar) >= _REFUTES
        if not (overrules or _speaks_against(there, scene.config)):
            fit, support = replace(own, refused=fit.refused), there
            agrees = unaligned = True
    return Located(
        fit=fit,
        searched=searched,
        wide_searched=wide_searched,
        agrees=agrees,
        support=support,
        overrules=overrules,
        unaligned=unaligned,
    )


def _speaks_against(support: Support, config: RegistrationConfig) -> bool:
    """Whether the walls that could be seen are enough to say no, and do."""
    enough = support.count >= config.min_points and support.share >= ENOUGH
    return enough and support.score < POOR_SCORE * min(1.0, support.share / MOST)


def _searched(scene: Scene, guess: MotionGuess, fit: Fit, bounds: Bounds) -> Fit:
    """The best of a doubtful result and of searches around all that is expected, or was misread."""
    window = near_window(measured=guess.expected.measured)
    found = scene.search(guess.pose, window, _KERNEL_VOXELS, bounds)
    fit = _better(scene, guess, fit, found, guess.planar)
    for place in guess.misread if fit.score < BEYOND_DOUBT else ():
        around = Bounds.around(place, scene.config)
        found = scene.search(place, window, _KERNEL_VOXELS, around)
        support = scene.support(found.planar)
        refuted = support.score >= SURE_SCORE and found.score >= fit.score + _REFUTES
        if support.share >= MOST and (refuted or support.score >= BEYOND_DOUBT):
            fit = _better(scene, guess, fit, found, Pose2.from_matrix(place))
    return fit


def _better(scene: Scene, guess: MotionGuess, fit: Fit, found: Fit, place: Pose2) -> Fit:
    """The better one of a result and of what a search around a place found.

    New walls that lie on old ones somewhere else do not outweigh trusted odometry. Where hardly any
    is new, a place that fits better by so much that odometry errs so does.
    """
    if scene.is_narrow and guess.expected.measured:
        best = found if _outweighs(scene, guess, found, fit, place) else fit
        return replace(best, refused=fit.refused + found.refused)
    if not (guess.agrees(fit) and guess.denies(found)):
        return fit.or_better(found)
    support = scene.support(fit.planar)
    if support.share < _NEARLY_ALL:
        kept = support.share >= ENOUGH and support.score >= FAIR_SCORE
    else:
        kept = not _outdoes(guess, found, fit, place)
    return replace(fit, refused=fit.refused + found.refused) if kept else fit.or_better(found)


def _outdoes(guess: MotionGuess, found: Fit, fit: Fit, place: Pose2) -> bool:
    """Whether walls fit so much better, as far from the place expected as they are found."""
    away = place.inverse() @ found.planar
    slacks = guess.reliance.slacks(guess.expected.motion, away)
    return found.score >= fit.score + _PER_SLACK * slacks


def _outweighs(
    scene: Scene, guess: MotionGuess, found: Fit, fit: Fit, place: Pose2, *, since: bool = False
) -> bool:
    """Whether walls say more for a result than odometry, which expects `place`, for another one.

    Odometry's motion is that from the sweep before, or `since` the last keyframe. A camera sees a
    few metres of wall, and these fit other walls, too: so what speaks for a result are the points
    that fit better, and not their share.
    """
    motion, own = guess.expected.motion, guess.planar
    if since:
        motion, own = guess.since, guess.by_motion
    far = guess.reliance.slacks(motion, place.inverse() @ found.planar)
    near = guess.reliance.slacks(motion, own.inverse() @ fit.planar)
    return scene.points_gained(fit.planar, found.planar) > _POINTS_PER_SLACK * (far - near)


def _is_far(guess: MotionGuess, fit: Fit) -> bool:
    """Whether an alignment ended farther from its guess than most do."""
    away = guess.planar.inverse() @ fit.planar
    return away.distance >= _DOUBT_M or abs(away.theta) >= _DOUBT_RAD


def _fused(scene: Scene, guess: MotionGuess, fit: Fit) -> Fit:
    """The pose that odometry and walls tell together, each weighed by how well it knows it.

    What a camera sees at once seldom fixes a pose in all directions, and turning it sees other
    walls: its errors add up along a wall and in turns, where wheels know more. Walls that object to
    the pose between them show that wheels slipped since the last keyframe: held to its motion from
    the sweep before alone, odometry could not mend what many small errors have added up to.
    """
    slack, away = guess.reliance.slack(guess.since), guess.by_motion.inverse() @ fit.planar
    sigmas = np.array([slack.along_m, slack.across_m, slack.turn_rad]) / SIGMAS
    sigmas[:2] = sigmas[:2].max()  # whatever way the robot went
    odometry = np.diag(sigmas**-2)
    walls = scene.weakest(fit.planar, known=True).fisher / _READING_M**2
    moved = guess.by_motion @ Pose2(*np.linalg.solve(walls + odometry, walls @ away).tolist())
    fused = replace(fit.moved_to(moved, scene.score(moved)), aligned=fit.planar)
    slipped = _outweighs(scene, guess, fit, fused, guess.by_motion, since=True)
    return fit if slipped else fused


def _slid(scene: Scene, guess: MotionGuess, fit: Fit) -> Fit:
    """The place nearest to odometry's, along the heading, that walls speak for as for `fit`."""
    here, by_motion = fit.planar, guess.by_motion
    forward = np.array([np.cos(here.theta), np.sin(here.theta)])
    behind = float(np.dot((by_motion.x - here.x, by_motion.y - here.y), forward))
    ranges = scene.view.planar.ranges
    closed = np.count_nonzero(np.isfinite(ranges)) >= _CLOSED_SHARE * len(ranges)
    if closed and abs(behind) < _SLIP_M:
        return fit
    along, _ = _carried_along(scene, guess, fit)
    # however little: in a corridor that ends beyond the range it adds up
    if along is not fit or abs(behind) < _SLIP_M:
        return along
    for share in _SHARES:
        place = here @ Pose2(share * behind, 0.0, 0.0)
        score = scene.score(place)
        alike = score >= fit.score - _ALIKE
        if not alike and fit.score < BEYOND_DOUBT:  # there may be new space
            alike = scene.gain(here, place) >= -_ALIKE
        if alike:
            return fit.moved_to(place, score)
    return fit


def _carried_along(scene: Scene, guess: MotionGuess, fit: Fit) -> tuple[Fit, FloatArray]:
    """A result that comes as far as the motion expected, along what the walls do not fix.

    There odometry counts wholly, and a motion carried on by how well it is known, unless walls
    object: else the robot seems to stand still. Also what `Located.loose` says.
    """
    here, measured = fit.planar, guess.expected.measured
    weakest = scene.weakest(fit.planar, known=not measured)
    share = float(weakest.open)
    if not (measured or scene.local.sensor.in_space):
        spread_m = guess.carried_slack_m / SIGMAS
        share = 1.0 / (1.0 + (spread_m / weakest.precision_m(_READING_M)) ** 2)
    if share < _LEAST_SHARE:
        return fit, np.zeros(2)
    heading = here.theta + weakest.heading
    way = np.array([math.cos(heading), math.sin(heading)])
    if scene.local.sensor.in_space:
        return fit, share * way
    away = np.array([guess.by_motion.x - here.x, guess.by_motion.y - here.y])
    x, y = (share * float(away @ way) * way).tolist()
    place = Pose2(here.x + x, here.y + y, here.theta)
    score = scene.score(place)
    if score < fit.score - _OBJECTS and scene.gain(here, place) < -_OBJECTS:
        return fit, np.zeros(2)
    return fit.moved_to(place, score), share * way


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The pose of a sweep and what is thought of it.

    A `lost` sweep is at its guess. `agrees`: the result agrees with the expected motion. `certain`:
    the walls alone prove it; `proven`: they do so for any motion. `founds`: it fits what was seen
    before well enough to be one map with it; `refutes`: it does not, where it could. `loose` is as
    of `Located`.
    """

    fit: Fit
    agrees: bool = True
    lost: bool = False
    certain: bool = False
    proven: bool = False
    founds: bool = False
    refutes: bool = False
    loose: FloatArray = field(default_factory=lambda: np.zeros(2))

    def levelled(self, share: float) -> Judgement:
        """The same with `share` of the roll and pitch taken back, heading and place kept.

        A lidar of few rings says little about its own tilt, whose drift would lift the robot off.
        """
        from scipy.spatial.transform import Rotation  # slow to load, and for 3D alone

        yaw, pitch, roll = Rotation.from_matrix(self.fit.pose[:3, :3]).as_euler("ZYX")
        level, kept = self.fit.pose.copy(), 1.0 - share
        level[:3, :3] = Rotation.from_euler("ZYX", [yaw, kept * pitch, kept * roll]).as_matrix()
        return replace(self, fit=replace(self.fit, pose=level))


def judge(located: Located, guess: MotionGuess, config: RegistrationConfig) -> Judgement:
    """What is thought of the pose found from a guess; a lost sweep is put back on it.

    What agrees with odometry is lost only if the walls that could be seen contradict it.
    """
    fit, support, measured = located.fit, located.support, guess.expected.measured
    if located.agrees and measured:
        lost = support.count >= config.min_points and support.score < _HOPELESS
    elif located.agrees:
        lost = fit.score < _HOPELESS
    else:
        needed = POOR_SCORE
        if located.searched:
            needed = SURE_SCORE if measured or located.wide_searched else FAIR_SCORE
        score = fit.score if measured or support.share < MOST else support.score
        lost = score < needed and not located.overrules
    certain = not lost and not located.unaligned and support.share >= MOST
    return Judgement(
        fit=replace(fit, pose=guess.pose) if lost else fit,
        agrees=located.agrees,
        lost=lost,
        loose=located.loose,
        certain=certain and support.score > GOOD_SCORE,
        proven=certain and support.score > _PROVES,
        refutes=lost or (support.share >= ENOUGH and support.score < FAIR_SCORE),
        founds=not lost and support.share >= ENOUGH and support.score >= FAIR_SCORE,
    )


class Founding:
    """Holds back the scans of a map that is not founded yet, at most `most` of them."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: list[PosedScan] = []
        self._refuted: tuple[PosedScan, ...] = ()
        self._restarts = False

    def refute(self) -> int:
        """The map of the scans held is given up: they are lost. Returns how many were not before.

        Where they restarted the map after a break, the next one does.
        """
        believed = sum(not scan.lost for scan in self._held)
        self._restarts = self._restarts or any(scan.restarted for scan in self._held)
        lost = (replace(scan, lost=True, restarted=False) for scan in self._held)
        self._refuted, self._held = (*self._refuted, *lost), []
        return believed

    def handed_on(self, scan: PosedScan, *, founded: bool) -> tuple[PosedScan, ...]:
        """The scans that are settled now that this one was registered, in their order."""
        if self._restarts and not scan.lost:
            scan, self._restarts = replace(scan, restarted=True), False
        self._held.append(scan)
        settled, self._refuted = self._refuted, ()
        if founded or len(self._held) >= self._most:
            settled = (*settled, *self.rest())
        return settled

    def rest(self) -> tuple[PosedScan, ...]:
        """The scans that are held, which no later one will settle."""
        held, self._held = tuple(self._held), []
        return held


def looked_through(walls: FloatArray, scan: PlanarScan, map_from_laser: Pose2) -> float:
    """Share in [0, 1] of the walls (N, 2) of a map that a scan looks through, of those in its view.

    Two neighbouring beams must end well behind a wall. A beam without a return says nothing.
    """
    seen = map_from_laser.inverse().apply(walls)
    first = float(scan.bearings[0])
    bearings = first + np.mod(np.arctan2(seen[:, 1], seen[:, 0]) - first, 2 * np.pi)
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, 0.0)
    after = np.searchsorted(scan.bearings, bearings)
    if scan.full_circle:
        between = after > 0
        after = after % len(ranges)
    else:
        between = (after > 0) & (after < len(ranges))
        after = np.minimum(after, len(ranges) - 1)
    reach = np.minimum(ranges[after - 1], ranges[after])
    in_view = between & (reach > 0.0)
    if not in_view.any():
        return 0.0
    through = np.hypot(seen[:, 0], seen[:, 1]) + _BEHIND_M < reach
    return float(np.count_nonzero(through & in_view) / np.count_nonzero(in_view))

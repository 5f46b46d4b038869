"""The places where the robot may be, weighed: each is moved by the robot's motion, matched with
walls, and carried on until one leads. Label, *unknown* and pose are read off them.

A pose is corrected by matches with walls as in an extended Kalman filter, in its information form.
Along a wall, where a match says nothing, the motion alone counts. What a match does not know is how
far all walls of a grid are off together: so neighbouring points count little, and the filter
forgets quickly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, inverse3, moved, product, wrap_angle
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.matching import refine
from specmap_cli.grids.score_field import Sample, ScoreField
from specmap_cli.recognition.features.virtual import WINDOW_M
from specmap_cli.recognition.localization.filtering import LEAP, SMALLEST, VIEW_M, VIEW_RAD, novelty
from specmap_cli.recognition.localization.walls import SAME, Fitted, MapWalls, View, is_near

# What the motion may be off by: between any two scans, after a metre, after a radian. Registration
# is better than that, but for slips of some centimetres, which are to be followed.
_STILL_M, _STILL_RAD = 0.01, 0.005
_DRIFT_M, _DRIFT_RAD, _TURN_RAD = 0.05, 0.05, 0.05
_INDEPENDENT = 0.1  # of the points: the others lie on the same walls of the same grid
_LEAST_MISS = 0.02  # mean square of what a field misses under points: cells are no finer
_LEAST_INFORMATION = 1e-3  # of a match, a square metre or radian: it is never singular
_SURPRISE = 7.81  # chi-square of three degrees of freedom: one in twenty is larger
_FOUND_M, _FOUND_RAD = 0.1, 0.05  # what a place is good to that a search found
_LOST_SCORE = 0.55  # a scan that fits walls worse has no pose
_MOST_POINTS = 180  # one every other degree: what a match costs grows with them

_LOOK_M, _LOOK_RAD = 0.2, 0.2  # motion between looks at walls while a place fits
_SEARCH = 1.0  # motion between searches while no place fits: all of a view is new
# Log likelihood of a place over another where all of a view is in front of walls there alone.
_FRONT_GAIN = 20.0
_HOPELESS = 8.0  # so much lighter than the heaviest: one in three thousand
_MOST = 8  # places followed at once: each costs a match a look
# Power of the filter's odds: it sums views that are nearly the same, and may be sure of a mistake
# for metres.
_TEMPER = 0.25
# Before any view, how likely the robot is elsewhere than at the places, against its being in the
# map: for a label, where a search missed it; for a pose, outside of the map, too.
_MISSED, _OUTSIDE = 0.1, 1.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """A pose and its covariance (3, 3) of x and y, metres, and of the angle, radians."""

    pose: Pose2
    covariance: FloatArray

    @classmethod
    def found(cls, pose: Pose2) -> Estimate:
        """A pose that a search found."""
        return cls(pose, np.diag(np.square([_FOUND_M, _FOUND_M, _FOUND_RAD])))

    def moved(self, motion: Pose2) -> Estimate:
        """After a motion in the robot's own frame."""
        pose = self.pose @ motion
        turned = np.eye(3)
        turned[0, 2], turned[1, 2] = self.pose.y - pose.y, pose.x - self.pose.x
        off = _STILL_M**2 + _DRIFT_M**2 * motion.distance
        angle = _STILL_RAD**2 + _DRIFT_RAD**2 * motion.distance + _TURN_RAD**2 * abs(motion.theta)
        carried = product(product(turned, self.covariance), turned.T)
        return Estimate(pose, carried + np.diag([off, off, angle]))

    def corrected(self, match: Pose2, information: FloatArray) -> Estimate:
        """With a match, of which the inverse (3, 3) of the covariance is known.

        One that lies where it was not to be expected is taken as if it were found just now.
        """
        before, off = self.covariance, self.off(match)
        spread = inverse3(before + inverse3(information))
        if float(off @ product(spread, off[:, None])[:, 0]) > _SURPRISE:
            before = Estimate.found(match).covariance
        covariance = inverse3(inverse3(before) + information)
        shift = product(product(covariance, information), off[:, None])
        x, y, turn = (np.array(self.pose) + shift[:, 0]).tolist()
        return Estimate(Pose2(x, y, wrap_angle(turn)), covariance)

    def off(self, other: Pose2) -> FloatArray:
        """(3,) what another pose differs by."""
        turn = wrap_angle(other.theta - self.pose.theta)
        return np.array([other.x - self.pose.x, other.y - self.pose.y, turn])


def information(field: ScoreField, points: FloatArray, pose: Pose2) -> FloatArray:
    """(3, 3) inverse of the covariance with which points (N, 2) on a field tell their pose.

    The normal matrix of Gauss-Newton over the mean square of what the field misses.
    """
    equations = Sample.of(field, np.ascontiguousarray(points.T), pose).equations()
    sums = product(equations, equations.T)
    miss = sums[3, 3] / max(1, len(points)) + _LEAST_MISS
    return np.asarray(_INDEPENDENT * sums[:3, :3] / miss + _LEAST_INFORMATION * np.eye(3))


@dataclass(frozen=True, slots=True)
class Place:
    """The robot is where `estimate` says, when its track is at `map_from_base`.

    `weight` is the log likelihood of all views against their being from elsewhere, `against` that
    of the last one; `score` in [0, 1] is how well the scan lies on walls.
    """

    estimate: Estimate
    map_from_base: Pose2
    weight: float
    against: float
    score: float = 0.0

    @property
    def fits(self) -> bool:
        """Whether the last view was more likely from here than from elsewhere."""
        return self.against < 0.0

    @property
    def has_pose(self) -> bool:
        """Whether the scan lies on walls there."""
        return self.score >= _LOST_SCORE

    def moved(self, map_from_base: Pose2) -> Place:
        """Where the motion since leads."""
        motion = self.map_from_base.inverse() @ map_from_base
        return replace(self, estimate=self.estimate.moved(motion), map_from_base=map_from_base)

    def seen(self, fitted: Fitted, share: float, least: float) -> Place:
        """After one more view, of which a `share` is new; all of it where it changes its mind.

        At the `least` share of the view stands in front of walls: so much is somebody anywhere.
        """
        share = share if fitted.fits == self.fits else 1.0
        return replace(
            self,
            weight=self.weight - share * (fitted.against + _FRONT_GAIN * (fitted.front - least)),
            against=fitted.against,
        )


class WeighedPlaces:
    """The places of a map where the robot may be, and the way since they were looked at."""

    def __init__(self, walls: MapWalls, ids: Sequence[int], config: LocalizationConfig) -> None:
        self.walls = walls
        self.ids = list(ids)
        self.config = config
        self.restart()

    def restart(self) -> None:
        """Forget every place: the next pose has nothing to do with the last one."""
        self.places: list[Place] = []
        self._owners: list[int] = []
        self._at: Pose2 | None = None
        self._looked: Pose2 | None = None
        self._new = 1.0  # the share of a view that is new since the last look
        self._driven, self._searched = 0.0, -math.inf  # motion, of one all is new
        self._scans, self._wait = 0, 1  # since the last search, and until one without motion
        self.front = 0.0  # share of the last view that is somebody, where one fits

    def see(self, posed: PosedScan, seen: PosedScan, belief: FloatArray) -> float | None:
        """Weigh all places by one more scan: log likelihood of unknown, None where nothing is told.

        Places count by their chances before it; `belief` (m,) are those of the submaps by the
        classifiers. What fits where the motion leads is looked at again only after some motion.
        While no place fits all of the map is searched, but not at every scan: that takes long.
        """
        here = posed.map_from_base
        self._scans += 1
        if posed.lost:
            return None
        self._driven += novelty(self._at, here) if self._at is not None else 0.0
        self._new = novelty(self._at, here, self._new)
        self._at = here
        fits = any(each.fits for each in self.places)
        # one that stands still looks at every scan: people pass
        left = moved(self._looked, here, VIEW_M, VIEW_RAD)
        if fits and left and not moved(self._looked, here, _LOOK_M, _LOOK_RAD):
            return None
        view = View.of(posed, seen)
        if view is None:
            return None
        self._looked = here
        share, self._new = min(1.0, self._new), 0.0
        led, there = self.chances(belief), [each.moved(here) for each in self.places]
        fitted = [self.walls.near(view, each.estimate.pose) for each in there]
        least = min((each.front for each in fitted), default=0.0)
        pairs = zip(there, fitted, strict=True)
        now = [self._matched(place, fit, view).seen(fit, share, least) for place, fit in pairs]
        self.front = max((each.front for each in fitted if each.fits), default=0.0)
        told, rest = float(led @ np.exp([-each.against for each in fitted])), 1.0 - float(led.sum())
        self._keep(now, belief)
        astray = not any(each.fits for each in self.places)
        if not self._is_due(fits and astray, belief):
            return None if astray else -math.log(told + rest)  # what fits elsewhere was not asked
        found = self.walls.anywhere(view)
        least, best = (min(map(attrgetter(name), found)) for name in ("front", "against"))
        new = [Place(Estimate.found(each.pose), here, 0.0, each.against) for each in found]
        born = [
            each.seen(fit, 1.0, least) for each, fit in zip(new, found, strict=True) if fit.fits
        ]
        self.front = max((each.front for each in found if each.fits), default=self.front)
        self._searched, self._scans = self._driven, 0
        self._wait = 1 if born else 2 * self._wait
        self._keep([*self.places, *born], belief)
        return -math.log(told + rest * math.exp(-best))

    def _matched(self, place: Place, fitted: Fitted, view: View) -> Place:
        """A place with the pose at which a view fits it; along a bare wall motion alone counts."""
        if not is_near(fitted.pose, place.estimate.pose, SAME):
            return replace(place, estimate=Estimate.found(fitted.pose))
        told = information(self.walls.field, view.own, fitted.pose)
        return replace(place, estimate=place.estimate.corrected(fitted.pose, told))

    def _is_due(self, at_once: bool, belief: FloatArray) -> bool:
        """Whether the map is to be searched: the sooner again if nothing fits."""
        fits = any(each.fits for each in self.places)
        if not fits:
            motion = self._driven - self._searched
            return at_once or motion >= _SEARCH or self._scans >= self._wait
        lead = self.chances(belief).max(initial=0.0) >= self.config.lead
        return not lead and self._driven - self._searched >= WINDOW_M

    def follow(self, posed: PosedScan, belief: FloatArray) -> Place | None:
        """The place that leads, with its pose at a scan; None where none does."""
        chances = self.chances(belief, _OUTSIDE)
        if posed.lost or not len(chances):
            return None
        best = int(chances.argmax())
        leader = self.places[best]
        lead, least = self.config.lead, min(each.against for each in self.places)
        doubted = leader.against > least or leader.against >= math.log(lead / (1.0 - lead))
        if chances[best] < lead or (doubted and not leader.fits):
            return None  # none leads, or the last view is from another place, or from elsewhere
        leader = leader.moved(posed.map_from_base)
        points = posed.base_from_laser.apply(evenly(posed.planar.hits(), _MOST_POINTS))
        match = refine(self.walls.field, points, leader.estimate.pose)
        leader = replace(leader, score=match.score)
        if leader.has_pose:
            told = information(self.walls.field, points, match.pose)
            leader = replace(leader, estimate=leader.estimate.corrected(match.pose, told))
        self.places[best] = leader
        return leader

    def _keep(self, places: Sequence[Place], belief: FloatArray) -> None:
        """Go on with the likeliest of some places that are not far behind, each of them once.

        No more is remembered in favour of a place than a leap away from it is unlikely.
        """
        most = -math.log(LEAP)
        over = max(0.0, max((each.weight for each in places), default=most) - most)
        lighter = [replace(each, weight=each.weight - over) for each in places]
        kept: list[Place] = []
        for each in sorted(lighter, key=attrgetter("weight"), reverse=True):
            if each.weight < max(kept[0].weight if kept else 0.0, 0.0) - _HOPELESS:
                break
            if not any(is_near(each.estimate.pose, h.estimate.pose, SAME) for h in kept):
                kept.append(each)
        self.places = kept
        self._owners = [self.walls.owner(each.estimate.pose) for each in kept]
        best = np.argsort(-self.chances(belief), kind="stable")[:_MOST].tolist()
        self.places = [kept[k] for k in best]
        self._owners = [self._owners[k] for k in best]

    def chances(self, belief: FloatArray, elsewhere: float = _MISSED) -> FloatArray:
        """(n,) probabilities of the places; what they lack to one is that of being elsewhere.

        Before any view that is `elsewhere` times as likely as that the robot is in the map.
        """
        tempered = np.array([max(chance, SMALLEST) ** _TEMPER for chance in belief.tolist()])
        prior = dict(zip(self.ids, (tempered / tempered.sum()).tolist(), strict=True))
        heavy = [
            math.exp(each.weight) * prior[owner]
            for each, owner in zip(self.places, self._owners, strict=True)
        ]
        return np.asarray(np.array(heavy) / (sum(heavy) + elsewhere), dtype=np.float64)

    def mixed(self, belief: FloatArray) -> FloatArray:
        """(m,) chances of the submaps: those of the places, and of the filter for all else."""
        chances = self.chances(belief)
        mixed = (1.0 - float(chances.sum())) * belief
        for owner, chance in zip(self._owners, chances.tolist(), strict=True):
            mixed[self.ids.index(owner)] += chance * float(belief.sum())
        return np.asarray(mixed)

"""The front end: each sweep guessed, located on the last keyframes, judged, and concluded.

Per sweep: guess the motion from odometry (or from the motion before), register coarse to fine, and
judge the result by how well the sweep's walls lie on the local map's. A doubtful result calls the
correlative search, a bad one a wider search; what fits nowhere is lost: it keeps the guess and does
not enter the map. After a run of lost sweeps the map starts afresh, joined to the old by a guess.
Where no wall is in sight, trusted odometry carries the robot on, as far as it can be followed.

Planar sweeps are points with z = 0; a 3D cloud is registered as a whole in space.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import Pose2, moved, product
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import weakest_direction
from specmap_cli.registration.aligner import SensorKind
from specmap_cli.registration.expected_motion import ExpectedMotion, MotionModel
from specmap_cli.registration.fixed_directions import fixed_directions
from specmap_cli.registration.founding import Founding, looked_through
from specmap_cli.registration.judgement import Verdict, judge
from specmap_cli.registration.local_map import LocalMap
from specmap_cli.registration.locating import locate
from specmap_cli.registration.methods import aligner_factory
from specmap_cli.registration.prospect import (
    Prospect,
    best_guess,
    reversed_guess,
    unturned_guess,
)
from specmap_cli.registration.reliance import Reliance
from specmap_cli.registration.scene import Fit, Scene
from specmap_cli.registration.sweep_view import SweepView, view_of
from specmap_cli.registration.tally import COUNTS, warnings_of
from specmap_cli.registration.track import Track

_KEYFRAME_M = 0.3  # motion between keyframes of the local map
_KEYFRAME_RAD = 0.25  # turn between keyframes of the local map
_LOST_LIMIT = 5  # lost scans in a row that end a local map
_REFUTING_SHARE = 0.5  # of a first sweep's walls that another one looks through: few can move


class FrontEnd:
    """Registers sweeps one after another. `counts` tells how it went, by the names of `COUNTS`.

    Raises UsageError for a registration method that does not exist.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self.config = config
        self.counts = dict.fromkeys(COUNTS, 0)
        self._make_aligner = aligner_factory(config.method)
        self._motion = MotionModel(config)
        self._map: LocalMap | None = None
        self._track = Track()
        self._founding = Founding(_LOST_LIMIT)

    @property
    def warnings(self) -> list[str]:
        """What went beyond a limit so far, a sentence a limit."""
        return warnings_of(self.counts, self.config)

    def take(self, sweep: Sweep) -> tuple[PosedScan, ...]:
        """The scans that are settled by one more sweep, in their order: mostly its own.

        The first scans of a map wait until another one fits them, `_LOST_LIMIT` of them at most.
        Those of a map that is given up are lost. Ask for the `rest` at the end of a log.
        """
        scan = self.register(sweep)
        return self._founding.handed_on(scan, founded=self._track.founded)

    def rest(self) -> tuple[PosedScan, ...]:
        """The scans that still wait to be settled."""
        return self._founding.rest()

    def register(self, sweep: Sweep) -> PosedScan:
        """The sweep with its pose in the map, de-skewed; every result is bounded.

        The first scans of a map are provisional, see `take`.
        """
        expected = self._motion.expect(sweep)
        view = view_of(sweep, expected, self.config)
        local = self._local_map(sweep)
        self._track = self._track.moved_on(expected.motion, measured=expected.measured)
        verdict = self._founder(self._judged(view, expected, local), view, local)
        in_space = sweep.cloud is not None
        if in_space and not verdict.lost:
            verdict = verdict.levelled(self.config.level_share)
        restarted = self._track.broken and not verdict.lost
        bridge = self._track.bridge if restarted else None
        blind = _is_blind(sweep, view)
        self._conclude(verdict, view, local, blind=blind)
        return PosedScan(
            index=sweep.index,
            stamp_ns=sweep.stamp_ns,
            map_from_base=verdict.fit.planar,
            planar=view.planar,
            base_from_laser=sweep.base_from_laser,
            score=verdict.fit.score,
            agrees=verdict.agrees,
            lost=verdict.lost,
            restarted=restarted,
            bridge=bridge,
            blind=blind,
            odom_from_base=sweep.odom_from_base,
            map_from_base_3d=verdict.fit.pose if in_space else None,
        )

    def _local_map(self, sweep: Sweep) -> LocalMap:
        """The local map, made for the sensor of the first sweep."""
        if self._map is None:
            sensor = SensorKind.of(sweep, self.config)
            self._map = LocalMap(self._make_aligner(self.config, sensor), sensor, self.config)
        return self._map

    def _judged(self, view: SweepView, expected: ExpectedMotion, local: LocalMap) -> Verdict:
        """Where the sweep was taken, and whether that can be believed."""
        self._count(odometry_jumps=expected.jumped, shortened_motions=expected.shortened)
        before = self._track.pose
        guess = product(before, expected.motion.matrix())
        if self._sees_little(view):
            self._count(few_points=1)
            carried = self._track.is_carried(self.config) and _has_looked(view)
            return Verdict(fit=Fit(pose=guess, score=0.0), lost=not carried)
        if not len(local):
            return Verdict(fit=Fit(pose=guess, score=1.0))  # a new map begins at the guess
        scene = Scene(view=view, local=local, config=self.config)
        track = self._track
        prospect = Prospect(
            guess=best_guess(scene, before, expected),
            expected=expected,
            by_motion=track.by_motion if expected.measured else track.carried_on,
            reliance=track.reliance,
            reverse=reversed_guess(before, expected),
            unturned=unturned_guess(before, expected),
        )
        located = locate(scene, prospect)
        verdict = judge(located, prospect.guess, self.config, measured=expected.measured)
        self._count(searched=located.searched, wide_searched=located.wide_searched)
        self._count(refused_alignments=located.fit.refused, walls_left_out=local.field.left_out > 0)
        return verdict

    def _founder(self, verdict: Verdict, view: SweepView, local: LocalMap) -> Verdict:
        """The verdict, unless the sweep refutes the first one of a map: then it begins a map."""
        if self._sees_little(view) or self._track.founded or not len(local):
            return verdict
        laser = verdict.fit.planar @ view.base_from_laser
        empty = looked_through(local.walls, view.planar, laser)
        if not verdict.refutes and empty <= _REFUTING_SHARE:
            return verdict
        local.clear()
        self._track = replace(self._track, keyframe=None)
        refuted = self._founding.refute()
        self._count(registered=-refuted, lost=refuted)
        return Verdict(fit=replace(verdict.fit, score=1.0))

    def _conclude(self, verdict: Verdict, view: SweepView, local: LocalMap, *, blind: bool) -> None:
        """Keep the pose, insert a keyframe when due, end the map after a run of lost sweeps."""
        fit, track = verdict.fit, self._track
        step = Pose2.from_matrix(track.pose).inverse() @ fit.planar
        self._motion.conclude(step, confirmed=verdict.proven)
        self._count(registered=not verdict.lost, lost=verdict.lost)
        lost_in_a_row = track.lost_in_a_row + 1 if verdict.lost else 0
        founded = track.founded or verdict.founds
        walls = not verdict.lost and not self._sees_little(view)
        if walls and not blind:
            track = track.with_steady(step)
        track = replace(track, pose=fit.pose, lost_in_a_row=lost_in_a_row, founded=founded)
        if lost_in_a_row == _LOST_LIMIT and len(local):
            local.clear()
            self._count(breaks=1)
            left = track.left if track.keyframe is None else track.keyframe
            track = replace(track, keyframe=None, left=left, broken=True, founded=False)
        due = moved(track.keyframe, fit.planar, _KEYFRAME_M, _KEYFRAME_RAD)
        if due and walls:
            local.insert(view, fit.pose)
            track = track.with_keyframe(fit.planar, self._reliance(track, verdict, view))
        self._track = track

    def _reliance(self, track: Track, verdict: Verdict, view: SweepView) -> Reliance:
        """What odometry is worth, the motion since the last keyframe included if it is certain."""
        if track.keyframe is None or not (track.measured and verdict.certain):
            return track.reliance
        motion = track.keyframe.inverse() @ track.by_motion
        away = track.by_motion.inverse() @ verdict.fit.planar
        fixed = fixed_directions(view.planar, view.base_from_laser, motion)
        return track.reliance.after(motion, away, fixed)

    def _sees_little(self, view: SweepView) -> bool:
        """Whether a sweep has too few walls to be registered."""
        return len(view.probe) < self.config.min_points

    def _count(self, **hits: int) -> None:
        """Add to the counts of these names."""
        for name, number in hits.items():
            self.counts[name] += number


def _has_looked(view: SweepView) -> bool:
    """Whether a sweep with few walls saw that there are none: most beams are valid."""
    invalid = int(np.count_nonzero(np.isnan(view.planar.ranges)))
    return 2 * invalid < len(view.planar.ranges)


def _is_blind(sweep: Sweep, view: SweepView) -> bool:
    """Whether neither odometry nor walls fix the place of a sweep along some direction."""
    if sweep.odom_from_base is not None:
        return False
    return weakest_direction(sweep.base_from_laser.apply(view.planar.hits())).open

"""The front end: each sweep guessed, located on the last keyframes, judged, and concluded.

Per sweep: guess the motion from odometry (or from the motion before), register coarse to fine, and
judge the result by how well the sweep's walls lie on the local map's. A doubtful result calls the
correlative search, a bad one a wider search; what fits nowhere is lost: it keeps the guess and does
not enter the map. After a run of lost sweeps the map starts afresh, joined to the old by a guess.

Planar sweeps are points with z = 0; a 3D cloud is registered as a whole in space.
"""

from __future__ import annotations

from dataclasses import replace

from specmap_cli.core.geometry import Pose2, product
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.core.tracks import moved
from specmap_cli.registration.aligner import SensorKind
from specmap_cli.registration.expected_motion import ExpectedMotion, MotionModel
from specmap_cli.registration.judgement import Verdict, judge
from specmap_cli.registration.local_map import LocalMap
from specmap_cli.registration.locating import best_guess, locate
from specmap_cli.registration.methods import aligner_factory
from specmap_cli.registration.scene import Fit, Scene
from specmap_cli.registration.sweep_view import SweepView, view_of
from specmap_cli.registration.tally import COUNTS, warnings_of
from specmap_cli.registration.track import Track


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

    @property
    def warnings(self) -> list[str]:
        """What went beyond a limit so far, a sentence a limit."""
        return warnings_of(self.counts, self.config)

    def register(self, sweep: Sweep) -> PosedScan:
        """The sweep with its pose in the map, de-skewed; every result is bounded."""
        expected = self._motion.expect(sweep)
        view = view_of(sweep, expected, self.config)
        local = self._local_map(sweep)
        self._track = replace(self._track, by_motion=self._track.by_motion @ expected.motion)
        verdict = self._judged(view, expected, local)
        in_space = sweep.cloud is not None
        if in_space and not verdict.lost:
            verdict = verdict.levelled(self.config.level_share)
        restarted = self._track.broken and not verdict.lost
        self._conclude(verdict, view, local)
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
        if len(view.probe) < self.config.min_points:
            self._count(few_points=1)
            return Verdict(fit=Fit(pose=guess, score=0.0), lost=True)
        if not len(local):
            return Verdict(fit=Fit(pose=guess, score=1.0))  # a new map begins at the guess
        scene = Scene(view=view, local=local, config=self.config)
        guess = best_guess(scene, before, expected)
        located = locate(scene, guess, expected, self._track.by_motion)
        verdict = judge(located, guess, expected, self.config)
        self._count(searched=located.searched, wide_searched=located.wide_searched)
        self._count(refused_alignments=located.fit.refused, walls_left_out=local.field.left_out > 0)
        self._count(long_steps=verdict.long, long_steps_lost=verdict.lost_by_length)
        return verdict

    def _conclude(self, verdict: Verdict, view: SweepView, local: LocalMap) -> None:
        """Keep the pose, insert a keyframe when due, end the map after a run of lost sweeps."""
        config, fit = self.config, verdict.fit
        self._motion.conclude(Pose2.from_matrix(self._track.pose).inverse() @ fit.planar)
        self._count(registered=not verdict.lost, lost=verdict.lost)
        lost_in_a_row = self._track.lost_in_a_row + 1 if verdict.lost else 0
        track = replace(self._track, pose=fit.pose, lost_in_a_row=lost_in_a_row)
        if lost_in_a_row == config.lost_limit and len(local):
            local.clear()
            self._count(breaks=1)
            track = replace(track, keyframe=None, broken=True)
        due = moved(track.keyframe, fit.planar, config.keyframe_m, config.keyframe_rad)
        if due and not verdict.lost:
            local.insert(view, fit.pose)
            track = replace(track, keyframe=fit.planar, by_motion=fit.planar, broken=False)
        self._track = track

    def _count(self, **hits: int) -> None:
        """Add to the counts of these names."""
        for name, number in hits.items():
            self.counts[name] += number

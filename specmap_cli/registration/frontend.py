"""The front end: each sweep guessed, located on the last keyframes, judged, and concluded.

Per sweep: guess the motion from odometry (or from the motion before), register coarse to fine, and
judge the result by how well the sweep's walls lie on the local map's. A doubtful result calls the
correlative search, a bad one a wider search; what fits nowhere is lost: it keeps the guess and does
not enter the map. After a run of lost sweeps the map starts afresh, joined to the old by a guess;
so it does after a hole in the log over which odometry may have erred farther than is searched.
Where no wall is in sight, trusted odometry carries the robot on, as far as it can be followed.

Planar sweeps are points with z = 0; a 3D cloud is registered as a whole in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, moved, product
from specmap_cli.core.odometry import SHARE_OF_DISTANCE, SIGMAS, UNMEASURED
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.core.text import counted
from specmap_cli.registration.aligner import SensorKind, aligner_factory
from specmap_cli.registration.guess import (
    SEARCH_RAD,
    UNKNOWN,
    ExpectedMotion,
    MotionGuess,
    MotionModel,
    Reliance,
    best_guess,
    fixed_directions,
)
from specmap_cli.registration.local_map import Fit, LocalMap, Scene
from specmap_cli.registration.sweep_view import SweepView, view_of
from specmap_cli.registration.trust import Founding, Judgement, judge, locate, looked_through

_KEYFRAME_M = 0.3  # motion between keyframes of the local map
_KEYFRAME_RAD = 0.25  # turn between keyframes of the local map
_LOST_LIMIT = 5  # lost scans in a row that end a local map
_REFUTING_SHARE = 0.5  # of a first sweep's walls that another one looks through: few can move
_CARRIED = 0.2  # share of a motion that was carried on by which it may be off
_GUESSED = 0.2  # share of a motion from which on it says little of the next: walls pull it back
_STEADY = 15  # latest motions that walls fixed: the last few before a bare corridor are too short

COUNTS: Mapping[str, str] = {
    "registered": "sweeps with a trusted pose",
    "lost": "sweeps that kept the guess",
    "searched": "sweeps that called for the correlative search",
    "wide_searched": "sweeps that called for the wide search, too",
    "breaks": "runs of lost sweeps, and holes, that ended a map",
    "odometry_jumps": "odometry increments too large to be a motion",
    "shortened_motions": "sweeps whose guess or de-skewing was held to what may be carried on",
    "few_points": "sweeps with fewer than min_points walls: lost, or placed by odometry alone",
    "refused_alignments": "alignments that moved or tilted farther than allowed",
    "walls_left_out": "sweeps scored on a field too small for all walls of the local map",
}

# Of a limit that something went beyond: what is counted, and what to say of so many.
_SENTENCES: Mapping[str, tuple[str, str]] = {
    "odometry_jumps": (
        "jump",
        "registration met {hits} of odometry beyond registration.odometry_jump_m and "
        "odometry_jump_mps: the motion before was carried on instead",
    ),
    "shortened_motions": (
        "scan",
        "registration carried the motion before on to {hits} only in part: raise "
        "registration.carried_forward_m, carried_sideways_m and carried_rad for a fast robot",
    ),
    "few_points": (
        "scan",
        "registration met {hits} with fewer than {limits.min_points} wall points "
        "(registration.min_points): they are placed by odometry that is trusted, or lost",
    ),
    "refused_alignments": (
        "alignment",
        "registration refused {hits} that ended farther from the guess, or tilted more, than "
        "registration.max_shift_m, max_shift_rad and max_tilt_rad allow",
    ),
}


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
        """What went beyond a limit so far, a sentence a limit with the settings that set it."""
        return [
            sentence.format(hits=counted(self.counts[name], noun), limits=self.config)
            for name, (noun, sentence) in _SENTENCES.items()
            if self.counts[name]
        ]

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
        view = view_of(sweep, expected.during, expected.interval_s, self.config)
        if self._map is None:  # made for the sensor of the first sweep
            config, planar = self.config, sweep.cloud is None
            sensor = SensorKind(
                in_space=not planar,
                voxel_m=config.voxel_m if planar else config.cloud_voxel_m,
                range_m=config.max_range_m if planar else config.cloud_range_m,
            )
            self._map = LocalMap(self._make_aligner(config, sensor), sensor, config)
        local, by_motion = self._map, self._track.by_motion @ expected.increment
        measured = self._track.measured and expected.measured
        self._track = track = replace(self._track, by_motion=by_motion, measured=measured)
        self.counts["odometry_jumps"] += expected.jumped
        self.counts["shortened_motions"] += expected.shortened
        moved_on = product(track.pose, expected.motion.matrix())
        sees_little = len(view.probe) < self.config.min_points
        if sees_little:
            self.counts["few_points"] += 1
            ranges = view.planar.ranges  # if most are valid, it saw that there are no walls
            valid = 2 * int(np.count_nonzero(np.isnan(ranges))) < len(ranges)
            carried = valid and track.is_carried(self.config)
            judgement = Judgement(fit=Fit(pose=moved_on, score=0.0), lost=not carried)
        elif not len(local):  # a new map begins at the guess
            judgement = Judgement(fit=Fit(pose=moved_on, score=1.0))
        else:
            judgement = self._judged(view, expected, local)
        in_space = sweep.cloud is not None
        if in_space and not judgement.lost:
            judgement = judgement.levelled(self.config.level_share)
        track = self._track
        restarted = track.broken and not judgement.lost
        self._conclude(judgement, view, local, walls=not sees_little)
        return PosedScan(
            index=sweep.index,
            stamp_ns=sweep.stamp_ns,
            map_from_base=judgement.fit.planar,
            planar=view.planar,
            base_from_laser=sweep.base_from_laser,
            score=judgement.fit.score,
            agrees=judgement.agrees,
            lost=judgement.lost,
            restarted=restarted,
            bridge=track.bridge(self.config) if restarted else None,
            guessed_m=self._track.guessed_m,
            odometry_slacks=track.reliance.limits if track.measured else UNMEASURED,
            odom_from_base=sweep.odom_from_base,
            map_from_base_3d=judgement.fit.pose if in_space else None,
        )

    def _judged(self, view: SweepView, expected: ExpectedMotion, local: LocalMap) -> Judgement:
        """Where the sweep was taken, and if that is believed; it may refute the first of a map."""
        scene, track = Scene(view=view, local=local, config=self.config), self._track
        guess = MotionGuess(
            pose=best_guess(scene, track.pose, expected),
            before=track.pose,
            expected=expected,
            by_motion=track.by_motion if expected.measured else track.carried_on,
            since=(track.keyframe or track.by_motion).inverse() @ track.by_motion,
            reliance=track.reliance,
        )
        located = locate(scene, guess)
        self.counts["searched"] += located.searched
        self.counts["wide_searched"] += located.wide_searched
        self.counts["refused_alignments"] += located.fit.refused
        self.counts["walls_left_out"] += local.field.left_out > 0
        judgement = judge(located, guess, self.config)
        if track.founded:
            if judgement.lost or judgement.certain or not guess.beyond_search:
                return judgement
            # what was seen before says too little of this place to hold it
            self.counts["breaks"] += 1
            local.clear()
            left = track.keyframe or track.left
            self._track = replace(track, keyframe=None, left=left, broken=True, founded=False)
            return Judgement(fit=replace(judgement.fit, score=1.0))
        laser = judgement.fit.planar @ view.base_from_laser
        empty = looked_through(local.walls, view.planar, laser)
        if not judgement.refutes and empty <= _REFUTING_SHARE:
            return judgement
        local.clear()
        self._track = replace(track, keyframe=None)
        refuted = self._founding.refute()
        self.counts["registered"] -= refuted
        self.counts["lost"] += refuted
        return Judgement(fit=replace(judgement.fit, score=1.0))

    def _conclude(
        self, judgement: Judgement, view: SweepView, local: LocalMap, *, walls: bool
    ) -> None:
        """Keep the pose, insert a keyframe when due if `walls` are seen, end a map that is lost."""
        fit, track = judgement.fit, self._track
        step = Pose2.from_matrix(track.pose).inverse() @ fit.planar
        self._motion.conclude(step, confirmed=judgement.proven)
        self.counts["lost" if judgement.lost else "registered"] += 1
        lost_in_a_row = track.lost_in_a_row + 1 if judgement.lost else 0
        founded = track.founded or judgement.founds
        if not judgement.lost:
            track = track.guessing(judgement, step if walls else None)
        track = replace(track, pose=fit.pose, lost_in_a_row=lost_in_a_row, founded=founded)
        if lost_in_a_row == _LOST_LIMIT and len(local):
            local.clear()
            self.counts["breaks"] += 1
            left = track.left if track.keyframe is None else track.keyframe
            track = replace(
                track, keyframe=None, left=left, broken=True, contradicted=walls, founded=False
            )
        due = moved(track.keyframe, fit.planar, _KEYFRAME_M, _KEYFRAME_RAD)
        if due and walls and not judgement.lost:
            local.insert(view, fit.pose)
            reliance = track.reliance
            if track.keyframe is not None and track.measured and judgement.certain:
                motion = track.keyframe.inverse() @ track.by_motion
                away = track.by_motion.inverse() @ fit.planar
                fixed = fixed_directions(view.planar, view.base_from_laser, motion)
                aligned = track.by_motion.inverse() @ (fit.aligned or fit.planar)
                reliance = reliance.after(motion, away, aligned, fixed)
            track = replace(
                track,
                keyframe=fit.planar,
                left=None,
                by_motion=fit.planar,
                measured=True,
                broken=False,
                contradicted=False,
                reliance=reliance,
            )
        self._track = track


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """The state of the front end between two sweeps.

    `pose` (4, 4) is that of the base in the map. `keyframe` is the pose of the last keyframe, None
    without a map; `by_motion` is the place that the expected motions alone lead to from there, all
    of them `measured` by odometry or not. `lost_in_a_row` sweeps were lost up to now; `broken` says
    that they ended the last map, whose last keyframe was at `left`, `contradicted` that their walls
    did not fit where odometry led. The map is `founded` when a second sweep agrees with its first.
    `steady` are the latest motions that walls fixed. What was guessed up to now, since walls do not
    fix it, may be off by `guessed_m`, in the map.
    """

    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    keyframe: Pose2 | None = None
    left: Pose2 | None = None
    by_motion: Pose2 = IDENTITY
    measured: bool = True
    lost_in_a_row: int = 0
    broken: bool = False
    contradicted: bool = False
    founded: bool = False
    reliance: Reliance = UNKNOWN
    steady: tuple[Pose2, ...] = ()
    guessed_m: tuple[float, float] = (0.0, 0.0)

    @property
    def carried_on(self) -> Pose2:
        """The place after one more motion as most of the latest ones that walls fixed."""
        here = Pose2.from_matrix(self.pose)
        if not self.steady:
            return here
        x, y, _ = np.median(np.array(self.steady), axis=0).tolist()
        return here @ Pose2(x, y, 0.0)

    def guessing(self, judgement: Judgement, step: Pose2 | None) -> Track:
        """With what was guessed of one more motion, by a `step` that walls may have fixed."""
        loose, steady = judgement.loose, self.steady
        if step is not None and np.hypot(*loose) < _GUESSED:
            steady = (*steady, step)[-_STEADY:]
        way = (judgement.fit.pose - self.pose)[:2, 3]
        share = _CARRIED
        if self.measured:
            share = SHARE_OF_DISTANCE * self.reliance.limits.along_m / SIGMAS
        x, y = (self.guessed_m + share * float(loose @ way) * loose).tolist()
        return replace(self, steady=steady, guessed_m=(x, y))

    def bridge(self, config: RegistrationConfig) -> tuple[float, float] | None:
        """Standard deviations of odometry across a break, metres and radians; None without it.

        Where walls contradict it, it says no more than where they were searched for in vain.
        """
        if self.left is None or not self.measured:
            return None
        slack = self.reliance.slack(self.left.inverse() @ self.by_motion)
        place_m, turn_rad = slack.place_m, slack.turn_rad
        if self.contradicted:
            place_m = max(place_m, config.max_shift_m)
            turn_rad = max(turn_rad, SEARCH_RAD)
        return place_m / SIGMAS, turn_rad / SIGMAS

    def is_carried(self, config: RegistrationConfig) -> bool:
        """Whether odometry alone tells the place well enough to go on with it.

        Since the last keyframe of a founded map it measured every motion, and what it has been
        worth leaves it no farther off than a result may be from its guess.
        """
        if self.keyframe is None or not (self.founded and self.measured and self.reliance.trusted):
            return False
        slack = self.reliance.slack(self.keyframe.inverse() @ self.by_motion)
        return slack.place_m <= config.max_shift_m and slack.turn_rad <= config.max_shift_rad

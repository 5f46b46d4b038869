"""The front end: KISS-ICP's registration on a window of keyframes, guided, checked and bounded.

Per sweep: guess the motion from odometry (or from the motion before), register coarse to fine, and
judge the result by how well the sweep's walls lie on the local map's. A doubtful result calls the
correlative search, a bad one a wider search; what fits nowhere is lost: it keeps the guess and does
not enter the map. After a run of lost sweeps the map starts afresh, joined to the old by a guess.

The registration is that of Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP" (RA-L 2023).
Planar sweeps are points with z = 0; a 3D cloud is registered as a whole in space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from kiss_icp.registration import Registration

from specmap_cli.core.config import RegistrationConfig
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan, Sweep
from specmap_cli.grids.matching import Window, search, thinned
from specmap_cli.registration.deskew import deskewed, moved_returns
from specmap_cli.registration.judgement import (
    BETTER,
    GOOD,
    HOPELESS,
    POOR,
    SAME,
    SLIP_M,
    agrees,
    bounded,
    levelled,
    needed_score,
)
from specmap_cli.registration.localmap import LocalMap
from specmap_cli.registration.motion import MotionModel, Step
from specmap_cli.registration.points import thinned_to

_KERNELS = (2.0, 1.0, 0.5, 0.25)  # in voxels, coarse to fine
_COARSE = 0.5  # kernels above this many voxels need neither all points nor full convergence


@dataclass(frozen=True, slots=True)
class _View:
    """What one sweep offers, de-skewed and in the base frame.

    `cloud` (N, 3) is registered, `sparse` (K, 3) is enough for its coarse steps; `walls` (M, 2) go
    into the score field and `probe` (L, 2) is scored on it; `planar` is the scan to hand on.
    """

    planar: PlanarScan
    cloud: FloatArray
    sparse: FloatArray
    walls: FloatArray
    probe: FloatArray


@dataclass(frozen=True, slots=True)
class _Fit:
    """A pose (4, 4) of the base in the map and its score in [0, 1]."""

    pose: FloatArray
    score: float

    @property
    def planar(self) -> Pose2:
        return Pose2.from_matrix(self.pose)


class FrontEnd:
    """Registers sweeps one after another. `counts` tells how it went.

    registered: sweeps with a trusted pose; lost: sweeps that kept the guess; searched and
    wide_searched: calls of the correlative search; breaks: runs of lost sweeps that ended a map;
    odometry_jumps: odometry increments too large to be a motion.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self.config = config
        self.counts = dict.fromkeys(
            ("registered", "lost", "searched", "wide_searched", "breaks", "odometry_jumps"), 0
        )
        self._icp = Registration(config.iterations, 1e-4, max_num_threads=1)
        self._rough = Registration(config.iterations, 1e-3, max_num_threads=1)
        self._motion = MotionModel()
        self._map: LocalMap | None = None
        self._pose = np.eye(4)
        self._keyframe: Pose2 | None = None
        self._by_odometry = IDENTITY  # place by the motion expected since the last keyframe
        self._lost_in_a_row = 0
        self._broken = False

    def register(self, sweep: Sweep) -> PosedScan:
        """The sweep with its pose in the map, de-skewed; every result is bounded."""
        step = self._motion.predict(sweep)
        self.counts["odometry_jumps"] += step.jumped
        view = self._view(sweep, step)
        guess = self._pose @ step.motion.matrix()
        self._by_odometry = self._by_odometry @ step.motion
        local = self._local_map(sweep)
        restarted = False
        if len(view.probe) < self.config.min_points:
            fit, lost, agreed = _Fit(guess, 0.0), True, True
        elif not len(local):
            fit, lost, agreed = _Fit(guess, 1.0), False, True
            restarted, self._broken = self._broken, False
            local.insert(view.cloud, view.walls, guess)
            self._keyframe = self._by_odometry = fit.planar
        else:
            guess = self._better_guess(view, guess, local, step)
            fit, doubted = self._locate(view, guess, local, step)
            if not doubted and step.measured:
                fit = self._slid(view, fit, local)
            agreed = agrees(Pose2.from_matrix(guess), fit.planar, step)
            lost = not agreed and fit.score < needed_score(doubted, step.measured)
            lost |= fit.score < HOPELESS
        if lost:
            fit = _Fit(guess, fit.score)
        elif sweep.cloud is not None:
            fit = _Fit(levelled(fit.pose, self.config.level_share), fit.score)
        self._conclude(fit, lost, view, local)
        return PosedScan(
            sweep.index,
            sweep.stamp_ns,
            fit.planar,
            view.planar,
            sweep.base_from_laser,
            fit.score,
            agreed,
            lost,
            restarted,
            fit.pose if sweep.cloud is not None else None,
        )

    def _view(self, sweep: Sweep, step: Step) -> _View:
        """The points of a sweep, de-skewed and thinned, in the base frame."""
        config = self.config
        reach = min(config.max_range_m, 0.999 * sweep.planar.range_max)
        scan = deskewed(sweep.planar, sweep.base_from_laser, step.during, step.interval_s)
        near = np.where(scan.ranges > config.min_range_m, scan.ranges, np.nan)
        hit = np.isfinite(near) & (near <= reach)
        r, b = near[hit], scan.bearings[hit]
        hits = sweep.base_from_laser.apply(np.column_stack([r * np.cos(b), r * np.sin(b)]))
        walls = thinned_to(hits, config.voxel_m / 2, config.max_points)
        probe = thinned(walls, config.voxel_m)
        if sweep.cloud is None:
            return _View(scan, _in_space(walls), _in_space(probe), walls, probe)
        cloud = moved_returns(sweep.cloud, sweep.cloud_times_s, step.during, step.interval_s)
        distance = np.sqrt((cloud[:, :2] ** 2).sum(axis=1))
        cloud = cloud[(distance > config.min_range_m) & (distance <= config.cloud_range_m)]
        cloud = thinned(cloud, config.cloud_voxel_m)
        return _View(scan, cloud, thinned(cloud, 2 * config.cloud_voxel_m), walls, probe)

    def _local_map(self, sweep: Sweep) -> LocalMap:
        """The local map, made for the sensor of the first sweep."""
        if self._map is None:
            config = self.config
            voxel = config.voxel_m if sweep.cloud is None else config.cloud_voxel_m
            reach = config.max_range_m if sweep.cloud is None else config.cloud_range_m
            self._map = LocalMap(config.window_keyframes, voxel, reach, config.voxel_m / 2)
        return self._map

    def _better_guess(
        self, view: _View, guess: FloatArray, local: LocalMap, step: Step
    ) -> FloatArray:
        """The motion before carried on, where odometry puts the sweep visibly off the walls.

        Stamps of wheels and laser may be apart: in turns odometry is then off by many degrees.
        """
        if not step.measured:
            return guess
        other = self._pose @ self._motion.carried_on().matrix()
        by_odometry, by_motion = (
            local.field.score(view.probe, Pose2.from_matrix(pose)) for pose in (guess, other)
        )
        return other if by_motion > by_odometry + self.config.guess_margin else guess

    def _locate(
        self, view: _View, guess: FloatArray, local: LocalMap, step: Step
    ) -> tuple[_Fit, bool]:
        """The best pose found from a guess, and whether a search was called for."""
        fit = self._align(view, guess, local, _KERNELS)
        away = Pose2.from_matrix(guess).inverse() @ fit.planar
        doubted = fit.score <= GOOD or away.distance >= 0.15 or abs(away.theta) >= 0.1
        if doubted:
            self.counts["searched"] += 1
            window = (
                Window(0.25, 0.35, 0.05, None, 1.0, 0.4)
                if step.measured
                else Window(0.3, 0.5, 0.05, None, 1.0, 0.4)
            )
            fit = self._search(view, guess, local, window, _KERNELS, fit)
        if fit.score < POOR:
            self.counts["wide_searched"] += 1
            window = Window(1.0, 1.6, 0.1, None, 0.15, 0.05)
            fit = self._search(view, guess, local, window, (4.0, *_KERNELS), fit)
        return fit, doubted

    def _slid(self, view: _View, fit: _Fit, local: LocalMap) -> _Fit:
        """The place nearest the one by odometry that the walls speak for as well as for `fit`.

        Along a bare corridor all places score alike and registration stays behind, a little at
        every sweep: how far the robot came since the last keyframe is believed from odometry, as
        long as the score does not object. Heading and offset from the walls stay those of `fit`.
        """
        here, there = fit.planar, self._by_odometry
        forward = np.array([np.cos(here.theta), np.sin(here.theta)])
        behind = float(np.dot((there.x - here.x, there.y - here.y), forward))
        if abs(behind) < SLIP_M:
            return fit
        for share in (1.0, 0.75, 0.5, 0.25):
            place = here @ Pose2(share * behind, 0.0, 0.0)
            score = local.field.score(view.probe, place)
            if score >= fit.score - SAME:
                return _Fit((place @ here.inverse()).matrix() @ fit.pose, score)
        return fit

    def _search(
        self,
        view: _View,
        guess: FloatArray,
        local: LocalMap,
        window: Window,
        kernels: tuple[float, ...],
        fit: _Fit,
    ) -> _Fit:
        """The result of a correlative search when it is better than `fit`, else `fit`."""
        planar = Pose2.from_matrix(guess)
        found = search(local.field, view.probe, planar, window).pose
        lifted = (found @ planar.inverse()).matrix() @ guess
        other = self._align(view, lifted, local, kernels)
        return other if other.score > fit.score + BETTER else fit

    def _align(
        self, view: _View, guess: FloatArray, local: LocalMap, kernels: tuple[float, ...]
    ) -> _Fit:
        """KISS-ICP from a guess with shrinking kernels (in voxels); the guess when it runs off."""
        pose = guess
        for kernel in kernels:
            width = kernel * local.voxel_m
            coarse = kernel > _COARSE
            icp, cloud = (self._rough, view.sparse) if coarse else (self._icp, view.cloud)
            found = icp.align_points_to_map(cloud, local.voxels, pose, 3.0 * width, width)
            if not bounded(guess, found):
                break
            pose = found
        return _Fit(pose, local.field.score(view.probe, Pose2.from_matrix(pose)))

    def _conclude(self, fit: _Fit, lost: bool, view: _View, local: LocalMap) -> None:
        """Keep the pose, insert a keyframe when due, start afresh after a run of lost sweeps."""
        self._motion.conclude(Pose2.from_matrix(self._pose).inverse() @ fit.planar)
        self._pose = fit.pose
        self.counts["lost" if lost else "registered"] += 1
        self._lost_in_a_row = self._lost_in_a_row + 1 if lost else 0
        if lost:
            if self._lost_in_a_row == self.config.lost_limit and len(local):
                local.clear()
                self._keyframe, self._broken = None, True
                self.counts["breaks"] += 1
            return
        if self._keyframe is not None:
            moved = self._keyframe.inverse() @ fit.planar
            config = self.config
            near = moved.distance <= config.keyframe_m and abs(moved.theta) <= config.keyframe_rad
            if near:
                return
        local.insert(view.cloud, view.walls, fit.pose)
        self._keyframe = self._by_odometry = fit.planar


def _in_space(points: FloatArray) -> FloatArray:
    """Points (N, 2) of the plane as (N, 3) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])

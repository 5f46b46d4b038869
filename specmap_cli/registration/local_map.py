"""The local map: what the last keyframes saw, and how well a sweep fits it somewhere.

The registration method holds their points in its own form. Beside it stand the score field of the
same walls in the plane, which scores results and serves the correlative search, and the space that
the keyframes have looked at: a wall of a new sweep that lies elsewhere is new, and says nothing
against the place of the sweep.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, product
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.grids.matching import Weakest, Window, search, weakest_direction
from specmap_cli.grids.score_field import FieldArray, PointCells, ScoreField, approach
from specmap_cli.registration.aligner import (
    REBUILD_KEYFRAMES,
    WINDOW_KEYFRAMES,
    Aligner,
    SensorKind,
)
from specmap_cli.registration.sweep_view import SweepView, outline_of

_FIELD_RANGES = 2.0  # side of the score field, in ranges; walls beyond score 0

# Of the score field, in spacings of the walls' points: cells that leave no gap between them, and a
# sigma of one voxel. Finer fields cost time and tell right from wrong results no better.
_CELL_SPACINGS, _SIGMA_SPACINGS = 1.5, 2.0
_SEEN_SPACINGS = 4.0  # cells of the space looked at: two voxels, as wide as a wall scores at all

# Kernels tried first, those above half a voxel for 3D clouds alone; all of them follow only if
# their result is in doubt.
QUICK_KERNEL_VOXELS = (1.5, 0.25)
_NARROW_RAD = math.radians(170.0)  # lasers that see half a circle end a beam or two before it
_FEW_RAD = 0.5  # of walls in sight: half of what the narrowest depth cameras span
_COARSE_VOXELS = 0.5  # kernels wider than this need neither all points nor full convergence
_CLEARLY_BETTER = 0.02  # score that a search must gain: as much as scores of one place vary


def seen_space(outlines: Sequence[FloatArray], cell_m: float, side_m: float) -> GridMap:
    """The space inside of outlines (N, 2), in one frame, and a cell around it; else UNKNOWN.

    It ends `side_m` to each side of the first outline's first point, a laser.
    """
    low = outlines[0][0] - side_m
    side = math.ceil(2 * side_m / cell_m)
    seen = np.zeros((side, side), dtype=np.uint8)
    for outline in outlines:
        cv2.fillPoly(seen, [np.floor((outline - low) / cell_m).astype(np.int32)], 1)
    grown = cv2.dilate(seen, np.ones((3, 3), dtype=np.uint8))
    cells = np.where(grown > 0, FREE, UNKNOWN).astype(np.uint8)
    return GridMap(cells, cell_m, (float(low[0]), float(low[1])))


class LocalMap:
    """The last `WINDOW_KEYFRAMES` keyframes, in the map frame.

    The score field forgets older ones when the registration method rebuilds its voxels; until then
    new walls are drawn into it.
    """

    def __init__(self, aligner: Aligner, sensor: SensorKind, config: RegistrationConfig) -> None:
        self.aligner, self.sensor = aligner, sensor
        self._spacing_m = config.voxel_m / 2
        self._sigma_m = _SIGMA_SPACINGS * self._spacing_m
        self._inserted = 0
        self._side_m = _FIELD_RANGES * sensor.range_m
        self._walls: deque[FloatArray] = deque(maxlen=WINDOW_KEYFRAMES)
        self._outlines: deque[FloatArray] = deque(maxlen=WINDOW_KEYFRAMES)
        self._cells: deque[PointCells] = deque(maxlen=WINDOW_KEYFRAMES)  # of the walls
        self._field: ScoreField | None = None
        self._seen: GridMap | None = None

    def __len__(self) -> int:
        return len(self._walls)

    def clear(self) -> None:
        """Forget everything."""
        self.aligner.clear()
        self._walls.clear()
        self._cells.clear()
        self._outlines.clear()
        self._field = self._seen = None
        self._inserted = 0

    def insert(self, view: SweepView, map_from_base: FloatArray) -> None:
        """Add a keyframe seen from a pose (4, 4)."""
        self.aligner.insert(view.dense, map_from_base)
        planar = Pose2.from_matrix(map_from_base)
        walls = planar.apply(view.walls)
        self._walls.appendleft(walls)
        cells = PointCells.of(walls, _CELL_SPACINGS * self._spacing_m)
        self._cells.appendleft(cells)
        self._outlines.appendleft(
            planar.apply(outline_of(view.planar, view.base_from_laser, view.reach_m))
        )
        rebuilt = self._inserted % REBUILD_KEYFRAMES == 0
        field = None if rebuilt else self._field
        self._field = None if field is None else field.with_cells(cells, self._sigma_m)
        self._seen = None
        self._inserted += 1

    @property
    def walls(self) -> FloatArray:
        """The walls (N, 2) of all keyframes, those of the last one first."""
        return np.concatenate(self._walls)

    @property
    def field(self) -> ScoreField:
        """The score field of the walls, built when first asked for.

        Walls too far from the last keyframe for a field of `_FIELD_RANGES` are left out.
        """
        if self._field is None:
            x, y = self._outlines[0][0].tolist()  # the last laser
            self._field = ScoreField.from_cells(self._cells, self._sigma_m, self._side_m, (x, y))
        return self._field

    @property
    def seen(self) -> GridMap:
        """The space that the keyframes have looked at is free; made when first asked for."""
        if self._seen is None:
            cell_m = _SEEN_SPACINGS * self._spacing_m
            self._seen = seen_space(self._outlines, cell_m, self._side_m / 2)
        return self._seen


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A pose (4, 4) of the base in the map, the same in the plane, and its score in [0, 1].

    `refused` alignments on the way to it ran off and were not followed. `aligned` is where walls
    alone put it, None where it is there.
    """

    pose: FloatArray
    score: float
    refused: int = 0
    aligned: Pose2 | None = None
    planar: Pose2 = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "planar", Pose2.from_matrix(self.pose))

    def moved_to(self, place: Pose2, score: float) -> Fit:
        """The fit at another place of the plane, height and tilt kept, with its score there."""
        pose = product((place @ self.planar.inverse()).matrix(), self.pose)
        return Fit(pose=pose, score=score, refused=self.refused)

    def or_better(self, other: Fit) -> Fit:
        """The other fit when it is clearly better, else this one; refusals of both count."""
        best = other if other.score > self.score + _CLEARLY_BETTER else self
        return replace(best, refused=self.refused + other.refused)


@dataclass(frozen=True, slots=True)
class Support:
    """What the walls say of a place that could be seen there: new space says nothing.

    `score` in [0, 1] is the mean over the points that fall where the local map has looked, `share`
    of all of them, `count` in number. Without any the score is 0.
    """

    score: float
    share: float
    count: int


@dataclass(frozen=True, slots=True)
class Bounds:
    """How far a pose may end from `guess` (4, 4), which is where odometry or motion put it."""

    guess: FloatArray
    shift_m: float
    shift_rad: float
    tilt_rad: float

    @classmethod
    def around(cls, guess: FloatArray, config: RegistrationConfig) -> Bounds:
        """The bounds that the settings promise for every result."""
        return cls(guess, config.max_shift_m, config.max_shift_rad, config.max_tilt_rad)

    def hold(self, found: FloatArray) -> bool:
        """Whether a pose (4, 4) is finite, upright and no farther from the guess than allowed."""
        if not np.isfinite(found).all():
            return False
        trace = float((self.guess[:3, :3] * found[:3, :3]).sum())  # of the turn between the two
        turn = math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0)))
        upright = float(found[2, 2]) > np.cos(self.tilt_rad)
        shift_m = math.dist(self.guess[:3, 3].tolist(), found[:3, 3].tolist())
        return shift_m <= self.shift_m and turn <= self.shift_rad and upright


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """One sweep and the local map that it is registered on."""

    view: SweepView
    local: LocalMap
    config: RegistrationConfig

    @property
    def is_narrow(self) -> bool:
        """Whether the sweep is planar, and shows no more walls than one of a depth camera.

        It spans less than half a circle, or few of its beams return.
        """
        if self.local.sensor.in_space:
            return False
        planar = self.view.planar
        spanned = float(np.ptp(planar.bearings))
        returned = float(np.isfinite(planar.ranges).mean())
        return spanned < _NARROW_RAD or spanned * returned < _FEW_RAD

    def score(self, place: Pose2) -> float:
        """How well, in [0, 1], the sweep's walls lie on the map's when the base is at a place."""
        return self.local.field.score(self.view.probe, place)

    def support(self, place: Pose2) -> Support:
        """How well the walls that could be seen lie on the map's when the base is at a place."""
        placed = place.apply(self.view.probe)
        seen = self.local.seen.values_at(placed) == FREE
        count = int(np.count_nonzero(seen))
        if not count:
            return Support(score=0.0, share=0.0, count=0)
        score = float(self.local.field.at(placed[seen]).mean())
        return Support(score=score, share=count / len(placed), count=count)

    def gain(self, place: Pose2, other: Pose2) -> float:
        """The score that `other` has more than `place`, over points that both could have seen.

        It is 0 where there are none of them.
        """
        before, after = self._compared(place, other)
        return float(after.mean() - before.mean()) if len(after) else 0.0

    def points_gained(self, place: Pose2, other: Pose2) -> float:
        """The same in points: how many more of them lie on walls."""
        before, after = self._compared(place, other)
        return float(after.sum() - before.sum())

    def _compared(self, place: Pose2, other: Pose2) -> tuple[FieldArray, FieldArray]:
        """(N,) and (N,) what the points that both could have seen score at either."""
        here, there = (pose.apply(self.view.probe) for pose in (place, other))
        seen, walls = self.local.seen, self.local.field
        both = (seen.values_at(here) == FREE) & (seen.values_at(there) == FREE)
        return walls.at(here[both]), walls.at(there[both])

    def weakest(self, place: Pose2, *, known: bool) -> Weakest:
        """How well walls, or the `known` ones alone, fix a place where they do so least.

        Walls that are new at the place say nothing of it. The heading is of the base's frame.
        """
        view = self.view
        if not known:
            return weakest_direction(view.base_from_laser.apply(view.planar.hits()))
        hits = view.base_from_laser.apply(view.planar.hits(view.reach_m))
        return weakest_direction(hits, self.local.field.at(place.apply(hits)).astype(np.float64))

    def align(
        self, start: FloatArray, kernels: Sequence[float], bounds: Bounds | None = None
    ) -> Fit:
        """The registration method from a pose (4, 4), with one kernel (in voxels) after another.

        A result out of bounds, by default those of the settings around `start`, is refused: the
        one before it stands, at first the start.
        """
        pose, refused = start, 0
        bounds = bounds or Bounds.around(start, self.config)
        for kernel in kernels:
            coarse = kernel > _COARSE_VOXELS
            points = self.view.sparse if coarse else self.view.cloud
            width_m = kernel * self.local.sensor.voxel_m
            found = self.local.aligner.align(points, pose, width_m, coarse=coarse)
            if not bounds.hold(found):
                refused = 1
                break
            pose = found
        return Fit(pose=pose, score=self.score(Pose2.from_matrix(pose)), refused=refused)

    def align_quickly(self, guess: FloatArray, bounds: Bounds) -> Fit:
        """The registration method from near by: by few kernels, in the plane by the narrow ones.

        Its steps shorten by a share each, those on the score field much faster: so in the plane
        these lead to where the narrow kernels begin.
        """
        kernels = QUICK_KERNEL_VOXELS
        if self.local.sensor.in_space:
            return self.align(guess, kernels, bounds)
        planar, sigma_m = Pose2.from_matrix(guess), self.local.sensor.voxel_m
        near = approach(self.local.field, self.view.probe, planar, sigma_m)
        start = product((near @ planar.inverse()).matrix(), guess)
        return self.align(start, [k for k in kernels if k <= _COARSE_VOXELS], bounds)

    def search(
        self,
        guess: FloatArray,
        window: Window,
        kernels: Sequence[float],
        bounds: Bounds | None = None,
    ) -> Fit:
        """The result of a correlative search around a guess (4, 4), aligned within bounds."""
        planar = Pose2.from_matrix(guess)
        found = search(self.local.field, self.view.probe, planar, window).pose
        return self.align(product((found @ planar.inverse()).matrix(), guess), kernels, bounds)

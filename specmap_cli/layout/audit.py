"""The audit: do the passes of the robot through one place agree on its walls?

The path is cut into passes of some metres, each with a small grid of its own. Where two passes saw
the same place, the walls of one must not stand in the space that the other proved free. What moves
(people, chairs, doors) is short; a wall that is drawn twice is long.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, moved, travelled
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.grids.matching import Window, refine, search
from specmap_cli.grids.score_field import ScoreField

_CELL_M = 0.1  # cells in which passes are compared
_RANGE_M = 30.0  # farther returns are not compared
_PASS_M = 6.0  # path of one pass: its own drift is small
_NEAR_M = 6.0  # passes this near to each other are compared
_APART_M = 12.0  # passes with so much path between them may have drifted apart
_PASSES_COMPARED = 8  # the nearest passes that each pass is compared with
_DEPTH_M = 0.2  # a wall this deep in free space contradicts; less is noise
_WALL_M = 1.2  # shorter walls may be doors, people or chairs
# Share of the walls that both passes saw when they disagree; where no small motion brings them
# together half of them: otherwise the building has changed, and the map is right.
_DISAGREEING_SHARE = 0.15
_SEARCH_M = 3.0  # walls drawn twice are at most so far apart
_KEYFRAME_M, _KEYFRAME_RAD = 0.3, 0.25  # between the keyframes of a pass: they see nearly the same
_STEP_M, _REFINE_STEPS = 0.2, 10  # of the search for how far two walls stand apart
_TURN_RAD = 0.1  # of that search: passes are turned little against each other
_SIGMA_M = 0.15  # of its field: a cell and a half
# Share of the walls known to both passes that must agree at the place found, and by how much more
# than before: people and things moved between the passes leave some that do not.
_LEAST, _LEAD = 0.75, 0.1


@dataclass(frozen=True)
class Pass:
    """A piece of the path and what was seen from it: keyframes `first` to `last`.

    `grid` is in the map frame. `centre` (2,) is the mean place of the robot, `way_m` the path
    driven before it.
    """

    first: int
    last: int
    centre: FloatArray
    way_m: float
    grid: GridMap

    @cached_property
    def walls(self) -> FloatArray:
        """(N, 2) the middles of the cells with a wall."""
        return self.grid.centres_of(np.argwhere(self.grid.cells == OCCUPIED))

    @cached_property
    def says(self) -> GridMap:
        """Space that is free well clear of anything else, walls with what is near, or nothing."""
        reach = max(1, round(_DEPTH_M / self.grid.resolution))
        kernel = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
        free = (self.grid.cells == FREE).astype(np.uint8)
        said = np.full(free.shape, UNKNOWN, dtype=np.uint8)
        said[cv2.erode(free, kernel, borderValue=0) > 0] = FREE
        said[cv2.dilate((self.grid.cells == OCCUPIED).astype(np.uint8), kernel) > 0] = OCCUPIED
        return replace(self.grid, cells=said)


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """Two passes that cannot both be right: walls of one stand in free space of the other.

    `earlier` and `later` are keyframes in the middle of each. `walls_m` of wall, the `share` of all
    that can be compared, are contradicted, around `place`. `offset` moves the later pass to where
    its walls lie on those of the earlier one, in the map frame; None when no small motion does.
    """

    earlier: int
    later: int
    place: tuple[float, float]
    walls_m: float
    share: float
    offset: Pose2 | None

    @property
    def apart_m(self) -> float | None:
        """How far apart the walls stand."""
        if self.offset is None:
            return None
        x, y = self.place
        moved_to = self.offset.apply(np.array([[x, y]]))[0]
        return float(np.hypot(moved_to[0] - x, moved_to[1] - y))


@dataclass(frozen=True, slots=True, kw_only=True)
class Audit:
    """How many pairs of passes through one place were compared, and those that disagree."""

    compared: int = 0
    disagreements: tuple[Disagreement, ...] = ()

    @property
    def walls_m(self) -> float:
        """Metres of wall that are contradicted, over all pairs."""
        return sum(one.walls_m for one in self.disagreements)

    @property
    def share(self) -> float:
        """Of the pairs that were compared, those that disagree."""
        return len(self.disagreements) / max(1, self.compared)


def audit(store: KeyframeStore, poses: FloatArray, breaks: Collection[int]) -> Audit:
    """Compare all passes through the same places, keyframes being at poses (n, 3)."""
    found, compared = [], 0
    for earlier, later in pairs_of(passes_of(store, poses, breaks)):
        shared, standing = 0, []
        for one, other in ((earlier, later), (later, earlier)):
            said = other.says.values_at(one.walls)
            shared += int(np.count_nonzero(said != UNKNOWN))
            standing.append(_long(one.walls[said == FREE]))
        compared += shared > 0
        contradicted = np.concatenate(standing)
        walls_m = len(contradicted) * _CELL_M
        if walls_m < _WALL_M or walls_m < _DISAGREEING_SHARE * shared * _CELL_M:
            continue
        offset = _offset(earlier, later)
        if offset is None and 2 * len(contradicted) < shared:
            continue
        x, y = np.median(contradicted, axis=0).tolist()
        disagreement = Disagreement(
            earlier=(earlier.first + earlier.last) // 2,
            later=(later.first + later.last) // 2,
            place=(x, y),
            walls_m=walls_m,
            share=len(contradicted) / shared,
            offset=offset,
        )
        found.append(disagreement)
    return Audit(compared=compared, disagreements=tuple(found))


def passes_of(store: KeyframeStore, poses: FloatArray, breaks: Collection[int]) -> list[Pass]:
    """The path cut into passes of `_PASS_M`, and where the tracking was lost."""
    coarse = GridConfig(resolution_m=_CELL_M, max_range_m=_RANGE_M)
    way = travelled(poses)
    passes: list[Pass] = []
    first, chosen, before = 0, list[int](), None
    for number, pose in enumerate(Pose2(*row) for row in poses.tolist()):
        if moved(before, pose, _KEYFRAME_M, _KEYFRAME_RAD):
            chosen.append(number)
            before = pose
        after = number + 1
        ended = after == len(poses) or after in breaks
        if not ended and way[after] - way[first] < _PASS_M:
            continue
        grid = integrate_keyframes(store, chosen, poses[chosen], coarse).snapshot()
        one = Pass(
            first=first,
            last=number,
            centre=poses[first:after, :2].mean(axis=0),
            way_m=float(way[first]),
            grid=grid.cropped(),  # hundreds of them are kept
        )
        passes.append(one)
        first, chosen, before = after, [], None
    return passes


def pairs_of(passes: Sequence[Pass]) -> Iterator[tuple[Pass, Pass]]:
    """Each pass with the nearest earlier ones, from where much of the same can be seen."""
    centres = np.array([one.centre for one in passes])
    for number, later in enumerate(passes):
        away = np.hypot(*(centres[:number] - later.centre).T)
        for k in np.argsort(away, kind="stable")[:_PASSES_COMPARED].tolist():
            earlier = passes[k]
            if away[k] <= _NEAR_M and later.way_m - earlier.way_m >= _APART_M:
                yield earlier, later


def _long(points: FloatArray) -> FloatArray:
    """Those of the cells (N, 2) that stand in a row at least as long as `_WALL_M`."""
    if not len(points):
        return points
    cells = np.floor((points - points.min(axis=0)) / _CELL_M + 0.5).astype(np.intp)
    picture = np.zeros(cells.max(axis=0) + 1, dtype=np.uint8)
    picture[cells[:, 0], cells[:, 1]] = 1
    joined = cv2.dilate(picture, np.ones((3, 3), dtype=np.uint8))  # over gaps of a cell or two
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    sides = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]] - 2  # the dilation's rim
    long = np.hypot(*sides.T) * _CELL_M >= _WALL_M
    long[0] = False  # the background
    kept: NDArray[np.bool_] = long[pieces[cells[:, 0], cells[:, 1]]]
    return points[kept]


def _offset(earlier: Pass, later: Pass) -> Pose2 | None:
    """The motion of the map that brings the later pass onto the earlier one, if one does clearly.

    Walls beyond what the earlier pass saw say nothing, wherever they are moved.
    """
    seen = later.walls[np.hypot(*(later.walls - earlier.centre).T) <= _RANGE_M]
    if not len(seen):
        return None
    field = ScoreField.from_points(earlier.walls, _CELL_M, _SIGMA_M)
    x, y = later.centre.tolist()
    centre = Pose2(x, y, 0.0)
    points = seen - later.centre
    window = Window(distance_m=_SEARCH_M, angle_rad=_TURN_RAD, step_m=_STEP_M)
    rough = search(field, points, centre, window)
    best = refine(field, points, rough.pose, _REFINE_STEPS)
    shares = []  # of the walls that the earlier pass knows, those that lie by its own
    for pose in (centre, best.pose):
        said = earlier.says.values_at(pose.apply(points))
        known = int(np.count_nonzero(said != UNKNOWN))
        shares.append(float(np.count_nonzero(said == OCCUPIED)) / known if known else 0.0)
    if shares[1] < max(_LEAST, shares[0] + _LEAD):
        return None
    return best.pose @ centre.inverse()

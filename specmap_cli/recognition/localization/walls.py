"""How well a view fits the walls of a map: where motion leads, and anywhere.

A return on a wall speaks for a place, one behind a wall against it: the map has a wall on the way
there, which is gone or elsewhere. A return in space that the map saw empty is somebody, or a thing
that was moved, and one in space that the map never saw is new: either says little.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from operator import attrgetter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, travelled, wrap_angle
from specmap_cli.core.records import NO_SUBMAP, BoolArray, IntArray, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap, LengthArray, cast_rays, nearest_values
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import refine, search_everywhere
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.learning.calibration import (
    FIT_RANGE_M,
    HeldOutMisfit,
    near_returns,
    pooled,
)

SAME = 0.3, 0.1  # two places so near are one, metres and radians
BESIDE = 1.0, 0.3  # much the same is seen at places so near
_LEAST_POINTS = 10  # fewer fit anywhere
_OFF = 0.9  # a return that much off is two decimetres from walls: not by noise
_FRONT_WEIGHT = 0.1  # of a return in space that the map saw empty: somebody, or a moved thing
_BODY_M, _GAP_M = 1.2, 0.5  # such things are no wider; two returns on one are no farther apart
_UNSEEN_WEIGHT = 0.25  # of a return where the map saw nothing
_LATE_MOST = 0.08  # what the way so far says at the most against a place where the scan alone fits
_MOST_RAYS = 120  # of a scan, one every three degrees all round: what is cast costs grows with them
# What the pose of a match and the cells of a grid leave open, in heading and sideways. Along a wall
# that moves the end of a ray by metres: so a ray may reach as far as any that passes so near.
_SLANT_RAD, _SIDE_M = math.radians(3.0), 0.15
_SCANS_AT_ONCE = 64  # whose rays are cast together: few take nearly as long as many
_OWN_M = 1.0  # of way between two of the map's own scans that are asked what they look through
_BEHIND_M = 0.3  # farther than a match is off, and than a wall is thick in a grid
# Misfits of other places where they fit best, on average, and their standard deviation.
_FOREIGN_MISFIT, _FOREIGN_MISFIT_SPREAD = 0.3, 0.12
_FIT_MOST = 4.0  # log likelihood that walls give at the most
# By how much the place that fits best is better than the next one, on average: of scans from
# elsewhere, which fit by chance, and of the map's own.
_FOREIGN_GAP, _OWN_GAP = 0.06, 0.15
# Of the search, coarse: what it finds within 0.3 m and a few degrees is mended by the refinement.
_STEP_M, _TRIED, _PLACES = 0.25, 8, 8
_ALL_ROUND = np.arange(0.0, 2.0 * math.pi, math.radians(5.0)).tolist()


def is_near(one: Pose2, other: Pose2, reach: tuple[float, float]) -> bool:
    """Whether two poses are within reach of each other, in metres and radians."""
    off = math.hypot(one.x - other.x, one.y - other.y)
    return off < reach[0] and abs(wrap_angle(one.theta - other.theta)) < reach[1]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is matched of a scan: `points` (N, 2) of all that was seen, `own` (N, 2) of it alone.

    Both are in the base frame, as far as `FIT_RANGE_M`.
    """

    posed: PosedScan
    points: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, posed: PosedScan, seen: PosedScan) -> View | None:
        """The view of a scan, with all that was `seen` of late; None if it shows too little."""
        points = own = posed.base_from_laser.apply(near_returns(posed.planar, FIT_RANGE_M))
        if seen is not posed:
            then = posed.map_from_base.inverse() @ seen.map_from_laser
            points = then.apply(near_returns(seen.planar, FIT_RANGE_M))
        return None if posed.lost or len(points) < _LEAST_POINTS else cls(posed, points, own)


@dataclass(frozen=True, slots=True)
class Fitted:
    """A pose in the map where a view may be from, its misfit in [0, 1], and what walls say there.

    `against` is the log likelihood of unknown over known. Below nought, the view fits. `front` is
    the share of returns that are somebody, or a moved thing: of two places the one with fewer is
    the likelier.
    """

    pose: Pose2
    misfit: float
    against: float
    front: float = 0.0

    @property
    def fits(self) -> bool:
        """Whether the place is more likely than none of the map."""
        return self.against < 0.0


class MapWalls:
    """The walls of a map, `grid`, and which submap each cell is of: `owner` (H, W), or NO_SUBMAP.

    `misfit` is how well the map's own scans fit its walls; `own` gives these scans, at their poses
    in the map, when it is first asked what they look through.
    """

    def __init__(
        self,
        grid: GridMap,
        owner: NDArray[Any],
        misfit: HeldOutMisfit | None,
        config: LocalizationConfig,
        own: Callable[[], Iterable[PosedScan]] = tuple,
    ) -> None:
        self.grid = grid
        self._owner = owner
        self._known = pooled(misfit, config)
        self._own = own

    @cached_property
    def field(self) -> ScoreField:
        """How near walls are."""
        return ScoreField.from_grid(self.grid)

    @cached_property
    def _distances(self) -> LengthArray:
        """(H, W) metres to the nearest wall."""
        return self.grid.obstacle_distance()

    @cached_property
    def _open(self) -> NDArray[Any]:
        """(H, W) the share of the own scans' rays at a wall that go on: panes and railings."""
        met = np.zeros((2, *self.grid.cells.shape), dtype=np.float32)  # all rays; those that go on
        scans = iter(self._own())
        while together := list(islice(scans, _SCANS_AT_ONCE)):
            past, cells, walled = self._met([(scan, scan.map_from_base) for scan in together])
            for counts, some in zip(met, (walled, past), strict=True):
                np.add.at(counts, tuple(cells[some].T), 1.0)
        side = 2 * round(_SIDE_M / self.grid.resolution) + 1
        rays, past = (cv2.boxFilter(each, -1, (side, side), normalize=False) for each in met)
        return np.asarray(past / (rays + np.float32(1.0)))  # one more that a wall stops

    @cached_property
    def _owners(self) -> NDArray[Any]:
        """(H, W) the submap of each cell, of the nearest that is of one where it is of none."""
        return nearest_values(self._owner.astype(np.int32) - NO_SUBMAP)[0] + NO_SUBMAP

    def owner(self, pose: Pose2) -> int:
        """The submap that a place belongs to."""
        row, column = self.grid.cells_of(np.array([[pose.x, pose.y]]))[0].tolist()
        height, width = self._owners.shape
        return int(self._owners[min(max(row, 0), height - 1), min(max(column, 0), width - 1)])

    def near(self, view: View, guess: Pose2) -> Fitted:
        """The place near a guess, where the scan fits best, and how well it fits with all around.

        All that was seen of late tells places apart that a narrow scan takes for one; the scan
        alone, where people walk along or the track slipped.
        """
        pose = refine(self.field, view.points, guess).pose
        off, front = self._off_walls(view.points, pose)
        if view.own is not view.points and len(view.own) >= _LEAST_POINTS:
            poses = [refine(self.field, view.own, start).pose for start in (pose, guess)]
            told = [self._off_walls(view.own, each) for each in poses]
            k = int(told[1][0] < told[0][0])
            pose, (alone, front) = poses[k], told[k]
            late = self._off_walls(view.points, pose)[0]
            off = min(0.5 * (alone + late), alone + _LATE_MOST)
        misfit = min(1.0, off + self._behind(view.posed, pose))
        # Misfits in known places are exponential, of the mean that the map's own views had; in
        # others, where they fit best, normal. What fits worse than those is no more of them for it.
        off = (min(misfit, _FOREIGN_MISFIT) - _FOREIGN_MISFIT) / _FOREIGN_MISFIT_SPREAD
        unknown = -0.5 * off**2 - math.log(_FOREIGN_MISFIT_SPREAD * math.sqrt(2.0 * math.pi))
        known = -misfit / self._known - math.log(self._known)
        return Fitted(pose, misfit, min(max(unknown - known, -_FIT_MOST), _FIT_MOST), front)

    def anywhere(self, view: View) -> list[Fitted]:
        """The places of the map where a view fits best, the best first; at least one.

        The best by the field alone may be wrong: it does not know where the map saw nothing.
        """
        found = list[Fitted]()
        # where the track slipped all that was seen of late fits nowhere
        for points in (view.points, view.own) if len(view.own) >= _LEAST_POINTS else (view.points,):
            matches = search_everywhere(self.field, points, _TRIED, _STEP_M, _ALL_ROUND)
            refined = [refine(self.field, points, each.pose) for each in matches]
            best = sorted(refined, key=attrgetter("score"), reverse=True)[:_PLACES]
            found += [self.near(view, match.pose) for match in best] or [self.near(view, IDENTITY)]
            if view.own is view.points or any(each.fits for each in found):
                break
        return self._weighed(sorted(found, key=attrgetter("misfit")))

    def _weighed(self, found: Sequence[Fitted]) -> list[Fitted]:
        """Places that a search found, the best the better if it stands out among them.

        What fits by chance fits nearly as well in several places; alike places say nothing.
        """
        best = found[0]
        others = [each.misfit for each in found if not is_near(best.pose, each.pose, BESIDE)]
        if best.fits or not others:
            return list(found)
        gap = others[0] - best.misfit
        elsewhere = -gap / _FOREIGN_GAP - math.log(_FOREIGN_GAP)
        own = -gap / _OWN_GAP - math.log(_OWN_GAP)
        against = max(-_FIT_MOST, best.against + min(0.0, elsewhere - own))
        return [replace(best, against=against), *found[1:]]

    def _off_walls(self, points: FloatArray, pose: Pose2) -> tuple[float, float]:
        """Shares of points (N, 2) off the walls, and on bodies; some count little."""
        placed = pose.apply(points)
        off = 1.0 - np.asarray(self.field.at(placed), dtype=np.float64)
        cells, clear = self.grid.values_at(placed), off > _OFF
        front = clear & (cells == FREE)
        # a thing in front of walls, its points in order of bearing, that is as long as a wall
        steps = np.hypot(*np.diff(placed, axis=0).T)
        goes_on = front[1:] & front[:-1] & (steps < _GAP_M)
        first = np.flatnonzero(np.concatenate([[True], ~goes_on]))
        last = np.append(first[1:], len(placed)) - 1
        width = np.hypot(*(placed[last] - placed[first]).T)
        front &= ~np.repeat(width > _BODY_M, last - first + 1)
        off[front] *= _FRONT_WEIGHT
        off[clear & (cells == UNKNOWN)] *= _UNSEEN_WEIGHT
        return float(np.mean(off)), float(np.mean(front))

    def _behind(self, posed: PosedScan, pose: Pose2) -> float:
        """Share of returns behind walls, beyond what the own scans had there; 0 without returns."""
        past, cells, walled = self._met([(posed, pose)])
        behind = float(past.sum()) / max(len(past), 1)
        if behind > self._known:  # so many are rare, but where there are panes
            behind -= float(self._open[tuple(cells[walled].T)].sum()) / len(past)
        return max(0.0, behind)

    def _met(
        self, scans: Sequence[tuple[PosedScan, Pose2]]
    ) -> tuple[BoolArray, IntArray, BoolArray]:
        """Which returns (n,) of scans at poses lie behind a wall, its cells (n, 2), which met one.

        A wall counts when the rays beside it meet walls, too: one that ends there may be passed.
        """
        rays = []  # bearings and ranges of the returns of each scan, few of many
        for posed, _ in scans:
            bearings, ranges = posed.planar.bearings, posed.planar.ranges
            returned = evenly(np.flatnonzero(np.isfinite(ranges)), _MOST_RAYS)
            rays.append((bearings[returned], ranges[returned]))
        lasers = [pose @ posed.base_from_laser for posed, pose in scans]
        counts = [len(bearings) for bearings, _ in rays]
        origins = np.repeat([(laser.x, laser.y) for laser in lasers], counts, axis=0)
        angles = np.concatenate(
            [own + laser.theta for (own, _), laser in zip(rays, lasers, strict=True)]
        )
        measured = np.concatenate([ranges for _, ranges in rays])
        ranges = cast_rays(self._distances, self.grid, origins, angles, FIT_RANGE_M)
        around = np.maximum(_SLANT_RAD, _SIDE_M / np.maximum(ranges, self.grid.resolution))
        beside, start = [], 0  # of each ray, those of its scan from one up to another
        for own, _ in rays:
            near = around[start : start + len(own)]
            ends = np.searchsorted(own, own - near), np.searchsorted(own, own + near, side="right")
            beside.append(start + np.column_stack(ends))
            start += len(own)
        # up to the one behind the last, which is none
        pairs = np.concatenate(beside).ravel()
        farthest = np.maximum.reduceat(np.append(ranges, 0.0), pairs)[::2]
        within = np.minimum(ranges, FIT_RANGE_M) + 0.5 * self.grid.resolution
        stops = origins + within[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        cells = self.grid.cells_of(stops)
        walled = np.isfinite(ranges) & self.grid.inside(cells)
        walled &= measured > ranges - _BEHIND_M  # not those that somebody stopped before
        return (measured > farthest + _BEHIND_M) & walled, cells, walled


def along_way(poses: FloatArray) -> IntArray:
    """Numbers of the keyframes of a map every metre of its way, by their `poses` (n, 3) in it."""
    return np.unique(np.floor(travelled(poses) / _OWN_M), return_index=True)[1]


def placed(store: KeyframeStore, numbers: Iterable[int], poses: FloatArray) -> Iterator[PosedScan]:
    """Some keyframes of a map at their `poses` (n, 3) in it."""
    for k, pose in zip(numbers, poses.tolist(), strict=True):
        yield replace(store.posed(k), map_from_base=Pose2(*pose))

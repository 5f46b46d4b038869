"""A closure told more precisely: by the walls around the two keyframes that it ties.

Grids of whole submaps match to their cells, and a path that drifts within a submap bends its grid.
What was seen within a few metres of either keyframe is not bent, and not drawn on cells: first one
place as a whole is laid on the other, then scans of both are laid on each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import thinned
from specmap_cli.layout.line_fitting import on_lines, onto_lines
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.wall_matching import LOOP_SCORE, MATCH_POINTS
from specmap_cli.layout.walls import CELL_M

_PLACE_M = 2.5  # of path on either side of a keyframe: its walls make one place
_SCANS = 8  # of a place that are laid on each other, beside that of its keyframe
_BASIN_M, _BASIN_RAD = 0.3, 0.06  # the grids were compared that near: what lies beyond was not
_SPREAD = (_BASIN_M / 2, _BASIN_RAD / 2)  # the guess lies in there with two standard deviations


@dataclass(frozen=True, slots=True)
class Place:
    """What was seen around a keyframe on one pass.

    `scans` are points (N, 2) on walls, each in the base frame of its keyframe; `poses` (n, 3) of
    these in the frame of the `own`-th, which is that keyframe.
    """

    scans: tuple[FloatArray, ...]
    poses: FloatArray
    own: int

    @property
    def walls(self) -> FloatArray:
        """Points (N, 2) on the walls, one in a cell."""
        seen = [
            Pose2(*pose.tolist()).apply(points)
            for points, pose in zip(self.scans, self.poses, strict=True)
        ]
        return thinned(np.concatenate(seen), CELL_M)

    def of_few(self, most: int) -> Place:
        """The same of its own keyframe and at most `most` others, evenly spread."""
        others = np.delete(np.arange(len(self.scans)), self.own)
        few = np.sort(np.append(evenly(others, most), self.own))
        scans = tuple(thinned(self.scans[k], CELL_M) for k in few.tolist())
        return Place(scans, self.poses[few], int(np.searchsorted(few, self.own)))


def place_around(store: KeyframeStore, keyframes: Sequence[int], k: int) -> Place:
    """What was seen near the k-th of some keyframes of one pass."""
    poses = store.poses_of(keyframes)
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    near = np.flatnonzero(np.abs(path - path[k]) <= _PLACE_M)
    scans = tuple(store.points(keyframes[i], MATCH_RANGE_M) for i in near.tolist())
    relative = compose(invert(poses[k]), poses[near])
    return Place(scans, relative, int(np.searchsorted(near, k)))


def sharpened(old: Place, new: Place, guess: Pose2) -> Pose2:
    """The pose of the keyframe of `new` seen from that of `old`, from a guess that was verified.

    Along a bare corridor the guess stays, across it the walls decide. Where these do not fit, or
    fit elsewhere, it stays as it is.
    """
    old, new = old.of_few(_SCANS), new.of_few(_SCANS)
    rough = onto_lines(new.walls, old.walls, guess, _SPREAD)
    if rough.share < LOOP_SCORE or rough.points < MATCH_POINTS:
        return guess
    fine = _together(old, new, rough.target_from_source)
    off = guess.inverse() @ fine
    return fine if off.distance <= _BASIN_M and abs(off.theta) <= _BASIN_RAD else guess


def _together(old: Place, new: Place, rough: Pose2) -> Pose2:
    """The same from a pose a few centimetres off, by the scans of both places on each other."""
    poses = np.concatenate([old.poses, compose(np.array(rough), new.poses)])
    placed = on_lines([*old.scans, *new.scans], poses)
    ends = placed[old.own], placed[len(old.poses) + new.own]
    return Pose2(*compose(invert(ends[0]), ends[1]).tolist())

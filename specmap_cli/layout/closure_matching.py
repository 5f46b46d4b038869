"""A closure told more precisely: by the walls around the two keyframes that it ties.

Grids of whole submaps match to their cells, and a path that drifts within a submap bends its grid.
What was seen within a few metres of either keyframe is not bent, and not drawn on cells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, inverse3, invert, product
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import thinned
from specmap_cli.layout.wall_matching import match_walls
from specmap_cli.layout.walls import CELL_M

_PLACE_M = 2.5  # of path on either side of a keyframe: its walls make one place
_BASIN_M, _BASIN_RAD = 0.3, 0.06  # the grids were compared that near: what lies beyond was not
# What the guess is worth beside the walls: it lies in there with two standard deviations.
_PRIOR = np.diag([4.0 / _BASIN_M**2, 4.0 / _BASIN_M**2, 4.0 / _BASIN_RAD**2])


def sharpened(old: FloatArray, new: FloatArray, guess: Pose2, config: RelaxationConfig) -> Pose2:
    """The pose of walls `new` (N, 2) among walls `old` (M, 2), from a guess that was verified.

    Along a bare corridor the guess stays, across it the walls decide. Where these do not fit, or
    fit elsewhere, it stays as it is.
    """
    fit = match_walls(new, old, guess, _BASIN_M, config)
    if fit is None:
        return guess
    off = guess.inverse() @ fit.target_from_source
    if off.distance > _BASIN_M or abs(off.theta) > _BASIN_RAD:
        return guess
    weight = product(inverse3(_PRIOR + fit.information), fit.information)
    moved = product(weight, np.array(off)[:, None])[:, 0]
    return guess @ Pose2(*moved.tolist())


def place_around(
    store: KeyframeStore, keyframes: Sequence[int], k: int, config: RelaxationConfig
) -> FloatArray:
    """Points (N, 2) on the walls seen near the k-th of some keyframes of one pass, in its frame."""
    poses = store.poses_of(keyframes)
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    near = np.flatnonzero(np.abs(path - path[k]) <= _PLACE_M)
    relative = compose(invert(poses[k]), poses[near])
    seen = [
        Pose2(*pose.tolist()).apply(store.points(keyframes[i], config.match_range_m))
        for i, pose in zip(near.tolist(), relative, strict=True)
    ]
    return thinned(np.concatenate(seen), CELL_M)

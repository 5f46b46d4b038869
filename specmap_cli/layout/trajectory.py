"""Poses between those that were relaxed: they follow the last of these, as they were tracked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import (
    FloatArray,
    compose,
    invert,
    runs,
    travelled,
    wrap_angle,
    wrap_angles,
)
from specmap_cli.core.records import BoolArray, IntArray, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore

_SAME = 2e-6  # metres and radians: text files have six decimals


def corrected(trajectory: Trajectory, store: KeyframeStore, poses: FloatArray) -> Trajectory:
    """The trajectory of every registered scan, moved with the keyframes to their poses (n, 3)."""
    rows = rows_of(trajectory, store.stamps_ns, store.poses)
    moved = propagated(trajectory.poses, rows, poses)
    if trajectory.lost is not None:
        moved = bridged(moved, trajectory.poses, trajectory.lost)
    return replace(trajectory, poses=moved)


def propagated(tracked: FloatArray, relaxed_rows: IntArray, relaxed: FloatArray) -> FloatArray:
    """Poses (n, 3), each moved with the last relaxed one: its new pose o the tracked motion since.

    `relaxed_rows` (m,) ascending rows of `tracked` (n, 3), `relaxed` (m, 3) their new poses. What
    lies before the first goes with that one; without any nothing moves.
    """
    if not len(relaxed_rows):
        return np.array(tracked)
    rows = np.arange(len(tracked))
    last = np.maximum(np.searchsorted(relaxed_rows, rows, side="right") - 1, 0)
    motion = compose(invert(tracked[relaxed_rows[last]]), tracked)
    return compose(relaxed[last], motion)


def propagated_places(places: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Places (m, 2) moved with the pose nearest to each, of those `before` (n, 3) to `after`."""
    nearest = cKDTree(before[:, :2]).query(places)[1]
    poses = np.column_stack([places, np.zeros(len(places))])
    moved = compose(after[nearest], compose(invert(before[nearest]), poses))
    return np.asarray(moved[:, :2])


def bridged(poses: FloatArray, tracked: FloatArray, lost: BoolArray) -> FloatArray:
    """Poses (n, 3) in which the guesses of lost scans lead from the scan before to the one after.

    `tracked` (n, 3) are the poses before any relaxing, `lost` (n,) marks the guesses. What a chain
    of guesses misses the next known pose by is spread over the way.
    """
    result = np.array(poses)
    for start, end in runs(lost):
        if not lost[start] or start == 0 or end == len(poses):
            continue
        motions = compose(invert(tracked[start - 1]), tracked[start : end + 1])
        guesses = compose(poses[start - 1], motions)
        way = travelled(tracked[start - 1 : end + 1])[1:]
        share = way / way[-1] if way[-1] > 0.0 else np.linspace(0.0, 1.0, len(way) + 1)[1:]
        missed = poses[end] - guesses[-1]
        missed[2] = wrap_angle(missed[2])
        guesses += share[:, None] * missed
        guesses[:, 2] = wrap_angles(guesses[:, 2])
        result[start:end] = guesses[:-1]
    return result


def rows_of(trajectory: Trajectory, stamps_ns: Sequence[int], poses: FloatArray) -> IntArray:
    """Rows of the trajectory that are some keyframes, by their stamps and poses (n, 3), in order.

    Stamps may repeat or step back, so that the two are walked together. Poses may differ by what
    text files round.
    """
    rows: list[int] = []
    ways = zip(trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True)
    wanted = list(zip(stamps_ns, poses.tolist(), strict=True))
    for row, (stamp, pose) in enumerate(ways):
        if len(rows) == len(wanted):
            break
        keyframe_stamp, keyframe = wanted[len(rows)]
        if stamp != keyframe_stamp:
            continue
        x, y, turn = (a - b for a, b in zip(pose, keyframe, strict=True))
        if max(abs(x), abs(y), abs(wrap_angle(turn))) <= _SAME:
            rows.append(row)
    return np.array(rows, dtype=np.int64)

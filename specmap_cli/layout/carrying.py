"""Poses between those that were relaxed: carried along by the last of these."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore


def carried(tracked: FloatArray, anchors: IntArray, relaxed: FloatArray) -> FloatArray:
    """Poses (n, 3) moved with their last anchor: its relaxed pose o the tracked motion since.

    `anchors` (m,) ascending rows of `tracked` (n, 3), `relaxed` (m, 3) their new poses. What lies
    before the first anchor goes with that one; without an anchor nothing moves.
    """
    if not len(anchors):
        return np.array(tracked)
    last = np.maximum(np.searchsorted(anchors, np.arange(len(tracked)), side="right") - 1, 0)
    motion = compose(invert(tracked[anchors[last]]), tracked)
    return compose(relaxed[last], motion)


def keyframe_rows(trajectory: Trajectory, store: KeyframeStore) -> IntArray:
    """Rows of the trajectory that are the store's keyframes, in order.

    Stamps may repeat or step back, so that the two are walked together.
    """
    stamps, tracked = store.stamps_ns, store.poses
    rows: list[int] = []
    for row, stamp in enumerate(trajectory.stamps_ns.tolist()):
        k = len(rows)
        if k == len(stamps):
            break
        if stamp == stamps[k] and np.array_equal(trajectory.poses[row], tracked[k]):
            rows.append(row)
    return np.array(rows, dtype=np.int64)

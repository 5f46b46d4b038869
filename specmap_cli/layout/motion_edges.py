"""Edges between successive nodes: the front end's motion, and how far it can be trusted.

The covariance of a step has two parts: noise in proportion to the motion, and what the walls in
sight leave undetermined, from their normals (Censi, "On achievable accuracy for range-finder
localization", ICRA 2007): along a bare corridor a scan fixes nothing.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.pose_graph import Link

# Error of a step of no length: registration ends within a fifth of a map cell of 5 cm, 3 m away.
_LEAST_M, _LEAST_RAD = 0.01, 0.003
_SURFACE_GAP_M = 0.3  # neighbouring points this close lie on one surface, as for the grids
_DISTINCT_M = 1e-6  # between points of which the direction of a surface can be had


def motion_links(
    store: KeyframeStore, nodes: IntArray, breaks: Collection[int], config: RelaxationConfig
) -> tuple[Link, ...]:
    """Links from each of the keyframes `nodes` (M,) to the next, as tracked.

    Those that end in one of `breaks`, where tracking started afresh, are loose: a guess.
    """
    poses = store.poses[nodes]
    motions = compose(invert(poses[:-1]), poses[1:])
    links = []
    for source, target, motion in zip(nodes[:-1].tolist(), nodes[1:], motions, strict=True):
        step, end = Pose2(*motion.tolist()), int(target)
        if end in breaks:
            information = guess_information(config)
        else:
            information = step_information(step, store.points(end, config.match_range_m), config)
        links.append(
            Link(
                source=source,
                target=end,
                source_from_target=step,
                information=information,
                kind="loose" if end in breaks else "odometry",
            )
        )
    return tuple(links)


def guess_information(config: RelaxationConfig) -> FloatArray:
    """Information (3, 3) of a motion that no wall in sight confirms."""
    return np.diag([config.guess_m**-2, config.guess_m**-2, config.guess_rad**-2])


def step_information(step: Pose2, points: FloatArray, config: RelaxationConfig) -> FloatArray:
    """Information (3, 3) of a motion `step`, weighed in the frame it ends in.

    `points` (N, 2) are the walls seen from its end.
    """
    position = _LEAST_M + config.step_share * step.distance
    angle = _LEAST_RAD + config.turn_share * abs(step.theta)
    moved = np.diag([position**2, position**2, angle**2])
    fisher = observability(points, config.range_noise_m)
    unseen = np.linalg.inv(fisher + guess_information(config))
    return np.asarray(np.linalg.inv(moved + unseen), dtype=np.float64)


def observability(points: FloatArray, range_noise_m: float) -> FloatArray:
    """Fisher information (3, 3) of a scan's own pose, from points (N, 2) in order of bearing.

    Sum of J^T J / sigma^2 with J = (n, p x n) for the surface normal n at p and the error sigma of
    a range. Points without a neighbour on either side within reach of one surface say nothing.
    """
    if len(points) < 3:
        return np.zeros((3, 3))
    tangent = points[2:] - points[:-2]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    good = (length > _DISTINCT_M) & (length < 2 * _SURFACE_GAP_M)
    tangent, p = tangent[good] / length[good, None], points[1:-1][good]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    rows = np.column_stack([normal, p[:, 0] * normal[:, 1] - p[:, 1] * normal[:, 0]])
    return np.asarray(rows.T @ rows / range_noise_m**2, dtype=np.float64)

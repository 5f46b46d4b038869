"""Edges between successive nodes: the front end's motion, and how far it can be trusted.

The covariance of a step has two parts: noise in proportion to the motion, and what the walls in
sight leave undetermined, from their normals (Censi, "On achievable accuracy for range-finder
localization", ICRA 2007): along a bare corridor a scan fixes nothing.
"""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2

_SURFACE_GAP_M = 0.3  # neighbouring points this close lie on one surface
_RANGE_NOISE_M = 0.1  # neighbouring readings err alike, so more than one reading's noise
LOOSE_INFORMATION = np.diag([0.3**-2, 0.3**-2, 0.2**-2])  # of a motion without a wall in sight


def observability(points: FloatArray) -> FloatArray:
    """Fisher information (3, 3) of a scan's own pose, from points (N, 2) in order of bearing.

    Sum of J^T J / sigma^2 with J = (n, p x n) for the surface normal n at p.
    """
    if len(points) < 3:
        return np.zeros((3, 3))
    tangent = points[2:] - points[:-2]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    good = (length > 1e-6) & (length < 2 * _SURFACE_GAP_M)
    tangent, p = tangent[good] / length[good, None], points[1:-1][good]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    rows = np.column_stack([normal, p[:, 0] * normal[:, 1] - p[:, 1] * normal[:, 0]])
    return np.asarray(rows.T @ rows / _RANGE_NOISE_M**2, dtype=np.float64)


def step_information(step: Pose2, points: FloatArray) -> FloatArray:
    """Information (3, 3) of a motion `step`, weighed in the frame it ends in.

    `points` (N, 2) are the walls seen from its end.
    """
    position, angle = 0.01 + 0.03 * step.distance, 0.003 + 0.02 * abs(step.theta)
    moved = np.diag([position**2, position**2, angle**2])
    unseen = np.linalg.inv(observability(points) + LOOSE_INFORMATION)
    return np.asarray(np.linalg.inv(moved + unseen), dtype=np.float64)

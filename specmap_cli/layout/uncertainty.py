"""How far one node of the path may be from where another one has it: errors of steps, added up.

The error of a step is small, so that errors add up as motions of the map about one origin (Barfoot
and Furgale, "Associating uncertainty with three-dimensional poses", T-RO 2014, first order): sums
along the path give the covariance between any two nodes at once. A share of the way is added
for errors that go on in one direction: wheels measured wrongly, a corridor that looks shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, inverse3, invert
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.pose_graph import Link

DRIFT_SHARE = 0.04  # metres per metre driven by which a layout with passes may be off
_DRIFT_RAD_PER_M = 0.001  # radians per metre by which tracking may turn on and on


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """`sums` (M, 3, 3): the covariance of each node in the map's frame, seen from the first.

    `way` (M,) metres driven up to each node; `share` and `veer` are errors that go on, metres and
    radians a metre.
    """

    sums: FloatArray
    way: FloatArray
    poses: FloatArray
    share: float
    veer: float = 0.0

    @classmethod
    def along(
        cls, poses: FloatArray, motions: Sequence[Link], share: float, veer: float = 0.0
    ) -> Uncertainty:
        """Of a path of nodes (M, 3), from its M - 1 motions."""
        steps = np.array([link.information for link in motions]).reshape(-1, 3, 3)
        lengths = [link.source_from_target.distance for link in motions]
        placed = adjoint(poses[1:])
        noise = moved_covariance(placed, inverse3(steps))
        sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(noise, axis=0)])
        way = np.concatenate([[0.0], np.cumsum(np.array(lengths))])
        return cls(sums, way, poses, share, veer)

    def between(self, i: IntArray, j: IntArray) -> FloatArray:
        """(L, 3, 3) covariance of the poses of rows `j` (L,) seen from rows `i`, in their frame."""
        low, high = np.minimum(i, j), np.maximum(i, j)
        summed = self.sums[high] - self.sums[low]
        spread = moved_covariance(adjoint(invert(self.poses[j])), summed)
        driven, away = self.way[high] - self.way[low], self.poses[j, :2] - self.poses[i, :2]
        turned = self.veer * driven
        aside = 0.5 * turned * np.hypot(away[:, 0], away[:, 1])  # half: it turns bit by bit
        steady = (self.share * driven) ** 2 + aside**2
        spread[:, 0, 0] += steady
        spread[:, 1, 1] += steady
        spread[:, 2, 2] += turned**2
        return spread


def path_error(graph: Graph, poses: FloatArray) -> Uncertainty:
    """The error of a path at poses (M, 3): of errors that go on, the settings are two sigmas."""
    return Uncertainty.along(poses, graph.odometry, 0.5 * DRIFT_SHARE, 0.5 * _DRIFT_RAD_PER_M)


def adjoint(poses: FloatArray) -> FloatArray:
    """(L, 3, 3) what turns a small motion in the frame of each pose (L, 3) into one of the map."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    matrix = np.zeros((len(poses), 3, 3))
    matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 0, 2] = c, -s, poses[:, 1]
    matrix[:, 1, 0], matrix[:, 1, 1], matrix[:, 1, 2] = s, c, -poses[:, 0]
    matrix[:, 2, 2] = 1.0
    return matrix


def moved_covariance(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """(L, 3, 3) A C A^T, summed in one order on every processor."""
    half = np.einsum("lab,lbc->lac", matrix, covariance)
    return np.asarray(np.einsum("lac,ldc->lad", half, matrix), dtype=np.float64)


def surprise(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """(L,) chi2 of errors (L, 3) of these covariances (L, 3, 3)."""
    weights = inverse3(covariance)
    return np.asarray(np.einsum("la,lab,lb->l", error, weights, error), dtype=np.float64)


def misfit(poses: FloatArray, i: IntArray, j: IntArray, measured: FloatArray) -> FloatArray:
    """(L, 3) what links i -> j (L, 3) miss at these poses, as motions in the frame of row j."""
    expected = compose(invert(poses[i]), poses[j])
    return compose(invert(measured), expected)


def within_ellipse(away: FloatArray, covariance: FloatArray) -> BoolArray:
    """(N,) whether vectors (N, 2) end inside the ellipse of a covariance (2, 2)."""
    (a, b), (_, c) = covariance.tolist()
    x, y = away[:, 0], away[:, 1]
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= a * c - b * b)

"""Rigid motions of the plane and of space, and the ways that robots drive.

`a_from_b` maps coordinates in frame b to coordinates in frame a, so that
`a_from_c = a_from_b @ b_from_c`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]  # of three: the one behind each, and the one behind that


def wrap_angle(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def wrap_angles(angles: NDArray[Any]) -> FloatArray:
    """The same angles in [-pi, pi), elementwise."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def product(a: NDArray[Any], b: NDArray[Any]) -> FloatArray:
    """The matrix product a (..., n, k) b (..., k, m), the same to the last bit on every processor.

    `@` is not: a fused multiplication rounds otherwise, and a point may fall into another cell.
    """
    return np.asarray(np.einsum("...ij,...jk->...ik", a, b), dtype=np.float64)


def inverse3(matrices: NDArray[Any]) -> FloatArray:
    """The inverses of matrices (..., 3, 3), by cofactors, the same bits on every processor.

    Good for matrices that are far from singular, as covariances with a floor are.
    """
    rows = np.asarray(matrices, dtype=np.float64)
    one, two = rows[..., _NEXT, :], rows[..., _LAST, :]  # np.cross takes four times as long
    cofactors = one[..., _NEXT] * two[..., _LAST] - one[..., _LAST] * two[..., _NEXT]
    determinant = (rows[..., 0, :] * cofactors[..., 0, :]).sum(axis=-1)
    return np.asarray(
        np.divide(cofactors.swapaxes(-1, -2), determinant[..., None, None], order="C")
    )


class Pose2(NamedTuple):
    """A rigid motion of the plane: metres and radians."""

    x: float
    y: float
    theta: float

    def __matmul__(self, other: Pose2) -> Pose2:
        """Composition: `a_from_b @ b_from_c`."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.theta + other.theta),
        )

    def inverse(self) -> Pose2:
        """`b_from_a` of `a_from_b`."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.theta))

    def apply(self, points: NDArray[Any]) -> FloatArray:
        """Points (N, 2) of frame b in frame a."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        x, y = points[:, 0], points[:, 1]
        placed = np.empty((len(points), 2))
        # not by `@`, see `product`; twice as quick by columns
        placed[:, 0] = c * x - s * y + self.x
        placed[:, 1] = s * x + c * y + self.y
        return placed

    def rotation(self) -> FloatArray:
        """The rotation matrix (2, 2)."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.array([[c, -s], [s, c]])

    def matrix(self) -> FloatArray:
        """The homogeneous matrix (4, 4) of the same motion in space, z, roll and pitch zero."""
        matrix = np.eye(4)
        matrix[:2, :2] = self.rotation()
        matrix[0, 3], matrix[1, 3] = self.x, self.y
        return matrix

    @property
    def distance(self) -> float:
        """Length of the translation, metres."""
        return math.hypot(self.x, self.y)

    @classmethod
    def from_matrix(cls, matrix: NDArray[Any]) -> Pose2:
        """The motion of the plane in a homogeneous matrix (4, 4): its x, y and yaw."""
        return cls(float(matrix[0, 3]), float(matrix[1, 3]), yaw_of(matrix))


IDENTITY = Pose2(0.0, 0.0, 0.0)


def compose(a_from_b: NDArray[Any], b_from_c: NDArray[Any]) -> FloatArray:
    """Composition of arrays of poses (..., 3), broadcasting."""
    a, b = np.asarray(a_from_b, dtype=np.float64), np.asarray(b_from_c, dtype=np.float64)
    x, y, c, s = b[..., 0], b[..., 1], np.cos(a[..., 2]), np.sin(a[..., 2])
    turn = wrap_angles(a[..., 2] + b[..., 2])
    return np.stack([a[..., 0] + c * x - s * y, a[..., 1] + s * x + c * y, turn], axis=-1)


def invert(a_from_b: NDArray[Any]) -> FloatArray:
    """Inverses of an array of poses (..., 3)."""
    a = np.asarray(a_from_b, dtype=np.float64)
    x, y, c, s = a[..., 0], a[..., 1], np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * x - s * y, s * x - c * y, wrap_angles(-a[..., 2])], axis=-1)


def apply_each(poses: FloatArray, clouds: Sequence[NDArray[Any]]) -> FloatArray:
    """All points (N, 2) of some clouds, each cloud placed at its own one of `poses` (n, 3).

    They are those of `Pose2.apply` to the last bit, in the order of the clouds. Many clouds take
    less time together.
    """
    counts = np.array([len(cloud) for cloud in clouds], dtype=np.intp)
    x, y = np.concatenate([np.zeros((0, 2)), *clouds]).T
    headings = poses[:, 2].tolist()
    c = np.repeat(np.array([math.cos(heading) for heading in headings]), counts)
    s = np.repeat(np.array([math.sin(heading) for heading in headings]), counts)
    placed = np.empty((len(x), 2))
    placed[:, 0] = c * x - s * y + np.repeat(poses[:, 0], counts)
    placed[:, 1] = s * x + c * y + np.repeat(poses[:, 1], counts)
    return placed


def nearest_motion(source: NDArray[Any], target: NDArray[Any]) -> Pose2:
    """The rigid motion that takes points (n, 2) nearest to others (n, 2), by least squares."""
    middle, aim = np.mean(source, axis=0), np.mean(target, axis=0)
    a, b = source - middle, target - aim
    turn = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    rotated = Pose2(0.0, 0.0, turn).apply(middle[None])[0]
    return Pose2(float(aim[0] - rotated[0]), float(aim[1] - rotated[1]), turn)


def yaw_of(matrix: NDArray[Any]) -> float:
    """Yaw of a rotation held in the upper left (3, 3) of a matrix, radians."""
    return math.atan2(float(matrix[1, 0]), float(matrix[0, 0]))


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion of any positive length; a zero one is the identity."""
    n = x * x + y * y + z * z + w * w
    if not n > 0.0 or not math.isfinite(n):
        return np.eye(3)
    s = 2.0 / n
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


def quaternions_from_rpy(roll: NDArray[Any], pitch: NDArray[Any], yaw: NDArray[Any]) -> FloatArray:
    """(n, 4) unit quaternions (x, y, z, w), w >= 0, of Rz(yaw) Ry(pitch) Rx(roll), each (n,)."""
    (sr, sp, sy), (cr, cp, cy) = (
        (f(roll / 2.0), f(pitch / 2.0), f(yaw / 2.0)) for f in (np.sin, np.cos)
    )
    quaternions = np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=-1,
    )
    return np.asarray(np.where(quaternions[..., 3:] < 0.0, -quaternions, quaternions))


def rpy_from_quaternions(quaternions: NDArray[Any]) -> FloatArray:
    """(n, 3) roll, pitch and yaw of unit quaternions (n, 4), as in `quaternions_from_rpy`."""
    x, y, z, w = np.asarray(quaternions, dtype=np.float64).T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([roll, pitch, yaw])


def step_lengths(poses: NDArray[Any]) -> FloatArray:
    """(n - 1,) metres from each place of `poses` (n, 2 or more columns) to the next; (0,) of none.

    NaN where one of the two places is not known.
    """
    steps = np.diff(np.asarray(poses, dtype=np.float64)[:, :2], axis=0)
    return np.asarray(np.hypot(steps[:, 0], steps[:, 1]), dtype=np.float64)


def path_length(poses: NDArray[Any]) -> float:
    """Metres along `poses` (n, 2 or more columns)."""
    return float(step_lengths(poses).sum())


def travelled(poses: NDArray[Any]) -> FloatArray:
    """(n,) metres driven from the first of `poses` (n, 2 or more columns) to each of them."""
    way = np.zeros(len(poses))
    np.cumsum(step_lengths(poses), out=way[1:])
    return way


def moved(before: Pose2 | None, now: Pose2, distance_m: float, angle_rad: float) -> bool:
    """Whether the robot drove `distance_m` or turned `angle_rad` since `before`, or more.

    Without a pose before, it has: the first scan always counts.
    """
    if before is None:
        return True
    step = before.inverse() @ now
    return step.distance >= distance_m or abs(step.theta) >= angle_rad


_RIGID_M = 0.25  # what a map's whole motion may be off by anywhere, as its layout bends
_BEND = 0.01  # metres a metre: what a motion that holds at one place is off by at another

_AT_ONCE = 1 << 20  # points times places: bounds the memory to some 100 MB


@dataclass(frozen=True, slots=True)
class LocalMotion:
    """At `centre` (2,) of the source the motion is this one.

    `off_m` and `off_rad` are its standard deviations there, of the place and of the heading.
    """

    centre: FloatArray
    motion: Pose2
    off_m: float
    off_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class BentMotion:
    """`rigid` from one map to another, with the motions that hold at some places; it blends.

    Each counts by what it may be off by: the heading of a small room says little far from it.
    """

    rigid: Pose2
    local: tuple[LocalMotion, ...] = ()

    def apply(self, points: FloatArray) -> FloatArray:
        """Points (N, 2) of one map in the other."""
        if not self.local:
            return self.rigid.apply(points)
        centres = np.array([one.centre for one in self.local])
        there = np.array([one.off_m**2 for one in self.local])
        away = np.array([one.off_rad**2 + _BEND**2 for one in self.local])
        placed = np.zeros((len(points), 2))
        step = max(1, _AT_ONCE // len(self.local))
        for first in range(0, len(points), step):
            some = points[first : first + step]
            squares = ((some[:, None, :] - centres[None]) ** 2).sum(axis=2)
            shares = (there + away * squares) ** -2.0
            shares = np.column_stack([shares, np.full(len(some), _RIGID_M**-4.0)])
            shares /= shares.sum(axis=1, keepdims=True)
            for k, motion in enumerate([*(one.motion for one in self.local), self.rigid]):
                placed[first : first + step] += shares[:, k, None] * motion.apply(some)
        return placed

    def near(self, place: FloatArray) -> Pose2:
        """The rigid motion round a place (2,)."""
        here = place[None]
        shift = (self.apply(here) - self.rigid.apply(here))[0]
        x, y, theta = self.rigid
        return Pose2(x + float(shift[0]), y + float(shift[1]), theta)

    def inverse(self) -> BentMotion:
        """The motion back."""
        local = tuple(
            replace(one, centre=one.motion.apply(one.centre[None])[0], motion=one.motion.inverse())
            for one in self.local
        )
        return BentMotion(self.rigid.inverse(), local)

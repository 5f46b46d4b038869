"""The tree of coordinate frames, and odometry at the stamps of scans."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.logs.messages import TransformRecord

_MAX_DEPTH = 100  # a longer chain of frames is a loop


class TransformTree:
    """The latest transform of every frame from its parent; frames form a forest."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._parent_from: dict[str, FloatArray] = {}
        self._moving: set[str] = set()

    def add(self, record: TransformRecord, *, dynamic: bool) -> None:
        """Take in one transform; a later one of the same child replaces it."""
        if record.parent == record.child:
            return
        self._parent[record.child] = record.parent
        self._parent_from[record.child] = record.parent_from_child
        if dynamic:
            self._moving.add(record.child)

    def copy(self) -> TransformTree:
        """A tree that can change on its own."""
        tree = TransformTree()
        tree._parent, tree._parent_from = dict(self._parent), dict(self._parent_from)
        tree._moving = set(self._moving)
        return tree

    @property
    def frames(self) -> set[str]:
        """Every frame that occurs."""
        return set(self._parent) | set(self._parent.values())

    def edges(self) -> list[tuple[str, str, FloatArray, bool]]:
        """(parent, child, parent_from_child, whether it came on a dynamic topic), by child."""
        return [
            (self._parent[child], child, self._parent_from[child], child in self._moving)
            for child in sorted(self._parent)
        ]

    def ancestors(self, frame: str) -> Iterator[str]:
        """The frame and its parents up to the root."""
        for _ in range(_MAX_DEPTH):
            yield frame
            if frame not in self._parent:
                return
            frame = self._parent[frame]

    def lookup(self, target: str, source: str) -> FloatArray | None:
        """target_from_source (4, 4), None when no chain of transforms joins the frames."""
        above = list(self.ancestors(target))
        common = next((frame for frame in self.ancestors(source) if frame in above), None)
        if common is None:
            return None
        up, down = self._from_ancestor(common, target), self._from_ancestor(common, source)
        return np.asarray(np.linalg.inv(up) @ down)

    def _from_ancestor(self, ancestor: str, frame: str) -> FloatArray:
        matrix = np.eye(4)
        while frame != ancestor:
            matrix = self._parent_from[frame] @ matrix
            frame = self._parent[frame]
        return matrix


class OdometryBuffer:
    """Odometry of the last while, interpolated at the stamps of scans.

    Poses may come in any order; only so many are kept. A pose that lies further back in time than
    odometry could be late starts the buffer anew, as the clock was set back.
    """

    MAX_POSES = 8192
    MAX_GAP_NS = 2_000_000_000  # poses further apart are not interpolated between
    MAX_HOLD_NS = 100_000_000  # how long before the first or after the last pose it still holds
    RESTART_NS = 10_000_000_000

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._poses: list[Pose2] = []

    @property
    def latest_ns(self) -> int | None:
        """The latest stamp, None while empty."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp_ns: int, pose: Pose2) -> None:
        """Take in odom_from_base at a stamp; a repeated stamp replaces the pose."""
        if self._stamps and stamp_ns < self._stamps[-1] - self.RESTART_NS:
            self._stamps.clear()
            self._poses.clear()
        place = bisect_left(self._stamps, stamp_ns)
        if place < len(self._stamps) and self._stamps[place] == stamp_ns:
            self._poses[place] = pose
            return
        self._stamps.insert(place, stamp_ns)
        self._poses.insert(place, pose)
        if len(self._stamps) > self.MAX_POSES:
            del self._stamps[: self.MAX_POSES // 2]
            del self._poses[: self.MAX_POSES // 2]

    def at(self, stamp_ns: int) -> Pose2 | None:
        """odom_from_base at a stamp, None where the odometry has a hole or does not reach."""
        place = bisect_left(self._stamps, stamp_ns)
        if place < len(self._stamps) and self._stamps[place] == stamp_ns:
            return self._poses[place]
        if place in (0, len(self._stamps)):
            return self._held(place, stamp_ns)
        before, after = self._stamps[place - 1], self._stamps[place]
        if after - before > self.MAX_GAP_NS:
            return None
        share = (stamp_ns - before) / (after - before)
        return interpolated(self._poses[place - 1], self._poses[place], share)

    def _held(self, place: int, stamp_ns: int) -> Pose2 | None:
        """The first or last pose when it is near enough in time."""
        if not self._stamps:
            return None
        nearest = min(place, len(self._stamps) - 1)
        close = abs(self._stamps[nearest] - stamp_ns) <= self.MAX_HOLD_NS
        return self._poses[nearest] if close else None


def interpolated(a: Pose2, b: Pose2, share: float) -> Pose2:
    """The pose a share of the way from `a` (0) to `b` (1)."""
    turn = wrap_angle(b.theta - a.theta)
    return Pose2(
        a.x + share * (b.x - a.x),
        a.y + share * (b.y - a.y),
        wrap_angle(a.theta + share * turn),
    )


def tilt_of(matrix: FloatArray) -> float:
    """Angle between the z axes of the two frames of a transform (4, 4), radians in [0, pi]."""
    return math.acos(float(np.clip(matrix[2, 2], -1.0, 1.0)))

"""The tree of coordinate frames."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from specmap_cli.core.geometry import FloatArray
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


def tilt_of(matrix: FloatArray) -> float:
    """Angle between the z axes of the two frames of a transform (4, 4), radians in [0, pi]."""
    return math.acos(float(np.clip(matrix[2, 2], -1.0, 1.0)))

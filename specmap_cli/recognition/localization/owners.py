"""Which submap a place belongs to: that of the nearest keyframe in sight."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import OCCUPIED, GridMap


class Owners:
    """Divides a map among its submaps, of which `grids` are in the `frames` of the layout.

    `tracks` (n, 2 or more) are the places of the keyframes of each submap, in the map. Without
    them, or without a frame, a place stays in the submap that it was found in: `known` is false
    when that is so of all.
    """

    def __init__(
        self,
        tracks: Mapping[int, FloatArray],
        frames: Mapping[int, Pose2],
        grids: Mapping[int, GridMap],
    ) -> None:
        self.frames = frames
        self.grids = grids
        self._ids = sorted(i for i in tracks if len(tracks[i]))
        places = [tracks[i][:, :2] for i in self._ids]
        self._places = np.vstack(places) if places else np.zeros((0, 2))
        self._starts = np.cumsum([0] + [len(part) for part in places[:-1]])

    @property
    def known(self) -> bool:
        """Whether it is known at all which places belong to which submap."""
        return bool(self._ids) and bool(self.frames)

    def of(self, submap: int, pose: Pose2) -> int:
        """The submap that a pose in one belongs to."""
        if submap not in self.frames or not self._ids:
            return submap
        here = self.frames[submap] @ pose
        off = self._places - (here.x, here.y)
        squares = off[:, 0] ** 2 + off[:, 1] ** 2
        nearest = np.minimum.reduceat(squares, self._starts)
        for k in np.argsort(nearest, kind="stable").tolist():
            owner, first = self._ids[k], int(self._starts[k])
            if owner == submap:
                break
            keyframe = first + int((squares[first:] == nearest[k]).argmax())
            if self._is_in_sight(submap, pose, self._places[keyframe]):
                return int(owner)
        return submap

    def _is_in_sight(self, submap: int, pose: Pose2, place: FloatArray) -> bool:
        """Whether no wall of a submap stands between a pose in it and a place (2,) in the map."""
        grid = self.grids[submap]
        (end,) = self.frames[submap].inverse().apply(place[None])
        way = end - (pose.x, pose.y)
        steps = 1 + math.ceil(math.hypot(*way.tolist()) / grid.resolution)
        on_it = np.linspace(0.0, 1.0, steps)[:, None] * way + (pose.x, pose.y)
        return not bool((grid.values_at(on_it) == OCCUPIED).any())

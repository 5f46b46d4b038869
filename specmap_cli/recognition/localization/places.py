"""Places: poses in submaps, where motion leads from them, whose they are, and which of them led."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import OCCUPIED, GridMap

SAME = 0.3, 0.1  # two places so near are one, metres and radians
BESIDE = 1.0, 0.3  # much the same is seen at places so near


@dataclass(frozen=True, slots=True)
class Place:
    """A scan was found at `pose` in a submap, when the robot's track was at `map_from_base`."""

    submap: int
    pose: Pose2
    map_from_base: Pose2

    def led_to(
        self, submap: int, map_from_base: Pose2, frames: Mapping[int, Pose2]
    ) -> Pose2 | None:
        """Where in `submap` the motion since leads; None when that is not known.

        `frames` are the submaps' frames in the layout; without them only the same submap is known.
        """
        pose = self.moved(map_from_base).pose
        if submap == self.submap:
            return pose
        if submap not in frames or self.submap not in frames:
            return None
        return frames[submap].inverse() @ frames[self.submap] @ pose

    def moved(self, map_from_base: Pose2) -> Place:
        """Where the motion since leads in the same submap."""
        pose = self.pose @ (self.map_from_base.inverse() @ map_from_base)
        return Place(self.submap, pose, map_from_base)

    def is_near(
        self, other: Place, frames: Mapping[int, Pose2], reach_m: float, reach_rad: float
    ) -> bool:
        """Whether another place, perhaps known in another submap, is within reach of this one."""
        there = other.led_to(self.submap, self.map_from_base, frames)
        if there is None:
            return False
        off = self.pose.inverse() @ there
        return off.distance < reach_m and abs(off.theta) < reach_rad


@dataclass(frozen=True, slots=True)
class LeadingPlace:
    """A place that leads all others, and its probability."""

    place: Place
    probability: float


def looking_back(
    scans: Sequence[tuple[Pose2, bool, LeadingPlace | None]], reach_m: float
) -> list[LeadingPlace | None]:
    """The lead of each scan, where it was; where none led, the next within `reach_m` of way.

    `scans` are the poses of a log in turn, whether a track ended before each, and its lead. What
    comes after a loss of tracking says nothing of what was before.
    """
    filled: list[LeadingPlace | None] = []
    later: LeadingPlace | None = None
    way, after = 0.0, None
    for map_from_base, ends, lead in reversed(scans):
        way += 0.0 if after is None else (map_from_base.inverse() @ after).distance
        if lead is not None:
            later, way = lead, 0.0
        near = later if way <= reach_m else None
        filled.append(near and LeadingPlace(near.place.moved(map_from_base), near.probability))
        after = None if ends else map_from_base
        later = None if ends else later
    return filled[::-1]


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
        here, grid = self.frames[submap] @ pose, self.grids[submap]
        off = self._places - (here.x, here.y)
        squares = off[:, 0] ** 2 + off[:, 1] ** 2
        nearest = np.minimum.reduceat(squares, self._starts)
        for k in np.argsort(nearest, kind="stable").tolist():
            owner, first = self._ids[k], int(self._starts[k])
            if owner == submap:
                break
            keyframe = first + int((squares[first:] == nearest[k]).argmax())
            # unless a wall of the submap stands between
            (end,) = self.frames[submap].inverse().apply(self._places[keyframe][None])
            way = end - (pose.x, pose.y)
            steps = 1 + math.ceil(math.hypot(*way.tolist()) / grid.resolution)
            on_it = np.linspace(0.0, 1.0, steps)[:, None] * way + (pose.x, pose.y)
            if not (grid.values_at(on_it) == OCCUPIED).any():
                return int(owner)
        return submap

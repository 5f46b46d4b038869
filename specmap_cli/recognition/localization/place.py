"""Where a scan was found: a pose in a submap, and where the robot's motion leads from there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from specmap_cli.core.geometry import Pose2

_SAME_M, _SAME_RAD = 0.3, 0.1  # two places so near are one
_BESIDE_M, _BESIDE_RAD = 1.0, 0.3


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

    def is_same(self, other: Place, frames: Mapping[int, Pose2]) -> bool:
        """Whether another place is this one, perhaps known in another submap."""
        return self._is_within(other, frames, _SAME_M, _SAME_RAD)

    def is_beside(self, other: Place, frames: Mapping[int, Pose2]) -> bool:
        """Whether another place is so near that much the same is seen there."""
        return self._is_within(other, frames, _BESIDE_M, _BESIDE_RAD)

    def _is_within(
        self, other: Place, frames: Mapping[int, Pose2], reach_m: float, reach_rad: float
    ) -> bool:
        there = other.led_to(self.submap, self.map_from_base, frames)
        if there is None:
            return False
        off = self.pose.inverse() @ there
        return off.distance < reach_m and abs(off.theta) < reach_rad

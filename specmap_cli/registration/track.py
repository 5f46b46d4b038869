"""Where the robot is in the map, and how it came there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.reliance import UNKNOWN, Reliance

_STEADY = 15  # latest motions that walls fixed: the last few before a bare corridor are too short


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """The state of the front end between two sweeps.

    `pose` (4, 4) is that of the base in the map. `keyframe` is the pose of the last keyframe, None
    without a map; `by_motion` is the place that the expected motions alone lead to from there, all
    of them `measured` by odometry or not. `lost_in_a_row` sweeps were lost up to now; `broken` says
    that they ended the last map, whose last keyframe was at `left`. The map is `founded` when a
    second sweep agrees with its first.
    """

    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    keyframe: Pose2 | None = None
    left: Pose2 | None = None
    by_motion: Pose2 = IDENTITY
    measured: bool = True
    lost_in_a_row: int = 0
    broken: bool = False
    founded: bool = False
    reliance: Reliance = UNKNOWN
    steady: tuple[Pose2, ...] = ()

    @property
    def carried_on(self) -> Pose2:
        """The place after one more motion as most of the latest ones that walls fixed."""
        here = Pose2.from_matrix(self.pose)
        if not self.steady:
            return here
        x, y, _ = np.median(np.array(self.steady), axis=0).tolist()
        return here @ Pose2(x, y, 0.0)

    def with_steady(self, motion: Pose2) -> Track:
        """The state after one more motion that walls fixed."""
        return replace(self, steady=(*self.steady, motion)[-_STEADY:])

    def moved_on(self, motion: Pose2, *, measured: bool) -> Track:
        """The state after one more motion is expected, which odometry measured or did not."""
        return replace(self, by_motion=self.by_motion @ motion, measured=self.measured and measured)

    @property
    def bridge(self) -> tuple[float, float] | None:
        """How far odometry may be off across a break, metres and radians; None without odometry.

        Odometry that led where the walls contradict it is taken to err by all it has ever erred.
        """
        if self.left is None or not self.measured:
            return None
        slack = self.reliance.slack(self.left.inverse() @ self.by_motion)
        return math.hypot(slack.along_m, slack.across_m), slack.turn_rad

    def is_carried(self, config: RegistrationConfig) -> bool:
        """Whether odometry alone tells the place well enough to go on with it.

        Since the last keyframe of a founded map it measured every motion, and what it has been
        worth leaves it no farther off than a result may be from its guess.
        """
        if self.keyframe is None or not (self.founded and self.measured and self.reliance.trusted):
            return False
        slack = self.reliance.slack(self.keyframe.inverse() @ self.by_motion)
        near = math.hypot(slack.along_m, slack.across_m) <= config.max_shift_m
        return near and slack.turn_rad <= config.max_shift_rad

    def with_keyframe(self, keyframe: Pose2, reliance: Reliance) -> Track:
        """The state after a keyframe was put at a pose."""
        return replace(
            self,
            keyframe=keyframe,
            left=None,
            by_motion=keyframe,
            measured=True,
            broken=False,
            reliance=reliance,
        )

"""Where the robot is in the map, and how it came there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """The state of the front end between two sweeps.

    `pose` (4, 4) is that of the base in the map. `keyframe` is the pose of the last keyframe, None
    without a map; `by_motion` is the place that the expected motions alone lead to from there.
    `lost_in_a_row` sweeps were lost up to now; `broken` says that they ended the last map.
    """

    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    keyframe: Pose2 | None = None
    by_motion: Pose2 = IDENTITY
    lost_in_a_row: int = 0
    broken: bool = False

"""The records that travel between the stages: frozen, typed, arrays read-only by convention.

log -> `Sweep` -> registration -> `PosedScan` -> keyframes -> segmentation, recognition, topology.
Stamps are header stamps in integer nanoseconds; lengths are metres, angles radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.json_values import Count, MaybeNan, Motion, Value
from specmap_cli.core.odometry import UNMEASURED, Slack

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NO_SUBMAP = -1
_NS = 1e9


@dataclass(frozen=True, slots=True)
class PlanarScan:
    """One planar sweep in its laser's frame, levelled: z up, bearings counter-clockwise.

    `bearings` (B,) ascending; `ranges` (B,) metres, +inf = no return, NaN = invalid reading;
    `beam_times_s` (B,) seconds after `stamp_ns`, or None when the beams share one time.
    """

    stamp_ns: int
    bearings: FloatArray
    ranges: FloatArray
    range_max: float
    full_circle: bool
    beam_times_s: FloatArray | None = None

    def hits(self, max_range: float = np.inf) -> FloatArray:
        """Points (N, 2) of the returns up to `max_range`, laser frame."""
        hit = np.isfinite(self.ranges) & (self.ranges <= max_range)
        r, b = self.ranges[hit], self.bearings[hit]
        return np.column_stack([r * np.cos(b), r * np.sin(b)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """One scan of a log, ready for registration.

    `cloud` (N, 3) finite points in the base frame and `cloud_times_s` (N,) seconds after the stamp
    are set for a 3D lidar without odometry only. The `planar` scan of a lidar is the nearest return
    per bearing inside the height band. `odom_from_base` is the odometry at the stamp, None where
    there is none.
    """

    index: int
    stamp_ns: int
    planar: PlanarScan
    base_from_laser: Pose2
    odom_from_base: Pose2 | None = None
    cloud: FloatArray | None = None
    cloud_times_s: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PosedScan:
    """A registered scan: its pose in the map and how far registration can be trusted.

    `score` is in [0, 1]; `agrees` says whether the result agrees with odometry (or with the motion
    before); `lost` marks a scan that could not be registered and must not enter a map; `restarted`
    marks the first scan after a run of lost ones, joined to what came before by a guess only;
    `bridge` are the standard deviations of that guess, metres and radians, None where nothing
    measured it.
    `planar` is de-skewed. Walls do not fix each motion in all directions: what was guessed on the
    way up to it may be off by `guessed_m`, x and y in the map, a standard deviation.
    `odometry_slacks` say by how many slacks of an unknown odometry the one that measured the motion
    up to it may be off.
    `odom_from_base` is the odometry at its stamp, None where there is none.
    `map_from_base_3d` (4, 4) keeps z, roll and pitch of a 3D lidar.
    """

    index: int
    stamp_ns: int
    map_from_base: Pose2
    planar: PlanarScan
    base_from_laser: Pose2
    score: float = 1.0
    agrees: bool = True
    lost: bool = False
    restarted: bool = False
    bridge: tuple[float, float] | None = None
    guessed_m: tuple[float, float] = (0.0, 0.0)
    odometry_slacks: Slack = UNMEASURED
    odom_from_base: Pose2 | None = None
    map_from_base_3d: FloatArray | None = None

    @property
    def map_from_laser(self) -> Pose2:
        """Pose of the laser in the map."""
        return self.map_from_base @ self.base_from_laser


@dataclass(frozen=True, slots=True, kw_only=True)
class Closure(Value):
    """Two stays that loop closure compared."""

    new: Count
    """number of the later stay"""
    old: Count
    """number of the earlier stay"""
    new_submap: Count | None = None
    """id of the node that `new` ended in; null where it is not known"""
    old_submap: Count | None = None
    """id of the node that `old` ended in; null where it is not known"""
    xi: MaybeNan
    """eq. 5: the product of the claims; all three null where maps were joined"""
    claims_new_by_old: MaybeNan
    """eq. 4: share of the scans of `new` that the classifier of `old` claims"""
    claims_old_by_new: MaybeNan
    """eq. 4: share of the scans of `old` that the classifier of `new` claims"""
    verified: bool
    """whether the two grids match, and the layout does not contradict it"""
    score: MaybeNan
    """how well the grids match, 1 is perfect; null when they were not compared"""
    merged: Annotated[bool, Field(alias="accepted")]
    """whether the two became one submap"""
    reason: str
    """why they did, or why not"""
    old_from_new: Annotated[Motion | None, Field(alias="transform")] = None
    """[x, y, theta] of the frame of `new`, its `origin`, in that of `old`; null when not
    verified"""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The base at every scan: `stamps_ns` (n,) int64 and `poses` (n, 3) in the map.

    `tilt` (n, 3) holds z, roll and pitch for a 3D lidar, None for planar logs. `lost` (n,) marks
    the scans that could not be registered: their poses are guesses. `odometry` (n, 3) are the poses
    by odometry, NaN where there is none. Each is None where nothing is known of it.
    """

    stamps_ns: IntArray
    poses: FloatArray
    tilt: FloatArray | None = None
    lost: BoolArray | None = None
    odometry: FloatArray | None = None

    def __iter__(self) -> Iterator[tuple[int, Pose2]]:
        """Stamp and pose of each scan."""
        for stamp_ns, pose in zip(self.stamps_ns, self.poses, strict=True):
            yield int(stamp_ns), Pose2(*pose.tolist())

    @property
    def driven(self) -> FloatArray:
        """(m, 3) the poses of the scans that could be registered."""
        return self.poses if self.lost is None else self.poses[~self.lost]


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """The keyframes of a map: `stamps_ns` (n,), `poses` (n, 3) in the map, `submaps` (n,) ids.

    A keyframe in no submap has NO_SUBMAP.
    """

    stamps_ns: IntArray
    poses: FloatArray
    submaps: IntArray

    def __iter__(self) -> Iterator[tuple[int, Pose2, int | None]]:
        """Stamp, pose and submap of each keyframe; None for one in no submap."""
        for stamp_ns, pose, submap in zip(self.stamps_ns, self.poses, self.submaps, strict=True):
            in_one = None if submap == NO_SUBMAP else int(submap)
            yield int(stamp_ns), Pose2(*pose.tolist()), in_one

    def duration_s(self, starts: Sequence[int] = ()) -> float:
        """Seconds from first keyframe to last, of each recording by itself.

        `starts` are the keyframes with which further recordings begin, ascending.
        """
        recordings = np.split(self.stamps_ns, starts)
        return sum(float(np.ptp(own)) for own in recordings if len(own)) / _NS

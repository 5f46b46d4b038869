"""The records that travel between the stages: frozen, typed, arrays read-only by convention.

log -> `Sweep` -> registration -> `PosedScan` -> keyframes -> segmentation, recognition, topology.
Stamps are header stamps in integer nanoseconds; lengths are metres, angles radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.tracks import path_length

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
    are set for a 3D lidar only, whose `planar` scan is the nearest return per bearing inside the
    height band. `odom_from_base` is the odometry at the stamp, None where there is none.
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
    `bridge` is how far that guess may be off, metres and radians, None where nothing measured it.
    `planar` is de-skewed. `blind`: neither walls nor odometry fix its place along some direction.
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
    blind: bool = False
    odom_from_base: Pose2 | None = None
    map_from_base_3d: FloatArray | None = None

    @property
    def map_from_laser(self) -> Pose2:
        """Pose of the laser in the map."""
        return self.map_from_base @ self.base_from_laser


@dataclass(frozen=True, slots=True, kw_only=True)
class Closure:
    """One considered pair of submaps: the claims of eq. 4, xi of eq. 5, the geometric check.

    `score` is the geometric score (NaN when the pair was not checked), `verified` whether the grids
    match, `merged` whether the new submap became part of the old one; `old_from_new` the transform
    between the submap frames, None when unverified. `reason` says why, in one phrase.
    """

    new: int
    old: int
    xi: float
    claims_new_by_old: float
    claims_old_by_new: float
    verified: bool
    merged: bool
    score: float
    reason: str
    old_from_new: Pose2 | None = None


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The base at every scan: `stamps_ns` (n,) int64 and `poses` (n, 3) in the map.

    `tilt` (n, 3) holds z, roll and pitch for a 3D lidar, None for planar logs. `lost` (n,) marks
    the scans that could not be registered: their poses are guesses. `odometry` (n, 3) are the poses
    by odometry, NaN where there is none. `blind` (n,) marks scans whose place along some direction
    neither walls nor odometry fix. Each is None where nothing is known of it.
    """

    stamps_ns: IntArray
    poses: FloatArray
    tilt: FloatArray | None = None
    lost: BoolArray | None = None
    odometry: FloatArray | None = None
    blind: BoolArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """The keyframes of a map: `stamps_ns` (n,), `poses` (n, 3) in the map, `submaps` (n,) ids.

    A keyframe in no submap has NO_SUBMAP.
    """

    stamps_ns: IntArray
    poses: FloatArray
    submaps: IntArray

    def driven_m(self, starts: Sequence[int] = ()) -> float:
        """Metres from keyframe to keyframe, of each recording by itself.

        `starts` are the keyframes with which further recordings begin, ascending.
        """
        return sum(path_length(way) for way in np.split(self.poses, starts))

    def duration_s(self, starts: Sequence[int] = ()) -> float:
        """Seconds from first keyframe to last, of each recording by itself; `starts` as above."""
        recordings = np.split(self.stamps_ns, starts)
        return sum(float(np.ptp(own)) for own in recordings if len(own)) / _NS

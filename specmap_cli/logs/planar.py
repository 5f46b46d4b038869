"""From laser scans and clouds to `PlanarScan`: level, bearings ascending, one meaning of ranges.

A range is finite where there was a return, +inf where the beam met nothing, NaN where nothing is
known. Readings below the laser's minimum are invalid; those of 0 m, of the laser's maximum range
and beyond mean no return, whatever the driver's convention, and so does what `Ceiling` finds.
Readings of the robot itself, which `OwnBody` finds, are invalid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, yaw_of
from specmap_cli.core.records import BoolArray, PlanarScan
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.ceiling import Ceiling
from specmap_cli.logs.clouds import CLOUD_RANGE_MAX_M
from specmap_cli.logs.levelling import FLOOR_RADIUS_M
from specmap_cli.logs.messages import BadMessageError, ScanLayout, ScanRecord
from specmap_cli.logs.own_body import OwnBody

SCAN_TIME_MAX_S = 1.0  # a planar sweep that takes longer has its times in another unit
_FLOOR_PERCENTILE = 2.0  # of the heights of returns is the floor: a few stray ones lie below it
_CLOUD_BEAMS = 720  # bearings of the planar scan of a 3D cloud
_CLOUD_FILLED_SHARE = 0.9  # share of the bearings that must have returns, or they are halved
_FULL_CIRCLE = 2.0 * math.pi
_MISSING_BEAMS = 1.5  # of a full circle: its last beam stops one short of the first, and rounding
_MAX_HALVINGS = 2  # a planar scan has no fewer bearings than a quarter of those asked for


class Mount(NamedTuple):
    """How a planar laser sits on the base, and whether it hangs upside down."""

    base_from_laser: Pose2
    upside_down: bool

    @classmethod
    def from_matrix(cls, base_from_laser: FloatArray) -> Mount:
        """The mount in a transform (4, 4).

        A laser upside down is described by the level frame that shares its x axis, in which its
        bearings have the opposite sign.
        """
        x, y = float(base_from_laser[0, 3]), float(base_from_laser[1, 3])
        return cls(Pose2(x, y, yaw_of(base_from_laser)), bool(base_from_laser[2, 2] < 0.0))


LEVEL = Mount(Pose2(0.0, 0.0, 0.0), upside_down=False)  # at the base itself


class _Beams(NamedTuple):
    """Bearings and times (B,) of the beams, and which of the readings as recorded they are."""

    bearings: FloatArray
    times_s: FloatArray | None
    used: slice
    full_circle: bool


class ScanLeveller:
    """Turns the scans of one laser into `PlanarScan`; keeps what they have in common."""

    def __init__(
        self,
        mount: Mount,
        ceiling: Ceiling | None = None,
        own_body: OwnBody | None = None,
    ) -> None:
        self.mount = mount
        self.ceiling = Ceiling() if ceiling is None else ceiling
        self.own_body = OwnBody() if own_body is None else own_body
        self.longest_s = SCAN_TIME_MAX_S
        self._layout: ScanLayout | None = None
        self._beams: _Beams | None = None

    @np.errstate(all="ignore")  # damaged messages hold any bits
    def level(self, scan: ScanRecord, stamp_ns: int) -> PlanarScan:
        """The planar scan; raises BadMessageError for one without beams or without angles."""
        if self._beams is None or scan.layout != self._layout:
            self._beams = _beams(scan.layout, self.mount.upside_down, self.longest_s)
            self._layout = scan.layout
        bearings, times_s, used, full_circle = self._beams
        range_max = scan.range_max if scan.range_max > 0.0 else math.inf
        ranges = _cleaned(scan.ranges[used].astype(np.float64), scan.range_min, range_max)
        self.ceiling.clear(ranges)
        self.own_body.clear(ranges)
        return PlanarScan(
            stamp_ns=stamp_ns,
            bearings=bearings,
            ranges=ranges,
            range_max=range_max,
            full_circle=full_circle,
            beam_times_s=times_s,
        )


def duration_s(scan: ScanRecord) -> float:
    """Seconds from the first to the last beam by the scan's own word, NaN when it is none."""
    return scan.layout.time_increment * max(scan.layout.beams - 1, 0)


def _cleaned(ranges: FloatArray, range_min: float, range_max: float) -> FloatArray:
    """Ranges with +inf for no return and NaN for invalid readings; changes its argument."""
    nothing = (ranges == 0.0) | (ranges >= range_max)
    ranges[(ranges < range_min) | (ranges < 0.0)] = np.nan
    ranges[nothing] = np.inf
    return ranges


def _beams(layout: ScanLayout, upside_down: bool, longest_s: float) -> _Beams:
    """The bearings of a laser, its beam times and which readings are used, in which order."""
    count, step = layout.beams, increment(layout)
    full_circle = covers_circle(count, step)
    if full_circle:  # the last beams may look where the first ones did
        count = min(count, round(_FULL_CIRCLE / abs(step)))
    sign = -1.0 if upside_down else 1.0
    numbers = np.arange(count, dtype=np.float64)
    bearings: FloatArray = sign * (layout.angle_min + step * numbers)
    ascending = sign * step > 0.0 or count == 1
    used = slice(0, count) if ascending else slice(count - 1, None, -1)
    order = slice(None) if ascending else slice(None, None, -1)
    sweep = layout.time_increment * (count - 1)
    timed = 0.0 < sweep <= longest_s
    times: FloatArray | None = layout.time_increment * numbers[order] if timed else None
    bearings = bearings[order].copy()
    bearings.setflags(write=False)
    return _Beams(bearings=bearings, times_s=times, used=used, full_circle=full_circle)


def covers_circle(beams: int, step: float) -> bool:
    """Whether so many beams, an angle apart, look all around."""
    return beams * abs(step) >= _FULL_CIRCLE - _MISSING_BEAMS * abs(step)


def increment(layout: ScanLayout) -> float:
    """The angle from beam to beam; raises BadMessageError for a scan without beams or angles."""
    count, step = layout.beams, layout.angle_increment
    if count == 0:
        raise BadMessageError("a scan without beams")
    if not (math.isfinite(step) and step != 0.0) and count > 1:
        step = (layout.angle_max - layout.angle_min) / (count - 1)
    if not (math.isfinite(layout.angle_min) and math.isfinite(step)) or (count > 1 and not step):
        raise BadMessageError("a scan without angles")
    if count > 1 and abs(step) > _FULL_CIRCLE:
        raise BadMessageError("a scan whose beams are more than a circle apart")
    return step


class CloudFlattener:
    """Turns clouds in the base frame into planar scans: the nearest return per bearing in a band.

    The band lies between two heights above the floor. A bearing with nothing in the band is +inf
    where the lidar has had a return at any height in this or an earlier cloud, so that it looked
    there, and NaN where it never had one, outside its field of view. The number of bearings is
    `_CLOUD_BEAMS`, halved until the lidar's resolution fills them. A floor of unknown height
    (None) is taken to be where the lowest returns of the first cloud are. The clouds of a `planar`
    laser have one height, whichever it is, and their scans keep the times of the beams.
    """

    def __init__(
        self,
        base_from_laser: FloatArray,
        floor_m: float | None,
        config: LogConfig,
        *,
        planar: bool = False,
    ) -> None:
        self.mount = Pose2(float(base_from_laser[0, 3]), float(base_from_laser[1, 3]), 0.0)
        self.config = config
        self._floor = floor_m
        self._planar, self._shift = planar, 0.0
        self._bearings: FloatArray = np.zeros(0)
        self._seen = np.zeros(0, dtype=bool)

    def flatten(
        self,
        cloud: FloatArray,
        stamp_ns: int,
        floor_m: float | None = None,
        times_s: FloatArray | None = None,
    ) -> PlanarScan:
        """The planar scan, seen from the lidar's place, of points (N, 3) in the base frame.

        `floor_m` is the height of the floor in this cloud, if it was found, `times_s` (N,) seconds
        after the stamp.
        """
        dx, dy = cloud[:, 0] - self.mount.x, cloud[:, 1] - self.mount.y
        distance = np.hypot(dx, dy)
        turn = np.arctan2(dy, dx) / _FULL_CIRCLE + 0.5  # [0, 1] from -pi to pi
        if not len(self._bearings):
            self._choose_bearings(turn[distance > 0.0])
        beams = len(self._seen)
        bins = _bins(turn, beams, self._shift)
        self._seen[bins[distance > 0.0]] = True
        inside = self._in_band(cloud, distance, floor_m)
        inside &= (distance > 0.0) & (distance <= CLOUD_RANGE_MAX_M)
        ranges = np.where(self._seen, np.inf, np.nan)
        nearest = np.full(beams, np.inf)
        np.minimum.at(nearest, bins[inside], distance[inside])
        ranges[np.isfinite(nearest)] = nearest[np.isfinite(nearest)]
        return PlanarScan(
            stamp_ns=stamp_ns,
            bearings=self._bearings,
            ranges=ranges,
            range_max=CLOUD_RANGE_MAX_M,
            full_circle=bool(self._seen.mean() >= _CLOUD_FILLED_SHARE),
            beam_times_s=_beam_times(bins, times_s, beams) if self._planar else None,
        )

    def _in_band(self, cloud: FloatArray, distance: FloatArray, floor_m: float | None) -> BoolArray:
        """Which points (N, 3) are of the heights that count."""
        if self._planar:
            return np.ones(len(cloud), dtype=bool)
        height = cloud[:, 2] - (self._first_floor(cloud, distance) if floor_m is None else floor_m)
        return (height >= self.config.band_min_m) & (height <= self.config.band_max_m)

    def _first_floor(self, cloud: FloatArray, distance: FloatArray) -> float:
        """The floor's height where it is known once for all, or taken from the first cloud."""
        if self._floor is None:
            near = cloud[distance <= FLOOR_RADIUS_M]
            self._floor = lowest_returns(near, _FLOOR_PERCENTILE)
        return self._floor

    def _choose_bearings(self, turn: FloatArray) -> None:
        """Settle on the bearings from the first cloud's returns at any height."""
        for halvings in range(_MAX_HALVINGS + 1):
            beams = _CLOUD_BEAMS >> halvings
            self._shift = _phase(turn * beams) if self._planar else 0.0
            filled = np.unique(_bins(turn, beams, self._shift))
            share = _CLOUD_FILLED_SHARE
            if len(filled) and len(filled) >= share * (filled[-1] - filled[0] + 1):
                break
        bearings: FloatArray = (np.arange(beams, dtype=np.float64) + 0.5 + self._shift) * (
            _FULL_CIRCLE / beams
        ) - math.pi
        bearings.setflags(write=False)
        self._bearings, self._seen = bearings, np.zeros(beams, dtype=bool)


def _bins(turn: FloatArray, beams: int, shift: float) -> NDArray[np.intp]:
    """Of directions (N,) in [0, 1] of a turn, the numbers of the bearings nearest to them."""
    if shift:
        return np.floor(turn * beams - shift).astype(np.intp) % beams
    return np.minimum((turn * beams).astype(np.intp), beams - 1)


def _phase(steps: FloatArray) -> float:
    """Where directions (N,), in steps of the bearings, lie between two of these: -0.5 to 0.5.

    Beams as far apart as the bearings would otherwise lie on their borders, two in the one bin and
    none in the next.
    """
    angles = _FULL_CIRCLE * (steps - 0.5)
    return math.atan2(float(np.sin(angles).sum()), float(np.cos(angles).sum())) / _FULL_CIRCLE


def _beam_times(
    bins: NDArray[np.intp], times_s: FloatArray | None, beams: int
) -> FloatArray | None:
    """Times (beams,) of all beams by those (N,) of points in the bins (N,), None without any."""
    if times_s is None or not len(bins):
        return None
    order = np.argsort(bins, kind="stable")
    times: FloatArray = np.interp(np.arange(beams), bins[order], times_s[order])
    return times


def lowest_returns(cloud: FloatArray, percentile: float) -> float:
    """Height below which a `percentile` of a cloud (N, 3) lies; 0 when it is empty."""
    return float(np.percentile(cloud[:, 2], percentile)) if len(cloud) else 0.0

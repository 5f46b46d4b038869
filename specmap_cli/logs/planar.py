"""From laser scans and clouds to `PlanarScan`: level, bearings ascending, one meaning of ranges.

A range is finite where there was a return, +inf where the beam met nothing, NaN where nothing is
known. Readings below the laser's minimum are invalid; those of 0 m, of the laser's maximum range
and beyond mean no return, whatever the driver's convention, and so does what `Ceiling` finds.
Readings of the robot itself, which `OwnBody` finds, are invalid.

Bearings and ranges are the single-precision numbers nearest to those that a laser can mean. What
lies below comes from how a recording was written, and would make another map of the same scans.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, moved, yaw_of
from specmap_cli.core.records import BoolArray, IntArray, PlanarScan, Sweep
from specmap_cli.logs.messages import BadMessageError, ScanLayout, ScanRecord

SCAN_TIME_MAX_S = 1.0  # a planar sweep that takes longer has its times in another unit
_MISSING_BEAMS = 1.5  # of a full circle: its last beam stops one short of the first, and rounding
MOST_BEAMS = 3600  # of a scan: a tenth of a degree; of more, every second or later one is read
_RANGE_DECIMALS = 4  # metres: a tenth of the least step of the ranges of a laser
# What a laser can mean: a round number of degrees between beams and in the middle of its view, or a
# power of two of beams in a circle.
_MIDDLE_RAD, _STEP_RAD = math.radians(1e-4), math.radians(5e-7)


class _Beams(NamedTuple):
    """Bearings and times (B,) of the beams, and which of the readings as recorded they are."""

    bearings: FloatArray
    times_s: FloatArray | None
    used: slice
    full_circle: bool


class ScanLeveller:
    """Turns the scans of one laser into `PlanarScan`; keeps what they have in common.

    `base_from_laser` (4, 4) is its mounting. A laser upside down is described by the level frame
    that shares its x axis, in which its bearings have the opposite sign.
    """

    def __init__(
        self,
        base_from_laser: FloatArray,
        ceiling: Ceiling | None = None,
        own_body: OwnBody | None = None,
    ) -> None:
        x, y = float(base_from_laser[0, 3]), float(base_from_laser[1, 3])
        self.mount = Pose2(x, y, yaw_of(base_from_laser))
        self.ceiling = Ceiling() if ceiling is None else ceiling
        self.own_body = OwnBody() if own_body is None else own_body
        self._upside_down = bool(base_from_laser[2, 2] < 0.0)
        self._layout: ScanLayout | None = None
        self._beams: _Beams | None = None

    @np.errstate(all="ignore")  # damaged messages hold any bits
    def level(self, scan: ScanRecord, stamp_ns: int) -> PlanarScan:
        """The planar scan; raises BadMessageError for one without beams or without angles."""
        if self._beams is None or scan.layout != self._layout:
            self._beams = _beams(scan.layout, self._upside_down)
            self._layout = scan.layout
        bearings, times_s, used, full_circle = self._beams
        range_max = scan.range_max if scan.range_max > 0.0 else math.inf
        ranges = scan.ranges[used].astype(np.float64)
        nothing = (ranges == 0.0) | (ranges >= range_max)
        ranges[(ranges < scan.range_min) | (ranges < 0.0)] = np.nan
        ranges[nothing] = np.inf
        self.ceiling.clear(ranges)
        self.own_body.clear(ranges)
        return PlanarScan(
            stamp_ns=stamp_ns,
            bearings=bearings,
            ranges=np.round(ranges, _RANGE_DECIMALS).astype(np.float32).astype(np.float64),
            range_max=range_max,
            full_circle=full_circle,
            beam_times_s=times_s,
        )


def _beams(layout: ScanLayout, upside_down: bool) -> _Beams:
    """The bearings of a laser, its beam times and which readings are used, in which order."""
    count, step = layout.beams, increment(layout)
    full_circle = covers_circle(count, step)
    if full_circle:  # the last beams may look where the first ones did
        count = min(count, round(math.tau / abs(step)))
    if upside_down:
        layout, step = replace(layout, angle_min=-layout.angle_min), -step
    stride = -(-count // MOST_BEAMS)
    numbers = np.arange(0, count, stride, dtype=np.float64)
    half, ascending = (count - 1) / 2.0, step > 0.0 or count == 1
    middle = np.round((layout.angle_min + half * step) / _MIDDLE_RAD)  # the same from either end
    between = _STEP_RAD * round(abs(step) / _STEP_RAD) or abs(step)
    first = float(np.float32(_MIDDLE_RAD * middle - half * between))
    if not math.isfinite(first):
        raise BadMessageError("a scan without angles")
    bearings: FloatArray = first + float(np.float32(between)) * numbers
    bearings.setflags(write=False)
    used = slice(0, count, stride) if ascending else slice(count - 1, None, -stride)
    sweep = layout.time_increment * (count - 1)
    timed = 0.0 < sweep <= SCAN_TIME_MAX_S
    turns = numbers if ascending else count - 1 - numbers
    times: FloatArray | None = layout.time_increment * turns if timed else None
    return _Beams(bearings=bearings, times_s=times, used=used, full_circle=full_circle)


def covers_circle(beams: int, step: float) -> bool:
    """Whether so many beams, an angle apart, look all around; one does not, whatever its angle."""
    return beams > 1 and beams * abs(step) >= math.tau - _MISSING_BEAMS * abs(step)


def increment(layout: ScanLayout) -> float:
    """The angle from beam to beam; raises BadMessageError for a scan without beams or angles."""
    count, step = layout.beams, layout.angle_increment
    if count == 0:
        raise BadMessageError("a scan without beams")
    if not (math.isfinite(step) and step != 0.0) and count > 1:
        step = (layout.angle_max - layout.angle_min) / (count - 1)
    if not (math.isfinite(layout.angle_min) and math.isfinite(step)) or (count > 1 and not step):
        raise BadMessageError("a scan without angles")
    if count > 1 and abs(step) > math.tau:
        raise BadMessageError("a scan whose beams are more than a circle apart")
    return step


def changed_share(ranges: FloatArray, before: FloatArray, least_m: float) -> float:
    """The share of readings (B,) that differ from those before (B,) by more than `least_m`.

    A return where there was none is a difference, an invalid reading (NaN) is not.
    """
    with np.errstate(invalid="ignore"):  # inf - inf: no return then and now
        changed = np.abs(ranges - before) > least_m
    return float(changed.mean()) if len(changed) else 0.0


_BEAMS = 3  # of a scan that share its longest distance; of walls one does, or two
_PLACES = 4  # from which it was read: a robot that stands may see one wall again and again
_ELSEWHERE_M, _ELSEWHERE_SHARE = 0.1, 0.3  # readings that change so, and how many, when it drives


class Ceiling:
    """Finds a distance that stands for no return although it is below the maximum of the scans.

    Some drivers give a constant for it, such as 8.19 m where the scans claim 30 m, and some formats
    do not tell the maximum. Taken for walls, such readings are an arc around the robot that goes
    with it, and scan matching finds that it stands still. No wall looks like that: several beams
    read the longest distance of all, to the last bit, and do so again when the robot is elsewhere.
    Call `clear` for each scan of one laser in turn.

    `values_m` are those found so far; of the readings of a scan, `cleared` were one of them.
    """

    def __init__(self, values_m: Iterable[float] = ()) -> None:
        self.values_m = tuple(values_m)
        self.cleared = 0
        self._longest = max(self.values_m, default=0.0)
        self._places = 0
        self._there: FloatArray = np.zeros(0)  # the scan at the last of these places

    def clear(self, ranges: FloatArray) -> None:
        """Set the readings (B,) that are one of these distances to +inf, in place."""
        longest = float(ranges[np.isfinite(ranges)].max(initial=0.0))
        if longest > self._longest:
            self._longest, self._places = longest, 0
        if (
            longest == self._longest
            and longest not in self.values_m
            and np.count_nonzero(ranges == longest) >= _BEAMS
        ):
            is_new = not self._places or len(ranges) != len(self._there)
            if is_new or changed_share(ranges, self._there, _ELSEWHERE_M) >= _ELSEWHERE_SHARE:
                self._places += 1
                self._there = ranges.copy()
            if self._places >= _PLACES:
                self.values_m = (*self.values_m, longest)
        for value in self.values_m:
            alike = ranges == value
            self.cleared += int(np.count_nonzero(alike))
            ranges[alike] = np.inf

    @property
    def notes(self) -> list[str]:
        """What a user should know of it: nothing where no reading was taken for no return."""
        if not self.cleared:
            return []
        values = " m, ".join(f"{value:g}" for value in self.values_m)
        return [
            f"readings of exactly {values} m, the longest distance of all, are taken for no "
            f"return, as several beams of one scan have it again and again: {self.cleared:,}"
        ]


_NEAR_M = 0.8  # as far as a robot reaches from its laser
_SAME_M = 0.1  # what readings of the body differ by, noise of a few centimetres included
_MARGIN_M = 0.05  # beyond the readings so far: those to come differ a little more
_OWN_PLACES = 25  # at which a beam read the same
_MOVED_M, _MOVED_SHARE = 0.2, 0.5  # other beams that change so, and how many of them


class OwnBody:
    """Finds the beams of a laser that see its robot: posts, a bumper, the body beside it.

    Such beams read the same short distance wherever the robot goes. Taken for walls, they are an
    obstacle at every place where the robot was, until it looks there again; and the passes through
    one place contradict each other, though the map is right. Call `clear` for successive scans.
    """

    def __init__(self) -> None:
        self._there: FloatArray = np.zeros(0)  # the scan at the last place
        self._low: FloatArray = np.zeros(0)  # the shortest and the longest reading of each beam
        self._high: FloatArray = np.zeros(0)
        self._counts: IntArray = np.zeros(0, dtype=np.int64)  # places at which it read anything
        self._near: BoolArray = np.zeros(0, dtype=bool)  # beams that read nothing else so far
        self._seen: BoolArray = np.zeros(0, dtype=bool)  # those that read so at many places
        self._is_ruled_out = False  # every beam has read something else

    def clear(self, ranges: FloatArray) -> None:
        """Set the readings (B,) that are of the robot to NaN, in place."""
        is_new = not self._is_ruled_out
        if len(ranges) != len(self._there):
            self._low, self._high = np.full((2, len(ranges)), np.nan)
            self._counts = np.zeros(len(ranges), dtype=np.int64)
            is_new = True
        elif is_new:  # where most beams that see no robot read other distances
            others = ~self._near & ~(np.isnan(ranges) | np.isnan(self._there))
            changed = changed_share(ranges[others], self._there[others], _MOVED_M)
            is_new = changed >= _MOVED_SHARE
        if is_new:
            self._there = ranges.copy()
            read = np.where(np.isfinite(ranges), ranges, np.nan)
            self._low, self._high = np.fmin(self._low, read), np.fmax(self._high, read)
            self._counts += np.isfinite(ranges)
            self._near = (self._high < _NEAR_M) & (self._high - self._low <= _SAME_M)
            self._seen = self._near & (self._counts >= _OWN_PLACES)
            self._is_ruled_out = not (self._near | np.isnan(self._low)).any()
        if self._seen.any():  # and what is near it, on these beams and those beside: edges flicker
            low = _of_neighbours(np.where(self._seen, self._low, np.inf), np.minimum)
            high = _of_neighbours(np.where(self._seen, self._high, -np.inf), np.maximum)
            ranges[(ranges >= low - _MARGIN_M) & (ranges <= high + _MARGIN_M)] = np.nan

    @property
    def notes(self) -> list[str]:
        """What a user should know of it: nothing while no beam sees the robot."""
        if not self._seen.any():
            return []
        low, high = float(self._low[self._seen].min()), float(self._high[self._seen].max())
        return [
            f"beams that read the same {low:.2f} to {high:.2f} m wherever the robot goes, which is "
            f"the robot itself: {np.count_nonzero(self._seen):,}; these readings are left out"
        ]


def _of_neighbours(values: FloatArray, least: np.ufunc) -> FloatArray:
    """Each value (B,) or the ones beside it, by their minimum or maximum."""
    spread = values.copy()
    spread[1:] = least(spread[1:], values[:-1])
    spread[:-1] = least(spread[:-1], values[1:])
    return spread


# Odometry of a robot that stands still may tremble by this. Where it does, what repeats the scan
# before says nothing new either.
_STILL_M, _STILL_RAD = 0.02, math.radians(1.0)
HUNG = (
    "{} repeat the one before although odometry says that the robot moved, and were left out: the "
    "driver of the laser hung"
)


@dataclass(slots=True)
class Repeats:
    """Finds scans that repeat the one before them although odometry says that the robot moved.

    The driver of a laser that hangs repeats one scan while the robot drives on. The noise of a
    laser makes two scans with the same readings unlikely even where nothing moves.
    """

    _ranges: FloatArray = field(default_factory=lambda: np.zeros(0))
    _from: Pose2 | None = None  # where odometry had the robot at the first of those alike

    def stale(self, sweep: Sweep) -> bool:
        """Whether a scan is one that hangs; call for successive scans. Blank ones never are."""
        ranges, pose = sweep.planar.ranges, sweep.odom_from_base
        alike = np.array_equal(ranges, self._ranges, equal_nan=True)
        if not alike or not np.isfinite(ranges).any():
            self._ranges, self._from = ranges, pose
            return False
        if pose is None or self._from is None:
            return False
        return moved(self._from, pose, _STILL_M, _STILL_RAD)

"""Points and point times out of a PointCloud2, whatever its layout."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.messages import CloudRecord
from specmap_cli.logs.readers.typestore import NS_PER_S

_CLOUD_TIME_MAX_S = 10.0  # times of points farther from the stamp are of no use
CLOUD_RANGE_MAX_M = 100.0  # a 3D cloud is cut here

# Velodyne, LSLidar: time; Ouster: t; Hesai, RoboSense, Livox: timestamp; Livox: offset_time;
# Autoware: time_stamp; Aeva: time_offset_ns; Blickfeld: point_time_offset; Cepton: the last one.
TIME_FIELDS = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "offset_time",
    "time_offset",
    "time_offset_ns",
    "point_time_offset",
    "relative_timestamp",
)
_FLOAT_UNITS_NS = (1_000_000_000, 1_000_000, 1_000, 1)  # seconds, and thousandths of the one before
_INTEGER_UNITS_NS = (1_000, 1)
_SHORTEST_NS, _LONGEST_NS = 2_000_000, 2_000_000_000  # of a sweep: one unit fits, as each is 1,000
_ENOUGH_POINTS = 100  # a sweep of fewer may be a sliver, whose span misleads


class CloudPoints(NamedTuple):
    """Points (N, 3) in the lidar's frame and seconds (N,) after the stamp, or None.

    `far_times` says that there were times, but farther from the stamp than `_CLOUD_TIME_MAX_S`.
    """

    points: FloatArray
    times_s: FloatArray | None
    far_times: bool


class PointClock:
    """What the point times of a lidar are: their unit, and whether its clock is that of the stamps.

    The unit is the one by which a sweep takes between 2 ms and 2 s; the first full sweep settles
    it. `foreign` counts the sweeps whose times are of another clock than their stamps.
    """

    def __init__(self) -> None:
        self.foreign = 0
        self._unit_ns: int | None = None

    def unit_ns(self, span: float, count: int, *, integers: bool) -> int:
        """Nanoseconds in one unit of `count` times that span so many units."""
        if self._unit_ns is not None:
            return self._unit_ns
        units = _INTEGER_UNITS_NS if integers else _FLOAT_UNITS_NS
        fits = [unit for unit in units if _SHORTEST_NS <= span * unit < _LONGEST_NS]
        if fits and count >= _ENOUGH_POINTS:
            self._unit_ns = fits[0]
        brief = not integers and span * NS_PER_S < _LONGEST_NS
        return fits[0] if fits else NS_PER_S if brief else 1


@np.errstate(all="ignore")  # damaged messages hold any bits
def cloud_points(
    record: CloudRecord, stamp_ns: int, clock: PointClock | None = None
) -> CloudPoints:
    """The points of a cloud, with their times where de-skewing can rely on them.

    Points that are not finite, at the very origin (how some drivers say "no return") or beyond
    `CLOUD_RANGE_MAX_M` are left out, with their times. Times are None unless they are all finite,
    differ, and lie within `_CLOUD_TIME_MAX_S` of the stamp. Times of another clock, far from the
    stamp but near to each other, count from the earliest. `clock` keeps what is known of the lidar.
    """
    clock = PointClock() if clock is None else clock
    table = record.points.reshape(-1)
    points = np.empty((len(table), 3))
    for column, axis in enumerate("xyz"):
        points[:, column] = table[axis]
    squared = np.einsum("ij,ij->i", points, points)
    usable = (squared > 0.0) & (squared <= CLOUD_RANGE_MAX_M**2)  # false for NaN as well
    kept = slice(None) if usable.all() else np.flatnonzero(usable)
    recorded = _times(record.points.dtype, table, stamp_ns, clock)
    times = recorded[kept] if recorded is not None else np.zeros(0)
    span = float(np.ptp(times)) if len(times) and np.isfinite(times).all() else 0.0
    told = span > 0.0
    far = told and float(np.abs(times).max()) > _CLOUD_TIME_MAX_S
    if far and span <= min(_CLOUD_TIME_MAX_S, _LONGEST_NS / NS_PER_S):
        clock.foreign += 1
        times, far = times - times.min(), False
    return CloudPoints(
        points=points[kept], times_s=times if told and not far else None, far_times=far
    )


def _times(
    layout: np.dtype[np.void], table: NDArray[np.void], stamp_ns: int, clock: PointClock
) -> FloatArray | None:
    """Seconds (N,) after the stamp as recorded, None without such a field.

    Times nearer to the stamp than to zero are absolute.
    """
    name = next((field for field in layout.names or () if field.lower() in TIME_FIELDS), None)
    if name is None or not len(table):
        return None
    raw = table[name]
    if raw.dtype.kind in "iu":
        counts = raw.astype(np.int64)
        span = float(counts.max()) - float(counts.min())
        counts = counts * clock.unit_ns(span, len(counts), integers=True)
        absolute = abs(int(counts[0]) - stamp_ns) < abs(int(counts[0]))
        return np.asarray((counts - stamp_ns if absolute else counts) / NS_PER_S)
    values = raw.astype(np.float64)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    span = float(finite.max() - finite.min())
    unit = clock.unit_ns(span, len(values), integers=False) / NS_PER_S
    stamp = stamp_ns / (NS_PER_S * unit)
    absolute = abs(finite[0] - stamp) < abs(finite[0])
    return np.asarray((values - stamp if absolute else values) * unit)

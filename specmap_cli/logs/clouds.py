"""Points and point times out of a PointCloud2, whatever its layout."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.messages import CloudRecord
from specmap_cli.logs.readers.typestore import NS_PER_S

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_SECONDS_SPAN_MAX = 2.0  # floats that span more count nanoseconds, of which a sweep has millions


class CloudPoints(NamedTuple):
    """Points (N, 3) in the lidar's frame and seconds (N,) after the stamp, or None.

    `far_times` says that there were times, but farther from the stamp than the settings allow.
    """

    points: FloatArray
    times_s: FloatArray | None
    far_times: bool


@np.errstate(all="ignore")  # damaged messages hold any bits
def cloud_points(record: CloudRecord, stamp_ns: int, config: LogConfig) -> CloudPoints:
    """The points of a cloud, with their times where de-skewing can rely on them.

    Points that are not finite, at the very origin (how some drivers say "no return") or beyond
    `cloud_range_max_m` are left out, with their times. Times are None unless they are all finite,
    differ, and lie within `cloud_time_max_s` of the stamp.
    """
    table = record.points.reshape(-1)
    points = np.column_stack([table[axis].astype(np.float64) for axis in "xyz"])
    squared = np.einsum("ij,ij->i", points, points)
    kept = (squared > 0.0) & (squared <= config.cloud_range_max_m**2)  # false for NaN as well
    recorded = _times(record.points.dtype, table, stamp_ns)
    times = recorded[kept] if recorded is not None else np.zeros(0)
    told = len(times) > 0 and bool(np.isfinite(times).all()) and float(np.ptp(times)) > 0.0
    far = told and float(np.abs(times).max()) > config.cloud_time_max_s
    return CloudPoints(
        points=points[kept], times_s=times if told and not far else None, far_times=far
    )


def _times(layout: np.dtype[np.void], table: NDArray[np.void], stamp_ns: int) -> FloatArray | None:
    """Seconds (N,) after the stamp as recorded, None without such a field.

    Integers are nanoseconds; other numbers are seconds unless they span too much for it. Times
    nearer to the stamp than to zero are absolute.
    """
    name = next((field for field in layout.names or () if field.lower() in TIME_FIELDS), None)
    if name is None or not len(table):
        return None
    raw = table[name]
    if raw.dtype.kind in "iu":
        counts = raw.astype(np.int64)
        absolute = abs(int(counts[0]) - stamp_ns) < abs(int(counts[0]))
        return np.asarray((counts - stamp_ns if absolute else counts) / NS_PER_S)
    values = raw.astype(np.float64)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    unit = 1.0 if finite.max() - finite.min() <= _SECONDS_SPAN_MAX else 1.0 / NS_PER_S
    stamp = stamp_ns / (NS_PER_S * unit)
    absolute = abs(finite[0] - stamp) < abs(finite[0])
    return np.asarray((values - stamp if absolute else values) * unit)

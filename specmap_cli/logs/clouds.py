"""Points and point times out of a PointCloud2, whatever its layout."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.messages import CloudRecord
from specmap_cli.logs.readers.typestore import NS_PER_S

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_LONGEST_SWEEP_S = 2.0  # times that span more are nanoseconds
_FARTHEST_S = 10.0  # times further from the stamp are not of this sweep


@np.errstate(all="ignore")  # damaged messages hold any bits
def cloud_points(
    record: CloudRecord, stamp_ns: int, range_max: float
) -> tuple[FloatArray, FloatArray | None]:
    """Points (N, 3) in the lidar's frame, and seconds (N,) after `stamp_ns` or None.

    Points that are not finite, at the very origin (how some drivers say "no return") or beyond
    `range_max` are left out, with their times. Times are None unless they are all finite, differ,
    and lie near the stamp.
    """
    table = record.points.reshape(-1)
    points = np.column_stack([table[axis].astype(np.float64) for axis in "xyz"])
    squared = np.einsum("ij,ij->i", points, points)
    kept = (squared > 0.0) & (squared <= range_max**2)  # false for NaN as well
    times = _times(record.points.dtype, table, stamp_ns)
    return points[kept], _usable(times[kept]) if times is not None else None


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
    unit = 1.0 if finite.max() - finite.min() <= _LONGEST_SWEEP_S else 1.0 / NS_PER_S
    stamp = stamp_ns / (NS_PER_S * unit)
    absolute = abs(finite[0] - stamp) < abs(finite[0])
    return np.asarray((values - stamp if absolute else values) * unit)


def _usable(times: FloatArray) -> FloatArray | None:
    """The times if de-skewing can rely on them, else None."""
    if not len(times) or not np.isfinite(times).all():
        return None
    if np.ptp(times) <= 0.0 or np.abs(times).max() > _FARTHEST_S:
        return None
    return times

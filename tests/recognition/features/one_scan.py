"""Features of a single scan, of which the functions of a set make a batch of one."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features.returns import Returns, ReturnsBatch
from specmap_cli.recognition.features.shape import boundary

Function = Callable[[ReturnsBatch], FloatArray]
RANGE_MAX_M = 30.0

readings = st.lists(
    st.one_of(st.floats(0.0, 40.0), st.sampled_from([math.inf, math.nan, RANGE_MAX_M, 0.0])),
    max_size=40,
)


def scan_of(ranges: FloatArray, full: bool = True, turn: float = 0.0) -> PlanarScan:
    """A scan all round, or of half a circle, by a laser that is turned."""
    span = np.linspace(-np.pi, np.pi, len(ranges), endpoint=False)
    bearings = (span if full else span / 2.0) + turn
    return PlanarScan(0, bearings, np.asarray(ranges, dtype=np.float64), RANGE_MAX_M, full)


def batch_of(scan: PlanarScan) -> ReturnsBatch:
    """The returns of one scan, as functions of features take them."""
    return ReturnsBatch.of([scan])


def returns_of(scan: PlanarScan) -> Returns:
    """The returns of one scan, as groups of other packages are given them."""
    return batch_of(scan)[0]


def of_one(function: Function, batch: ReturnsBatch) -> list[float]:
    """The values of the first scan of a batch."""
    return [float(value) for value in function(batch)[0]]


def boundary_of(batch: ReturnsBatch) -> tuple[FloatArray, FloatArray, float]:
    """Points (K, 2), normals (K, 2) and length of the boundary of a batch of one."""
    _, points, lengths = boundary(batch)
    return points[:2].T, points[2:].T, float(lengths[0])

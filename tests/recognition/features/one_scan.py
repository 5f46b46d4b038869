"""Features of a single scan, of which the functions of a set make a batch of one."""

from __future__ import annotations

from collections.abc import Callable

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features.point_pairs import boundary
from specmap_cli.recognition.features.returns import Returns, ReturnsBatch

Function = Callable[[ReturnsBatch], FloatArray]


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

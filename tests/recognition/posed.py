"""Scans at poses."""

from __future__ import annotations

from typing import Any

import numpy as np

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan

EMPTY = PlanarScan(0, np.zeros(0), np.zeros(0), 10.0, full_circle=True)


def posed(
    planar: PlanarScan,
    map_from_base: Pose2,
    number: int = 0,
    base_from_laser: Pose2 = IDENTITY,
    **more: Any,
) -> PosedScan:
    """A scan at a pose; `number` is its place in the log."""
    return PosedScan(
        index=number,
        stamp_ns=number,
        map_from_base=map_from_base,
        planar=planar,
        base_from_laser=base_from_laser,
        **more,
    )


def at(x: float, theta: float = 0.0, lost: bool = False) -> PosedScan:
    """A scan without a return, x metres along a line."""
    return posed(EMPTY, Pose2(x, 0.0, theta), lost=lost)

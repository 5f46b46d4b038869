"""Scans of a robot on a line, of which only the pose matters."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan

EMPTY = PlanarScan(0, np.zeros(0), np.zeros(0), 10.0, full_circle=True)


def at(x: float, theta: float = 0.0, lost: bool = False) -> PosedScan:
    """A scan without a return, x metres along the line."""
    return PosedScan(
        index=0,
        stamp_ns=0,
        map_from_base=Pose2(x, 0.0, theta),
        planar=EMPTY,
        base_from_laser=IDENTITY,
        lost=lost,
    )

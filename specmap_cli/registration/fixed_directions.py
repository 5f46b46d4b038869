"""Which directions the walls in sight fix, so that a registration says something about odometry."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.matching import observability
from specmap_cli.registration.reliance import direction_of

# Information along a direction, beside the most in any. Noise of the ranges turns the normals of
# bare walls by some 0.1 rad and makes 0.01 of it; a wall across a corridor makes more than this.
_LEAST_SHARE = 0.05
_UNIT_NOISE_M = 1.0  # only ratios count, and heading against place at this arm


def fixed_directions(scan: PlanarScan, base_from_laser: Pose2, motion: Pose2) -> tuple[bool, bool]:
    """Whether a scan's walls fix the place along a motion that ends there, and across it."""
    fisher = observability(base_from_laser.apply(scan.hits()), _UNIT_NOISE_M)
    arm, moment = fisher[:2, 2], float(fisher[2, 2])
    place = fisher[:2, :2] - np.outer(arm, arm) / moment if moment > 0.0 else fisher[:2, :2]
    most = float(np.trace(place))
    x, y = direction_of(motion)
    along, across = np.array([x, y]), np.array([-y, x])
    shares = [float(way @ place @ way) for way in (along, across)]
    return shares[0] > _LEAST_SHARE * most, shares[1] > _LEAST_SHARE * most

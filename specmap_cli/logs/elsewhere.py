"""Whether a robot has moved, by nothing but what its laser reads."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray


def changed_share(ranges: FloatArray, before: FloatArray, least_m: float) -> float:
    """The share of readings (B,) that differ from those before (B,) by more than `least_m`.

    A return where there was none is a difference, an invalid reading (NaN) is not.
    """
    with np.errstate(invalid="ignore"):  # inf - inf: no return then and now
        changed = np.abs(ranges - before) > least_m
    return float(changed.mean()) if len(changed) else 0.0

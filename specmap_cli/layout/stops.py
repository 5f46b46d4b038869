"""Places along the path to look around at."""

from __future__ import annotations

from specmap_cli.core.geometry import FloatArray


def stops(path: FloatArray, every_m: float) -> list[int]:
    """Rows of a path (M,) to look around at: each the first that is `every_m` past the last."""
    chosen, visited_m = [], 0.0
    for row, way_m in enumerate(path.tolist()):
        if way_m - visited_m >= every_m:
            chosen.append(row)
            visited_m = way_m
    return chosen

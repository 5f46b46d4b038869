"""A stay: a piece of the path in which the robot saw one place, and what it saw of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import GridMap


@dataclass(frozen=True, kw_only=True)  # without slots: the area is computed once
class Stay:
    """What loop closure needs of a region that the robot has just left.

    The first stay in a place is a submap of its own; one that is recognised becomes part of an old
    submap. `features` (n, F) are those of its raw scans; `grid` and `track` (k, 3) are in its own
    frame. Where known, `map_from_stay` is that frame as registered and `travelled_m` the path
    driven before it (infinite across a loss of tracking): they tell twin rooms apart, and nothing
    else.
    """

    number: int
    features: FloatArray
    grid: GridMap
    track: FloatArray
    map_from_stay: Pose2 | None = None
    travelled_m: float = 0.0

    @cached_property
    def area_m2(self) -> float:
        """The free area that was seen."""
        return self.grid.free_area_m2

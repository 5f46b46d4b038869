"""A stay: a piece of the path in which the robot saw one place, and what it saw of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import GridMap, PackedGrid


@dataclass(frozen=True, kw_only=True)  # without slots: the area is computed once
class Stay:
    """What loop closure needs of a region that the robot has just left.

    The first stay in a place is a submap of its own; one that is recognised becomes part of an old
    submap. `features` (n, F) are those of its raw scans; `packed` and `track` (k, 3), its grid and
    its poses, are in its own frame. Where known, `map_from_stay` is that frame as registered and
    `travelled_m` the path driven before it (infinite across a loss of tracking): they tell twin
    rooms apart, and nothing else.
    """

    number: int
    features: NDArray[Any]
    packed: PackedGrid
    track: FloatArray
    map_from_stay: Pose2 | None = None
    travelled_m: float = 0.0

    @property
    def grid(self) -> GridMap:
        """The grid of what was seen."""
        return self.packed.grid

    @cached_property
    def area_m2(self) -> float:
        """The free area that was seen."""
        return self.grid.free_area_m2

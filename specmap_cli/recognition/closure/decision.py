"""What a match of two stays is worth: nothing, a constraint between two frames, or one submap.

A match must be as good as the grids demand, and tracking must not rule it out. Drift grows along
the way. Where the grids of two stays match just where tracking has them, it had not drifted between
these two, however long the way; what may have drifted is the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.gridmap import GridMap, PackedGrid
from specmap_cli.recognition.closure.verification import (
    MIN_LEAD,
    MIN_WALL_M,
    Check,
    tracks_overlap,
)

_MERGE_OVERLAP = 0.4  # shared part of both tracks, for a merge
_MERGE_REACH_M = 1.0  # tracks this close overlap
_TWIN_MARGIN_M = 0.5  # a match that mends so much more than drift explains is of twin rooms

# Rooms have right angles: a wrong match is turned by a quarter or by half. Tracking is not, unless
# it turned a little with every metre of a long way.
_MOST_TURN_RAD, _TURN_RAD_PER_M = math.pi / 4, 0.001


@dataclass(frozen=True, kw_only=True)  # without slots: the area is computed once
class Stay:
    """What loop closure needs of a region that the robot has just left: a piece of its path.

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

    def tracked_from(self, other: Stay) -> Pose2 | None:
        """This stay's frame from another one's as both were tracked; None where that is unknown."""
        if self.map_from_stay is None or other.map_from_stay is None:
            return None
        return self.map_from_stay.inverse() @ other.map_from_stay


class Decision(NamedTuple):
    """Whether the grids match, whether they are of one submap, and why or why not."""

    verified: bool
    merged: bool
    reason: str


NO_WALLS = Decision(False, False, "a grid shows too few walls to match")


def decide(
    old: Stay, new: Stay, check: Check | None, way_m: float, config: RecognitionConfig
) -> Decision:
    """What the best match of two stays' grids is worth; `check` None is no match at all.

    `way_m` is that between the stays on which tracking may have drifted.
    """
    if check is None or check.score < config.min_score:
        return Decision(False, False, "the grids do not match")
    if check.confirmed_m < MIN_WALL_M:
        return Decision(False, False, "too little wall matches")
    if not check.overlaps:
        return Decision(False, False, "the grids overlap too little")
    if check.lead < MIN_LEAD:
        return Decision(False, False, "ambiguous: the grids match in more than one way")
    if not plausible(old, new, check.old_from_new, way_m, config):
        return Decision(False, False, "ambiguous: looks the same but is too far away, a twin")
    shared = tracks_overlap(old.track, new.track, check.old_from_new, _MERGE_REACH_M)
    if shared < _MERGE_OVERLAP:
        return Decision(True, False, "the grids match, the robot's tracks do not overlap")
    return Decision(True, True, "the grids match and the tracks overlap")


def mended_m(old: Stay, new: Stay, old_from_new: Pose2) -> float:
    """How far tracking was off where the new stay begins if a match is right; 0 if unknown."""
    expected = old.tracked_from(new) or old_from_new
    return math.hypot(expected.x - old_from_new.x, expected.y - old_from_new.y)


def plausible(
    old: Stay, new: Stay, old_from_new: Pose2, way_m: float, config: RecognitionConfig
) -> bool:
    """Whether registration can have drifted, on a way, as far as a merge would say it has."""
    expected = old.tracked_from(new) or old_from_new
    turned_rad = abs(wrap_angle(expected.theta - old_from_new.theta))
    # not to be turned round: a way of NaN says nothing
    return not (
        mended_m(old, new, old_from_new) > _TWIN_MARGIN_M + config.max_drift * way_m
        or turned_rad > _MOST_TURN_RAD + _TURN_RAD_PER_M * way_m
    )


class DriftGraph:
    """The ways between stays, cut short by the matches that confirmed them."""

    def __init__(self, config: RecognitionConfig) -> None:
        self.config = config
        # two places along the way each, and the metres that part them
        self._ties: list[tuple[float, float, float]] = []

    def confirm(self, old: Stay, new: Stay, mended_m: float) -> None:
        """The grids of two stays match `mended_m` from where tracking has them.

        As far as that is no twin whatever the way, they are as near as the way on which drift makes
        as much. A match that cuts no way short is not kept: a robot that patrols makes many.
        """
        ends = old.travelled_m, new.travelled_m
        known = old.tracked_from(new) is not None and all(map(math.isfinite, ends))
        if known and mended_m <= _TWIN_MARGIN_M:
            drift = self.config.max_drift
            metres = mended_m / drift if drift > 0.0 else 0.0
            if metres < self.between(old, new):
                self._ties.append((*ends, metres))

    def between(self, old: Stay, new: Stay) -> float:
        """Metres of the shortest way between two stays; not finite across a loss of tracking."""
        start, end = old.travelled_m, new.travelled_m
        if not self._ties or not (math.isfinite(start) and math.isfinite(end)):
            return abs(end - start)
        places = sorted({start, end, *(place for tie in self._ties for place in tie[:2])})
        number = {place: k for k, place in enumerate(places)}
        metres = {(k, k + 1): b - a for k, (a, b) in enumerate(pairwise(places))}
        for a, b, tied_m in self._ties:
            i, j = sorted((number[a], number[b]))
            metres[i, j] = min(tied_m, metres.get((i, j), math.inf))
        ends = np.array(list(metres), dtype=np.int32).T  # csgraph wants 32 bits
        graph = csr_array((list(metres.values()), tuple(ends)), shape=(len(places), len(places)))
        return float(dijkstra(graph, directed=False, indices=number[start])[number[end]])

"""What a match of two grids is worth: nothing, a constraint between two frames, or one submap."""

from __future__ import annotations

import math
from dataclasses import dataclass

from specmap_cli.core.geometry import Pose2, wrap_angle
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.closure.stay import Stay
from specmap_cli.recognition.closure.verification import (
    LEAST_OVERLAP,
    MIN_LEAD,
    MIN_OVERLAP,
    MIN_WALL_M,
    Check,
    tracks_overlap,
)

_MERGE_OVERLAP = 0.4  # shared part of both tracks, for a merge
_MERGE_REACH_M = 1.0  # tracks this close overlap
TWIN_MARGIN_M = 0.5  # a match that mends so much more than drift explains is of twin rooms

# Rooms have right angles: a wrong match is turned by a quarter or by half. Tracking is not, unless
# it turned a little with every metre of a long way.
_MOST_TURN_RAD, _TURN_RAD_PER_M = math.pi / 4, 0.001


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the grids match, whether they are of one submap, and why or why not."""

    verified: bool
    merged: bool
    reason: str


NO_WALLS = Verdict(False, False, "a grid shows too few walls to match")


def verdict(
    old: Stay, new: Stay, check: Check | None, way_m: float, config: RecognitionConfig
) -> Verdict:
    """What the best match of two stays' grids is worth; `check` None is no match at all.

    `way_m` is that between the stays on which tracking may have drifted.
    """
    if check is None or check.score < config.min_score:
        return Verdict(False, False, "the grids do not match")
    if check.confirmed_m < MIN_WALL_M:
        return Verdict(False, False, "too little wall matches")
    if check.overlap < MIN_OVERLAP or check.least_overlap < LEAST_OVERLAP:
        return Verdict(False, False, "the grids overlap too little")
    if check.lead < MIN_LEAD:
        return Verdict(False, False, "ambiguous: the grids match in more than one way")
    if not plausible(old, new, check.old_from_new, way_m, config):
        return Verdict(False, False, "ambiguous: looks the same but is too far away, a twin")
    shared = tracks_overlap(old.track, new.track, check.old_from_new, _MERGE_REACH_M)
    if shared < _MERGE_OVERLAP:
        return Verdict(True, False, "the grids match, the robot's tracks do not overlap")
    return Verdict(True, True, "the grids match and the tracks overlap")


def expected_overlap(old: Stay, new: Stay, reach_m: float) -> float:
    """The smaller share of either track that passes near the other one as both were tracked.

    0 where that says nothing: poses are not known, or tracking was lost between them.
    """
    if old.map_from_stay is None or new.map_from_stay is None:
        return 0.0
    if not math.isfinite(new.travelled_m - old.travelled_m):
        return 0.0
    expected = old.map_from_stay.inverse() @ new.map_from_stay
    return tracks_overlap(old.track, new.track, expected, reach_m)


def mended_m(old: Stay, new: Stay, old_from_new: Pose2) -> float:
    """How far tracking was off where the new stay begins if a match is right; 0 if unknown."""
    if old.map_from_stay is None or new.map_from_stay is None:
        return 0.0
    expected = old.map_from_stay.inverse() @ new.map_from_stay
    return math.hypot(expected.x - old_from_new.x, expected.y - old_from_new.y)


def plausible(
    old: Stay, new: Stay, old_from_new: Pose2, way_m: float, config: RecognitionConfig
) -> bool:
    """Whether registration can have drifted, on a way, as far as a merge would say it has."""
    most_m = TWIN_MARGIN_M + config.max_drift * way_m
    # not to be turned round: a way of NaN says nothing
    return not (
        mended_m(old, new, old_from_new) > most_m
        or _mended_rad(old, new, old_from_new) > _MOST_TURN_RAD + _TURN_RAD_PER_M * way_m
    )


def _mended_rad(old: Stay, new: Stay, old_from_new: Pose2) -> float:
    """The same of the heading."""
    if old.map_from_stay is None or new.map_from_stay is None:
        return 0.0
    expected = old.map_from_stay.inverse() @ new.map_from_stay
    return abs(wrap_angle(expected.theta - old_from_new.theta))

"""Where one map lies in another: the rigid transform between two maps, or why there is none.

Claims rank pairs of submaps, grids decide, and every verified pair votes for a transform between
the maps (Section III-C). A transform is believed when several submaps of either map found it by
themselves, when what both maps saw agrees under it, and when no other explains nearly as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import FREE
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure.common_ground import CommonGround, Joint, common_ground, joints
from specmap_cli.recognition.closure.prepared import MapToAlign, PreparedGrid, PreparedMap, prepared
from specmap_cli.recognition.closure.verification import (
    CANDIDATES,
    RIVAL_M,
    RIVAL_RAD,
    differ,
    judge,
)
from specmap_cli.recognition.closure.votes import Party, likely_pairs, parties_of, votes_of

_NO_VOTE = "no submap of one map matches a submap of the other in one way only"
# Of the refinement of a candidate: from a coarse cell of the search away, then to the centimetre.
_ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M = 400, 8, 0.6
_FINE_STEPS, _FINE_SHIFT_M = 15, 0.2
_NEAR_SCORE, _FEWEST_NEAR = 0.1, 50  # of a wide field: two sigma of it, some 0.6 m
_WALLS_PER_M2 = 3.0  # of rooms, with all that stands in them; offices have two
_FLOOR_POINTS = 5000  # of the free space: its share that both saw to a hundredth

_LEAST_SCORE = 0.5  # of all that both saw; halls of other buildings that touch reach more
_MOST_ODD = 0.2  # of the walls: one room of five was rebuilt; more may be another floor
_LEAST_AREA_M2, _LEAST_WALLS_M = 10.0, 10.0  # a small room: less says nothing about a building
_MOST_RIVAL = 0.6  # of the walls that the best transform explains: look-alike rows come near it
_LEAST_PARTY = 3  # submaps that speak for a transform by themselves: two offices look alike
# With fewer: as much as a floor of a house, and nothing else like it.
_LARGE_M2, _LARGE_WALLS_M, _LARGE_RIVAL = 100.0, 100.0, 0.3
_MOST_RESIDUAL_M = 0.25  # half of what a submap may lie off: by chance it lies anywhere in there


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Where a new map lies in an old one.

    `old_from_new` is between the map frames, None when it is not sure; `reason` says why, in words.
    `joints` are the pairs of submaps that match under it. `votes` of these had found it by
    themselves, for `party` submaps of either map. `ground` is what both maps saw under the best
    transform there was, `area_m2` the free space that both saw, `rival` how much of its walls
    another transform explains, in [0, 1], of those that are not clearly worse.
    """

    old_from_new: Pose2 | None
    reason: str
    joints: tuple[Joint, ...] = ()
    votes: int = 0
    party: int = 0
    ground: CommonGround | None = None
    area_m2: float = 0.0
    rival: float = 0.0


def align(old: MapToAlign, new: MapToAlign, config: Config) -> Alignment:
    """The transform between two maps, or the reason why there is none.

    Submaps are matched with those that they are most like.
    """
    recognition = config.recognition
    wholes = [prepared(map_.whole) for map_ in (old, new)]
    if wholes[0] is None or wholes[1] is None:
        return Alignment(old_from_new=None, reason="a map shows too few walls to match")
    pieces = PreparedMap(old), PreparedMap(new)
    votes = votes_of(likely_pairs(old, new, CANDIDATES), *pieces, recognition)
    found = _TwoMaps(pieces, (wholes[0], wholes[1])).aligned(parties_of(votes))
    if found.old_from_new is None:
        return found
    reason = (
        f"aligned by {counted(found.party, 'submap')} of either map, "
        f"{found.area_m2:.0f} m2 are in both maps"
    )
    agreed = joints(*pieces, found.old_from_new, recognition)
    return replace(found, reason=reason, joints=agreed)


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A refined transform, the metres of wall that speak for it, and the party that found it.

    Walls count only as far as there are rooms between them: maps that touch back to back have
    straight walls in common, and nothing else. `common_m2` square metres are free in both maps.
    """

    old_from_new: Pose2
    merit_m: float
    party: Party
    common_m2: float


class _TwoMaps:
    """Two maps, the old one first: their submaps and their whole grids."""

    def __init__(
        self,
        pieces: tuple[PreparedMap, PreparedMap],
        wholes: tuple[PreparedGrid, PreparedGrid],
    ) -> None:
        self.pieces, self.wholes = pieces, wholes
        self.centre: FloatArray = wholes[1].walls.mean(axis=0)
        free = np.argwhere(pieces[1].map.whole.free)
        self._floor = pieces[1].map.whole.centres_of(evenly(free, _FLOOR_POINTS))
        self._floor_m2 = pieces[1].map.whole.free_area_m2 / max(1, len(self._floor))

    def aligned(self, parties: Sequence[Party]) -> Alignment:
        """The transform that most walls speak for, or why it is not to be believed."""
        found = [self._refined(party) for party in parties]
        ranked: list[_Candidate] = []
        for one in sorted(found, key=lambda candidate: -candidate.merit_m):
            if one.merit_m > 0.0 and all(
                differ(one.old_from_new, other.old_from_new, self.centre, RIVAL_M, RIVAL_RAD)
                for other in ranked
            ):
                ranked.append(one)
        if not ranked:
            return Alignment(old_from_new=None, reason=_NO_VOTE)
        best, *rivals = ranked
        old, new = zip(self.pieces, self.wholes, strict=True)
        told = Alignment(
            old_from_new=best.old_from_new,
            reason="",
            votes=len(best.party.votes),
            party=best.party.strength,
            ground=common_ground(old, new, best.old_from_new),
            area_m2=best.common_m2,
            rival=rivals[0].merit_m / best.merit_m if rivals else 0.0,
        )
        why_not = _why_not(told, best, rivals)
        return replace(told, old_from_new=None, reason=why_not) if why_not else told

    def _refined(self, party: Party) -> _Candidate:
        """The transform of a party, moved to where the walls of both maps fit best."""
        (old, new), pose = self.wholes, party.old_from_new
        for field, most, steps, shift_m in (
            (old.field, _ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M),
            (old.field.sharper(), len(new.walls), _FINE_STEPS, _FINE_SHIFT_M),
        ):
            near = old.wide.at(pose.apply(new.walls)) > _NEAR_SCORE
            walls = new.walls[near] if np.count_nonzero(near) >= _FEWEST_NEAR else new.walls
            points = evenly(walls, most)
            # by no more than a shift where the points are: the frame may lie far off
            x, y = points.mean(axis=0).tolist()
            found = refine(field, points - (x, y), pose @ Pose2(x, y, 0.0), steps, shift_m)
            pose = found.pose @ Pose2(-x, -y, 0.0)
        floor = self.pieces[0].map.whole.values_at(pose.apply(self._floor))
        common_m2 = float(np.count_nonzero(floor == FREE)) * self._floor_m2
        merit_m = min(judge(*self.wholes, pose).net_walls_m, _WALLS_PER_M2 * common_m2)
        return _Candidate(pose, merit_m, party, common_m2)


def _why_not(found: Alignment, best: _Candidate, rivals: Sequence[_Candidate]) -> str:
    """Why a transform is not to be believed; empty when it is."""
    ground = found.ground
    assert ground is not None
    if found.area_m2 < _LEAST_AREA_M2 or ground.confirmed_m < _LEAST_WALLS_M:
        return (
            f"the maps have too little in common: at best {found.area_m2:.0f} m2 "
            f"and {ground.confirmed_m:.0f} m of wall"
        )
    if ground.score < _LEAST_SCORE or ground.residual_m > _MOST_RESIDUAL_M:
        return (
            f"what both maps saw does not agree: where they fit best, {ground.confirmed:.0%} of "
            f"the walls are in both and {ground.contradicted:.0%} stand in free space of the other"
        ).replace("%", " %")
    if ground.at_odds > _MOST_ODD:
        return (
            f"what both maps saw does not agree everywhere: {ground.at_odds:.0%} of the walls are "
            "in submaps that do not fit: another floor of one plan, or a part that was rebuilt"
        ).replace("%", " %")
    if found.rival > _MOST_RIVAL:
        away = best.old_from_new.inverse() @ rivals[0].old_from_new
        turn = math.degrees(abs(wrap_angle(away.theta)))
        return (
            f"ambiguous: the maps fit in more than one way, {away.distance:.1f} m "
            f"and {turn:.0f} degrees apart"
        )
    large = (
        found.area_m2 >= _LARGE_M2
        and ground.confirmed_m >= _LARGE_WALLS_M
        and found.rival <= _LARGE_RIVAL
    )
    if found.party < _LEAST_PARTY and not large:
        return (
            "too few submaps were recognised: a few rooms that look alike may be of two buildings"
        )
    return ""

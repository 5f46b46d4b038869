"""Where one map lies in another: the rigid transform between two maps, or why there is none.

One argument: the walls of the one map are laid on those of the other wherever they may fit; what
both maps saw speaks for a place or against it, metre by metre; and a place is believed when enough
speaks for it and no other place, turned, elsewhere or slid along its walls, has nearly as much.

A map may come with others of the same recording, in which a stretch whose length was guessed is
longer or shorter: the place is looked for with each of them, and the places of all are rivals.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import FREE
from specmap_cli.grids.matching import refine, search_everywhere
from specmap_cli.recognition.closure.common_ground import (
    ODD,
    CommonGround,
    MapToAlign,
    PieceFit,
    SubmapWalls,
    common_ground,
)
from specmap_cli.recognition.closure.verification import (
    COARSE_M,
    CONTRADICTION_WEIGHT,
    MIN_OVERLAP,
    RIVAL_M,
    RIVAL_RAD,
    PreparedGrid,
    agreement,
    are_rivals,
    headings,
    prepared,
)

# Of the search: places of each heading that are followed, of the whole new map and of its tiles,
# since a map that shares a wing with another one fits best where most of it lies beside that.
_PLACES = 8
_TILE_M, _MOST_TILES = 16.0, 8
_FOLLOWED = 12  # of all these, to the centimetre
# Of the refinement of a candidate: from a coarse cell of the search away, then to the centimetre.
_ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M = 400, 8, 0.6
_FINE_STEPS, _FINE_SHIFT_M = 15, 0.2
_NEAR_SCORE, _FEWEST_NEAR = 0.1, 50  # of a wide field: two sigma of it, some 0.6 m
_FLOOR_POINTS = 3000  # of the free space: its share that both saw to a hundredth

# What a metre of wall that both know speaks for a place is its score less what other buildings
# reach where they fit best. Of two recordings of a place it came to 42 m and more, of two buildings
# to 16 m at most, and to 32 m of one that was mirrored.
_CHANCE, _LEAST_M = 0.3, 40.0
# Less is enough of small rooms, where that many of either map are the same: two may look alike.
_ROOMS, _LEAST_ROOMS_M = 3, 20.0
_WALLS_PER_M2 = 3.0  # of rooms, with all that stands in them: maps may touch back to back
_LEAST_SCORE = 0.6  # of all that both saw; halls of other buildings that touch reach more
_MOSTODD = 0.2  # of the walls: one room of five was rebuilt; more may be another floor
_SLID_M, _OTHER_M = 1.01 * RIVAL_M, 2.0 * RIVAL_M
_MOST_RIVAL = 0.7  # of what speaks for the best place: look-alike rows come near it
_MOST_RESIDUAL_M = 0.25  # half of what a submap may lie off: by chance it lies anywhere in there


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """A submap of the old map and one of the new map that have walls in common.

    `map_from_map` is what these say of the maps (old from new), `score` how well they agree.
    """

    old: int
    new: int
    map_from_map: Pose2
    score: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Where a new map lies in an old one.

    `old_from_new` is between the map frames, None when it is not sure; `reason` says why, in words.
    `joints` are the pairs of submaps that match under it. `evidence_m` metres of wall speak for the
    best transform there was, `rival` is the share of it that the next best has, `ground` what both
    maps saw under it, `area_m2` the free space that both saw. The stretch of the new map whose
    length was guessed is `longer_m` longer in that transform than in the map. `places` are the
    transforms that may be believed, the best first: others for which nearly as much speaks, or
    elsewhere as much as is enough alone; none when the best may not.
    """

    old_from_new: Pose2 | None
    reason: str
    joints: tuple[Joint, ...] = ()
    ground: CommonGround | None = None
    evidence_m: float = 0.0
    area_m2: float = 0.0
    rival: float = 0.0
    longer_m: float = 0.0
    places: tuple[Pose2, ...] = ()

    @property
    def submaps(self) -> int:
        """How many submaps of either map match under it: those of the map with fewer."""
        joints = self.joints
        return min(len({joint.old for joint in joints}), len({joint.new for joint in joints}))


def align(old: MapToAlign, new: MapToAlign, bent: Iterable[MapToAlign] = ()) -> Alignment:
    """The transform between two maps, or the reason why there is none.

    `bent` are the new map with other lengths of a stretch: most wall speaks for the right one.
    """
    wholes = [prepared(map_.whole) for map_ in (old, new)]
    if wholes[0] is None or wholes[1] is None:
        return Alignment(old_from_new=None, reason="a map shows too few walls to match")
    one, middle = SubmapWalls(old, wholes[0]), wholes[1].middle
    found = _Search(one.whole, wholes[1], new).ranked()
    for map_ in bent:
        whole = prepared(map_.whole)
        if whole is not None:
            found += _Search(one.whole, whole, map_).ranked()
    best, *rivals = _different(found, middle)
    taken = wholes[1] if best.new is new else prepared(best.new.whole)
    assert taken is not None  # a place was found for it
    ground = common_ground(one, SubmapWalls(best.new, taken), best.old_from_new)
    alignment = Alignment(
        old_from_new=best.old_from_new,
        reason="",
        joints=_joints(ground),
        ground=ground,
        evidence_m=best.evidence_m,
        area_m2=best.area_m2,
        rival=max(0.0, rivals[0].evidence_m / best.evidence_m) if best.evidence_m > 0.0 else 1.0,
        longer_m=best.new.longer_m,
    )
    why_not = _why_not(alignment)
    if not why_not:
        places = (best, *(one for one in rivals if _may_be(one, best, middle)))
        alignment = replace(alignment, places=tuple(one.old_from_new for one in places))
        if alignment.rival > _MOST_RIVAL:
            why_not = _ambiguous(best, rivals[0])
    if why_not:
        return replace(alignment, old_from_new=None, reason=why_not, joints=())
    told = f"{best.evidence_m:.0f} m of wall speak for it, {best.area_m2:.0f} m2 are in both maps"
    return replace(alignment, reason=f"aligned: {told}{told_length(best.new.longer_m)}")


def told_length(longer_m: float) -> str:
    """What is said of a stretch that was made longer, behind a sentence; empty for none."""
    how = f"{abs(longer_m):.1f} m {'longer' if longer_m > 0.0 else 'shorter'}"
    told = f"; the stretch whose length was guessed was made {how}, as it is in the old map"
    return told if longer_m else ""


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A transform of a map `new`, the metres of wall for it, and the free space that both saw."""

    old_from_new: Pose2
    evidence_m: float
    area_m2: float
    new: MapToAlign

    @property
    def ends(self) -> tuple[Pose2, Pose2]:
        """Where it puts what lies before and beyond a stretch, from the map as it was made."""
        longer_m, heading = self.new.longer_m, self.new.heading
        shift = Pose2(longer_m * math.cos(heading), longer_m * math.sin(heading), 0.0)
        return self.old_from_new, self.old_from_new @ shift


def _different(found: Iterable[_Candidate], middle: Pose2) -> list[_Candidate]:
    """Transforms, the best first, each of which puts an end of the new map elsewhere."""
    kept, placed = list[_Candidate](), list[list[Pose2]]()
    for one in sorted(found, key=lambda one: -one.evidence_m):
        ends = [end @ middle for end in one.ends]
        if all(any(map(are_rivals, ends, others)) for others in placed):
            kept.append(one)
            placed.append(ends)
    return kept


class _Search:
    """Where the walls of a new map may lie on those of an old one."""

    def __init__(self, old: PreparedGrid, new: PreparedGrid, map_: MapToAlign) -> None:
        self.old, self.new, self.map = old, new, map_
        free = new.grid.centres_of(np.argwhere(new.grid.free))
        self._floor = evenly(free, _FLOOR_POINTS)

    def ranked(self) -> list[_Candidate]:
        """The best transform and those that truly differ, also slid along walls; the best first."""
        rough = [self._measured(self._refined(pose, rough=True)) for pose in self._places()]
        likely = _different(rough, self.new.middle)[:_FOLLOWED]
        found = [self._measured(self._refined(one.old_from_new)) for one in likely]
        best = max(found, key=lambda one: one.evidence_m)
        for k in range(4):  # as they are: refined, they would slide back
            along = self.old.direction + k * math.pi / 2
            slid = Pose2(_SLID_M * math.cos(along), _SLID_M * math.sin(along), 0.0)
            found.append(self._measured(slid @ best.old_from_new))
        return _different(found, self.new.middle)

    def _places(self) -> Iterator[Pose2]:
        """Where the walls of the new map, or of one of its tiles, lie on walls of the old one."""
        walls, turns = self.new.walls, headings(self.old, self.new)
        number = np.unique(np.floor(walls / _TILE_M), axis=0, return_inverse=True)[1].ravel()
        tiles = [walls[number == k] for k in range(int(number.max()) + 1)]
        tiles = sorted(tiles, key=len, reverse=True)[:_MOST_TILES]
        for view in (walls, *tiles) if len(tiles) > 1 else (walls,):
            for turn in turns:
                found = search_everywhere(self.old.wide, view, _PLACES, COARSE_M, [turn])
                yield from (match.pose for match in found)

    def _refined(self, pose: Pose2, *, rough: bool = False) -> Pose2:
        """A transform moved to where the walls of both maps fit best."""
        field, walls = self.old.field.sharper(), self.new.walls
        most, steps, shift_m = len(walls), _FINE_STEPS, _FINE_SHIFT_M
        if rough:
            field = self.old.field
            most, steps, shift_m = _ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M
        near = self.old.wide.at(pose.apply(walls)) > _NEAR_SCORE
        points = evenly(walls[near] if np.count_nonzero(near) >= _FEWEST_NEAR else walls, most)
        # by no more than a shift where the points are: the frame may lie far off
        x, y = points.mean(axis=0).tolist()
        found = refine(field, points - (x, y), pose @ Pose2(x, y, 0.0), steps, shift_m)
        return found.pose @ Pose2(-x, -y, 0.0)

    def _measured(self, pose: Pose2) -> _Candidate:
        """What speaks for a transform, of the map of which less does; walls need room between."""
        known = []
        for grid, other, motion in (
            (self.new, self.old, pose),
            (self.old, self.new, pose.inverse()),
        ):
            said = agreement(other, motion.apply(grid.walls))
            each = said.confirmed - CONTRADICTION_WEIGHT * said.contradicted - _CHANCE
            known.append(said.known * len(grid.walls) * grid.metres_a_point * each)
        floor = self.old.grid.values_at(pose.apply(self._floor))
        share = float(np.mean(floor == FREE)) if len(floor) else 0.0
        area_m2 = share * self.new.grid.free_area_m2
        return _Candidate(pose, min(*known, _WALLS_PER_M2 * area_m2), area_m2, self.map)


def _why_not(found: Alignment) -> str:
    """Why a transform is not to be believed, whatever else fits; empty when it is."""
    ground = found.ground
    assert ground is not None
    score = ground.confirmed - CONTRADICTION_WEIGHT * ground.contradicted
    if score < _LEAST_SCORE or ground.residual_m > _MOST_RESIDUAL_M:
        return (
            f"what both maps saw does not agree: where they fit best, {ground.confirmed:.0%} of "
            f"the walls are in both and {ground.contradicted:.0%} stand in free space of the other"
        ).replace("%", " %")
    if ground.at_odds > _MOSTODD:
        return (
            f"what both maps saw does not agree everywhere: {ground.at_odds:.0%} of the walls are "
            "in submaps that do not fit: another floor of one plan, or a part that was rebuilt"
        ).replace("%", " %")
    if found.evidence_m < (_LEAST_M if found.submaps < _ROOMS else _LEAST_ROOMS_M):
        return (
            f"the maps have too little in common: {found.evidence_m:.0f} m of wall and "
            f"{found.area_m2:.0f} m2: a few rooms that look alike may be of two buildings"
        )
    return ""


def _may_be(rival: _Candidate, best: _Candidate, middle: Pose2) -> bool:
    """Whether another transform may be right, too: one that is slid along its walls is none.

    A map that has more in common with the wrong one of two equal rows fits better there.
    """
    away = (best.old_from_new @ middle).inverse() @ rival.old_from_new @ middle
    elsewhere = away.distance > _OTHER_M or abs(away.theta) > RIVAL_RAD
    enough = elsewhere and rival.evidence_m >= _LEAST_M
    return enough or rival.evidence_m > _MOST_RIVAL * best.evidence_m


def _ambiguous(best: _Candidate, rival: _Candidate) -> str:
    """That another transform fits as well, and how far away it is."""
    ends = zip(best.ends, rival.ends, strict=True)
    away = max((a.inverse() @ b for a, b in ends), key=lambda motion: motion.distance)
    apart = f"{away.distance:.1f} m and {math.degrees(abs(away.theta)):.0f} degrees apart"
    return f"ambiguous: the maps fit in more than one way, {apart}"


def _joints(ground: CommonGround) -> tuple[Joint, ...]:
    """Each submap that fits with its partner in the other map, by id of new, then of old."""
    found: dict[tuple[int, int], PieceFit] = {}
    mine = {id(fit) for fit in ground.new}
    for fit in sorted((*ground.new, *ground.old), key=lambda fit: fit.confirmed_m):
        seen = fit.known_m >= MIN_OVERLAP * fit.walls_m  # not through a door alone
        if fit.partner is not None and seen and fit.score >= ODD:
            own, partner = fit.submap, fit.partner
            # of two that tell of a pair, what more walls say
            found[(own, partner) if id(fit) in mine else (partner, own)] = fit
    return tuple(
        Joint(old=old, new=new, map_from_map=fit.old_from_new, score=fit.score)
        for (new, old), fit in sorted(found.items())
    )

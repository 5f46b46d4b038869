"""Loop closure (Section III-C of the paper): which old submap has the robot come back to?

Claims rank the old submaps, grids decide: a candidate becomes a constraint when the two grids
match anywhere and tracking does not rule it out, and a merge when the robot's tracks overlap under
the match. Drift grows along the way. Where the grids of two stays match just where tracking has
them, it had not drifted between these two, however long the way; what may have drifted is the rest.
With `verify` off, xi alone decides, as in the paper.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.records import Closure
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.core.shortcuts import Shortcuts
from specmap_cli.grids.gridmap import GridMap, PackedGrid
from specmap_cli.recognition.closure.claims import SAMPLES_PER_SUBMAP, ClaimRanker, Claims
from specmap_cli.recognition.closure.verification import (
    CANDIDATES,
    MIN_LEAD,
    MIN_WALL_M,
    Check,
    PreparedGrid,
    prepared,
    tracks_overlap,
    verify,
    wall_directions,
)

_MEMBERS = 2  # visits of an old submap whose grids are matched, the latest ones
_PREPARED = 4  # grids prepared for matching at a time: each takes megabytes
_NEAR_M = 2.0  # of tracks that may be of one place: a merge's reach, and what tracking is off
_ALIKE_M = 1.0  # tracking is off by as much in either of two places
_MERGE_OVERLAP = 0.4  # shared part of both tracks, for a merge
_MERGE_REACH_M = 1.0  # tracks this close overlap
_TWIN_MARGIN_M = 0.5  # a match that mends so much more than drift explains is of twin rooms

# Rooms have right angles: a wrong match is turned by a quarter or by half. Tracking is not, unless
# it turned a little with every metre of a long way.
_MOST_TURN_RAD, _TURN_RAD_PER_M = math.pi / 4, 0.001

_NO_CLAIMS = Claims(new_by_old=0.0, old_by_new=0.0)


@dataclass(frozen=True, kw_only=True)  # without slots: what is slow to find is found once
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

    @cached_property
    def directions(self) -> NDArray[np.complex128]:
        """Of the walls of its grid: of all that matching needs the slowest to find, and small."""
        return wall_directions(self.grid.cropped())

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


def confirm(
    way: Shortcuts, old: Stay, new: Stay, old_from_new: Pose2, config: RecognitionConfig
) -> None:
    """Tie the way where the grids of two stays match, at `old_from_new`.

    Where that is no twin, however far it is, the two are as near as the way on which drift makes as
    much as the match mends. A match that cuts no way short is left out: a patrol makes many.
    """
    ends, mended = (old.travelled_m, new.travelled_m), mended_m(old, new, old_from_new)
    known = old.tracked_from(new) is not None and all(map(math.isfinite, ends))
    if known and mended <= _TWIN_MARGIN_M:
        metres = mended / config.max_drift if config.max_drift > 0.0 else 0.0
        if metres < way.between(*ends):
            way.add(*ends, metres)


class LoopCloser:
    """Remembers the submaps so far and compares each new stay with them.

    A submap keeps one grid for every stay that was merged into it: a new stay is matched with the
    latest. Submaps have the number of their first stay.
    """

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._submaps: dict[int, list[Stay]] = {}
        self._submap_of: dict[int, int] = {}
        self._ranker = ClaimRanker(config, rng)
        self._claims: dict[int, dict[int, Claims]] = {}  # of each stay when it was new
        self._compared: set[tuple[int, int]] = set()
        self._grids: OrderedDict[int, PreparedGrid | None] = OrderedDict()
        self._way = Shortcuts()  # along it tracking drifts

    def consider(self, new: Stay) -> list[Closure]:
        """Compare a new stay with every old submap, and remember it as a submap of its own.

        Returns the pairs that were considered, best first; at most one has `merged` set, and stays
        advice until `merge` is called.
        """
        features = evenly(new.features, SAMPLES_PER_SUBMAP)
        new = replace(new, features=features, packed=PackedGrid.of(new.grid.cropped()))
        claims = self._claims[new.number] = self._ranker.claims(features)
        self._ranker.remember(new.number, features)
        if self.config.verify:
            ranked = sorted(claims, key=lambda i: (-claims[i].xi, i))[:CANDIDATES]
            stays = [(old, self._submaps[old][::-1]) for old in ranked]  # the latest first
            stays += [(old, [stay]) for old, stay in self._expected(new)[:CANDIDATES]]
            found = [self._best_match(new, claims[old], of_old) for old, of_old in stays]
            closures = self._with_one_merge(new, found)
            closures.sort(key=lambda c: (not c.merged, not c.verified, -c.xi, c.old))
        else:
            closures = self._claimed(new, claims)
        self._submaps[new.number] = [new]
        self._submap_of[new.number] = new.number
        return closures

    def merge(self, old: int, new: int) -> None:
        """Two submaps have become one, which keeps the smaller number.

        Either may be named by any of its stays. These keep their grids, and their features train
        one classifier. Of more than `stays_kept` those that saw least are forgotten, so that a
        robot that patrols is not compared with all its rounds.
        """
        kept, gone = sorted((self._submap_of[old], self._submap_of[new]))
        if kept == gone:
            return
        stays = [*self._submaps[kept], *self._submaps.pop(gone)]
        self._submap_of.update({stay.number: kept for stay in stays})
        by_area = sorted(range(len(stays)), key=lambda k: -stays[k].area_m2)  # the older of equals
        most = sorted(by_area[: self.config.stays_kept])
        self._submaps[kept] = [stays[k] for k in most]
        self._ranker.merge(kept, gone, most)
        forgotten = {stay.number for stay in stays} - {stays[k].number for k in most}
        self._compared = {pair for pair in self._compared if forgotten.isdisjoint(pair)}

    def grow(self, stay: Stay) -> None:
        """A stay went on after it was considered: from now on it is this one, whole."""
        stays = self._submaps[self._submap_of[stay.number]]
        grown = replace(stay, packed=PackedGrid.of(stay.grid.cropped()))
        stays[:] = [grown if other.number == stay.number else other for other in stays]
        self._grids.pop(stay.number, None)
        self._compared = {pair for pair in self._compared if stay.number not in pair}

    def consider_again(self, number: int) -> list[Closure]:
        """A grown stay compared with the submaps that it may have come back to; at most a merge."""
        own = self._submap_of[number]
        stay = next((s for s in self._submaps[own] if s.number == number), None)
        if stay is None or not self.config.verify:
            return []
        found = []
        for old, other in [each for each in self._expected(stay) if each[0] != own][:CANDIDATES]:
            claims = self._claims[number].get(old) or self._claims[old].get(own, _NO_CLAIMS)
            found.append(self._best_match(stay, claims, [other]))
        return [closure for closure in self._with_one_merge(stay, found) if closure.merged]

    def _claimed(self, new: Stay, claims: Mapping[int, Claims]) -> list[Closure]:
        """The paper's own rule: the largest xi merges when it passes the threshold."""
        if len(claims) < 2:
            return []
        best, *others = sorted(claims, key=lambda i: (-claims[i].xi, i))
        no = by_xi = Decision(False, False, "xi below the threshold or not the best")
        if claims[best].xi >= self.config.xi_threshold:
            by_xi = Decision(False, True, "xi passes the threshold")
        rest = [_closure(new.number, old, claims[old], no) for old in others]
        return [_closure(new.number, best, claims[best], by_xi), *rest]

    def _expected(self, new: Stay) -> list[tuple[int, Stay]]:
        """The submaps, and which stay of each, that tracking says the robot has come back to.

        What was seen the other way round looks like another place, but is where it was.
        """
        found: list[tuple[float, int, Stay]] = []
        for old, stays in self._submaps.items():
            for stay in stays:
                expected = stay.tracked_from(new)
                if expected is not None and math.isfinite(new.travelled_m - stay.travelled_m):
                    share = tracks_overlap(stay.track, new.track, expected, _NEAR_M)
                    found += [(share, old, stay)] if share > 0.0 else []
        found.sort(key=lambda one: -one[0])
        return [(old, stay) for _, old, stay in found]

    def _best_match(self, new: Stay, claims: Claims, stays: Sequence[Stay]) -> Closure | None:
        """The best match with the first few of some stays; None when all were compared before."""
        found: list[Closure] = []
        for stay in stays[:_MEMBERS]:
            pair = min(stay.number, new.number), max(stay.number, new.number)
            if pair in self._compared:
                continue
            self._compared.add(pair)
            found.append(self._matched(stay, new, claims))
            if found[-1].merged:
                break
        # no match at all, which has no score, is the worst
        return max(
            found,
            key=lambda c: (c.merged, c.verified, -math.inf if math.isnan(c.score) else c.score),
            default=None,
        )

    def _with_one_merge(self, new: Stay, found: Sequence[Closure | None]) -> list[Closure]:
        """Closures with one merge: of those that match as well, that which moves the stay least."""
        closures = [closure for closure in found if closure is not None]
        merges = [closure for closure in closures if closure.merged]
        enough = max((closure.score for closure in merges), default=0.0) - MIN_LEAD
        ranked: list[tuple[float, float, int]] = []
        for closure in merges:
            if closure.score >= enough and closure.old_from_new is not None:
                stays = self._submaps[self._submap_of[closure.old]]
                old = next(stay for stay in stays if stay.number == closure.old)
                off_m = mended_m(old, new, closure.old_from_new)
                ranked.append((max(off_m, _ALIKE_M), -closure.score, closure.old))
        best = min(ranked)[2] if ranked else None
        return [
            replace(closure, merged=False, reason="another submap fits better")
            if closure.merged and closure.old != best
            else closure
            for closure in closures
        ]

    def _matched(self, old: Stay, new: Stay, claims: Claims) -> Closure:
        """What the grids of two stays say."""
        grids = self._prepared(old), self._prepared(new)
        if grids[0] is None or grids[1] is None:
            no_walls = Decision(False, False, "a grid shows too few walls to match")
            return _closure(new.number, old.number, claims, no_walls)
        way_m = self._way.between(old.travelled_m, new.travelled_m)
        check = verify(
            grids[0],
            grids[1],
            lambda pose: plausible(old, new, pose, way_m, self.config),
            old.tracked_from(new),
        )
        found = decide(old, new, check, way_m, self.config)
        if check is not None and found.verified:
            confirm(self._way, old, new, check.old_from_new, self.config)
        return _closure(new.number, old.number, claims, found, check)

    def _prepared(self, stay: Stay) -> PreparedGrid | None:
        """A stay's grid prepared for matching; those last used are kept."""
        if stay.number not in self._grids:
            self._grids[stay.number] = prepared(stay.grid, stay.directions)
            if len(self._grids) > _PREPARED:
                self._grids.popitem(last=False)
        self._grids.move_to_end(stay.number)
        return self._grids[stay.number]


def _closure(
    new: int, old: int, claims: Claims, decision: Decision, check: Check | None = None
) -> Closure:
    return Closure(
        new=new,
        old=old,
        xi=claims.xi,
        claims_new_by_old=claims.new_by_old,
        claims_old_by_new=claims.old_by_new,
        verified=decision.verified,
        merged=decision.merged,
        score=check.score if check is not None else math.nan,
        reason=decision.reason,
        old_from_new=check.old_from_new if check is not None and decision.verified else None,
    )

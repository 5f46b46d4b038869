"""Loop closure (Section III-C of the paper): which old submap has the robot come back to?

Claims rank the old submaps, grids decide: a candidate becomes a constraint when the two grids
match anywhere, whatever the drift, and a merge when the robot's tracks overlap under the match.
With `verify` off, xi alone decides, as in the paper.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.records import Closure
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.gridmap import PackedGrid
from specmap_cli.recognition.closure.claims import SAMPLES_PER_SUBMAP, ClaimRanker, Claims
from specmap_cli.recognition.closure.decision import (
    NO_WALLS,
    Decision,
    DriftGraph,
    Stay,
    decide,
    expected_overlap,
    mended_m,
    plausible,
)
from specmap_cli.recognition.closure.prepared import PreparedGrids
from specmap_cli.recognition.closure.verification import CANDIDATES, MIN_LEAD, Check, verify

_LEFTOVERS = 2  # pairs matched a submap in search of duplicates
_MEMBERS = 2  # visits of an old submap whose grids are matched
_PREPARED = 8  # grids prepared for matching at a time: each takes megabytes
_NEAR_M = 2.0  # of tracks that may be of one place: a merge's reach, and what tracking is off
_ALIKE_M = 1.0  # tracking is off by as much in either of two places
_NO_CLAIMS = Claims.alike(0.0, 0)


class LoopCloser:
    """Remembers the submaps so far and compares each new stay with them.

    A submap keeps one grid for every stay that was merged into it: a new stay is matched with those
    that its classifier claims most. Submaps have the number of their first stay.
    """

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._submaps: dict[int, list[Stay]] = {}
        self._submap_of: dict[int, int] = {}
        self._ranker = ClaimRanker(config, rng)
        self._claims: dict[int, dict[int, Claims]] = {}  # the best of two submaps, by both
        self._compared: set[tuple[int, int]] = set()
        self._grids = PreparedGrids(_PREPARED)
        self._way = DriftGraph(config)

    def consider(self, new: Stay) -> list[Closure]:
        """Compare a new stay with every old submap, and remember it as a submap of its own.

        Returns the pairs that were considered, best first; at most one has `merged` set, and stays
        advice until `merge` is called.
        """
        features = evenly(new.features, SAMPLES_PER_SUBMAP).astype(np.float32)
        new = replace(new, features=features, packed=_packed(new))
        claims = self._ranker.claims(features)
        self._remember_claims(new.number, claims)
        self._ranker.remember(new.number, features)
        closures = self._verified(new, claims) if self.config.verify else self._claimed(new, claims)
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
        gone_s = self._claims.pop(gone)
        for other in gone_s:
            del self._claims[other][gone]
        self._remember_claims(kept, {i: c for i, c in gone_s.items() if i != kept})
        self._forget({stay.number for stay in stays} - {stays[k].number for k in most})

    def grow(self, stay: Stay) -> None:
        """A stay went on after it was considered: from now on it is this one, whole."""
        stays = self._submaps[self._submap_of[stay.number]]
        grown = replace(stay, packed=_packed(stay))
        stays[:] = [grown if other.number == stay.number else other for other in stays]
        self._grids.forget(stay.number)
        self._forget({stay.number})

    def consider_again(self, number: int) -> list[Closure]:
        """A grown stay compared with the submaps that it may have come back to; at most a merge."""
        own = self._submap_of[number]
        stay = next((s for s in self._submaps[own] if s.number == number), None)
        if stay is None or not self.config.verify:
            return []
        expected = [(old, k) for old, k in self._expected(stay) if old != own]
        found = [
            self._best_match(stay, old, self._best_claims(old, own), [k])
            for old, k in expected[:CANDIDATES]
        ]
        merges = [closure for closure in found if closure is not None and closure.merged]
        told = with_one_merge(merges, lambda c: self._moved_m(c, stay), MIN_LEAD)
        return [closure for closure in told if closure.merged]

    def consider_leftovers(self, adjacency: Mapping[int, Collection[int]]) -> list[Closure]:
        """Pairs of submaps that may be duplicates by the topology, verified; at most one merge.

        `adjacency` is of the submaps that are left. Submaps one or two edges apart are compared,
        the best ranked first. Call again after merging, until nothing merges; grids are never
        matched twice.
        """
        if not self.config.verify:
            return []
        found: list[Closure] = []
        for old, new in self._leftover_pairs(adjacency):
            claims = self._best_claims(old, new)
            latest_first = range(len(self._submaps[old]))[::-1]
            for stay in self._submaps[new][-_MEMBERS:]:
                closure = self._best_match(stay, old, claims, latest_first)
                if closure is not None:
                    found.append(closure)
                if closure is not None and closure.merged:
                    return found
        return found

    def _remember_claims(self, submap: int, claims: Mapping[int, Claims]) -> None:
        """The claims between a submap and others, where none between them ranked better before.

        One value for two submaps, however many stays they have: the table grows with the building.
        """
        own = self._claims.setdefault(submap, {})
        for other, found in claims.items():
            if other not in own or found.rank > own[other].rank:
                own[other] = self._claims[other][submap] = replace(
                    found, by_stay=_NO_CLAIMS.by_stay
                )

    def _forget(self, gone: set[int]) -> None:
        """Nothing is kept of the stays `gone` but the submap that they are part of."""
        if gone:
            self._compared = {pair for pair in self._compared if gone.isdisjoint(pair)}

    def _leftover_pairs(self, adjacency: Mapping[int, Collection[int]]) -> list[tuple[int, int]]:
        """Pairs that may be duplicates, for each submap the best ranked of those near it.

        Near are submaps one or two edges apart.
        """
        pairs: list[tuple[int, int]] = []
        for start in sorted(self._submaps):
            near = set(adjacency.get(start, ()))
            near |= {n for neighbour in near for n in adjacency.get(neighbour, ())}
            near &= self._submaps.keys()
            pairs.extend((start, other) for other in sorted(near) if other > start)
        pairs.sort(key=lambda pair: -self._best_claims(*pair).rank)
        taken: Counter[int] = Counter()
        chosen = []
        for old, new in pairs:
            if taken[new] < _LEFTOVERS:
                taken[new] += 1
                chosen.append((old, new))
        return chosen

    def _best_claims(self, old: int, new: int) -> Claims:
        """The best ranked claims between two submaps, none when they were never asked."""
        return self._claims[old].get(new, _NO_CLAIMS)

    def _claimed(self, new: Stay, claims: Mapping[int, Claims]) -> list[Closure]:
        """The paper's own rule: the largest xi merges when it passes the threshold."""
        if len(claims) < 2:
            return []
        ranked = sorted(claims, key=lambda i: (-claims[i].xi, i))
        closures = []
        for old in ranked:
            merged = old == ranked[0] and claims[old].xi >= self.config.xi_threshold
            reason = (
                "xi passes the threshold" if merged else "xi below the threshold or not the best"
            )
            by_xi = Decision(False, merged, reason)
            closures.append(_closure(new.number, old, claims[old], by_xi))
        return closures

    def _verified(self, new: Stay, claims: Mapping[int, Claims]) -> list[Closure]:
        """The best ranked candidates with their grids matched; the best of the merges wins."""
        ranked = sorted(claims, key=lambda i: (-claims[i].rank, i))
        orders = [(old, _most_claimed_first(claims[old])) for old in ranked[:CANDIDATES]]
        orders += [(old, [k]) for old, k in self._expected(new)[:CANDIDATES]]
        found = [self._best_match(new, old, claims[old], order) for old, order in orders]
        closures = [closure for closure in found if closure is not None]
        closures = with_one_merge(closures, lambda c: self._moved_m(c, new), MIN_LEAD)
        return sorted(closures, key=lambda c: (not c.merged, not c.verified, -c.xi, c.old))

    def _expected(self, new: Stay) -> list[tuple[int, int]]:
        """The submaps, and which stay of each, that tracking says the robot has come back to.

        What was seen the other way round looks like another place, but is where it was.
        """
        found = [
            (share, old, k)
            for old, stays in self._submaps.items()
            for k, stay in enumerate(stays)
            if (share := expected_overlap(stay, new, _NEAR_M)) > 0.0
        ]
        found.sort(key=lambda one: -one[0])
        return [(old, k) for _, old, k in found]

    def _best_match(
        self, new: Stay, old: int, claims: Claims, order: Collection[int]
    ) -> Closure | None:
        """The best match of a stay with stays of an old submap, the first few in `order`.

        None when all of these were compared before.
        """
        best: Closure | None = None
        for k in list(order)[:_MEMBERS]:
            stay = self._submaps[old][k]
            pair = min(stay.number, new.number), max(stay.number, new.number)
            if pair in self._compared:
                continue
            self._compared.add(pair)
            closure = self._matched(stay, new, claims)
            if best is None or _merit(closure) > _merit(best):
                best = closure
            if closure.merged:
                break
        return best

    def _moved_m(self, closure: Closure, new: Stay) -> float:
        """How far a match moves a new stay from where tracking put it."""
        assert closure.old_from_new is not None
        return mended_m(self._stay(closure.old), new, closure.old_from_new)

    def _stay(self, number: int) -> Stay:
        """One stay of those that are kept, by its number."""
        stays = self._submaps[self._submap_of[number]]
        return next(stay for stay in stays if stay.number == number)

    def _matched(self, old: Stay, new: Stay, claims: Claims) -> Closure:
        """What the grids of two stays say."""
        grids = [self._grids.of(stay.number, stay.grid) for stay in (old, new)]
        if grids[0] is None or grids[1] is None:
            return _closure(new.number, old.number, claims, NO_WALLS)
        way_m = self._way.between(old, new)
        check = verify(
            grids[0],
            grids[1],
            lambda pose: plausible(old, new, pose, way_m, self.config),
        )
        found = decide(old, new, check, way_m, self.config)
        if check is not None and found.verified:
            self._way.confirm(old, new, mended_m(old, new, check.old_from_new))
        return _closure(new.number, old.number, claims, found, check)


def _packed(stay: Stay) -> PackedGrid:
    """The grid of a stay without what it did not see."""
    return PackedGrid.of(stay.grid.cropped())


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


def _most_claimed_first(claims: Claims) -> list[int]:
    """The stays of an old submap in the order in which they are matched, the later of equals."""
    return sorted(range(len(claims.by_stay)), key=lambda k: (-claims.by_stay[k], -k))


def with_one_merge(
    closures: Sequence[Closure], moved_m: Callable[[Closure], float], lead: float
) -> list[Closure]:
    """The closures with the best of the merges alone left as one.

    Of those that match nearly as well, by less than `lead`, the one is right that tracking
    expected: `moved_m` tells how far a match moves the new stay. Twin rooms are a room apart.
    """
    merges = [c for c in closures if c.merged]
    if not merges:
        return list(closures)
    enough = max(c.score for c in merges) - lead
    best = min(
        (c for c in merges if c.score >= enough),
        key=lambda c: (max(moved_m(c), _ALIKE_M), -c.score, c.old),
    )
    return [
        replace(c, merged=False, reason="another submap fits better")
        if c.merged and c is not best
        else c
        for c in closures
    ]


def _merit(closure: Closure) -> tuple[bool, bool, float]:
    """What makes one match with a submap better than another; no match at all is the worst."""
    score = -math.inf if math.isnan(closure.score) else closure.score
    return closure.merged, closure.verified, score

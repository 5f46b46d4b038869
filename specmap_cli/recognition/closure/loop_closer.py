"""Loop closure (Section III-C of the paper): which old submap has the robot come back to?

Claims rank the old submaps, grids decide: a candidate becomes a constraint when the two grids
match anywhere, whatever the drift, and a merge when the robot's tracks overlap under the match.
With `verify` off, xi alone decides, as in the paper.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.config import RecognitionConfig
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Closure
from specmap_cli.core.sampling import evenly
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.closure.claims import ClaimRanker, Claims
from specmap_cli.recognition.closure.prepared import Places, cropped
from specmap_cli.recognition.closure.verification import Check, tracks_overlap, verify

_TWIN_MARGIN_M = 1.5
_NO_CLAIMS = Claims(0.0, 0.0, 0.0, np.zeros(0))


_PREPARED = 16  # grids prepared for matching at a time: each takes megabytes


@dataclass(frozen=True, slots=True)
class SubmapView:
    """What loop closure needs of a finished submap.

    `features` (n, F) of its raw scans, `grid` and `track` (k, 3) in its own frame. Where known,
    `map_from_submap` is its frame as registered and `travelled_m` the path driven before it
    (infinite across a loss of tracking): they tell twin rooms apart, and nothing else.
    """

    id: int
    features: FloatArray
    grid: GridMap
    track: FloatArray
    map_from_submap: Pose2 | None = None
    travelled_m: float = 0.0


@dataclass(frozen=True, slots=True)
class _Visit:
    """One visit of a submap: what is kept of its view."""

    id: int
    grid: GridMap
    track: FloatArray
    map_from_submap: Pose2 | None
    travelled_m: float


class LoopCloser:
    """Remembers the submaps so far and compares each new one with them.

    A submap keeps one grid for every visit that was merged into it: a new submap is matched with
    the visits that its classifier claims most.
    """

    def __init__(self, config: RecognitionConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._submaps: dict[int, list[_Visit]] = {}
        self._owner: dict[int, int] = {}
        self._ranker = ClaimRanker(config, rng)
        self._checked: set[tuple[int, int]] = set()
        self._places = Places(_PREPARED)
        self._claims: dict[tuple[int, int], Claims] = {}

    def consider(self, new: SubmapView) -> list[Closure]:
        """Compare a new submap with every old one, and remember it as one of its own.

        Returns the pairs that were considered, best first; at most one has `merged` set, and stays
        advice until `merge` is called.
        """
        visit = _Visit(
            new.id,
            cropped(new.grid),
            new.track,
            new.map_from_submap,
            new.travelled_m,
        )
        features = evenly(new.features, self.config.samples_per_submap)
        claims = self._ranker.claims(features)
        self._claims.update({(old, new.id): claim for old, claim in claims.items()})
        self._ranker.remember(new.id, features)
        closures = (
            self._verified(visit, claims) if self.config.verify else self._claimed(visit, claims)
        )
        self._submaps[new.id] = [visit]
        self._owner[new.id] = new.id
        return closures

    def merge(self, old: int, new: int) -> None:
        """Two submaps have become one, which keeps the smaller id; either may be named by any of
        its visits. Its visits keep their grids and their features train one classifier.
        """
        kept, gone = sorted((self._owner[old], self._owner[new]))
        if kept == gone:
            return
        visits = self._submaps.pop(gone)
        self._owner.update({visit.id: kept for visit in visits})
        self._submaps[kept].extend(visits)
        self._ranker.merge(kept, gone)

    def consider_leftovers(self, adjacency: Mapping[int, Collection[int]]) -> list[Closure]:
        """Pairs of submaps that may be duplicates by the topology, verified; at most one merge.

        `adjacency` is of the submaps that are left. Submaps one or two edges apart are compared,
        the best ranked first. Call again after merging, until nothing merges; pairs are never
        matched twice.
        """
        if not self.config.verify:
            return []
        found: list[Closure] = []
        for old, new in self._leftover_pairs(adjacency):
            even = np.zeros(len(self._submaps[old]))
            claims = replace(self._best_claims(old, new), by_member=even)
            for visit in self._submaps[new][-self.config.members :]:
                closures = self._verified_pair(visit, old, claims)
                found.extend(closures)
                if any(closure.merged for closure in closures):
                    return found
        return found

    def _leftover_pairs(self, adjacency: Mapping[int, Collection[int]]) -> list[tuple[int, int]]:
        """Pairs that may be duplicates, for each submap the best ranked of those near it."""
        pairs = _likely_duplicates(sorted(self._submaps), adjacency)
        pairs.sort(key=lambda pair: -self._best_claims(*pair).rank)
        taken: Counter[int] = Counter()
        chosen = []
        for old, new in pairs:
            if taken[new] < self.config.leftovers:
                taken[new] += 1
                chosen.append((old, new))
        return chosen

    def _best_claims(self, old: int, new: int) -> Claims:
        """The best ranked claims between visits of two submaps, none when they were never asked."""
        keys = ((a.id, b.id) for a in self._submaps[old] for b in self._submaps[new])
        asked = (self._claims.get((min(key), max(key)), _NO_CLAIMS) for key in keys)
        return max(asked, key=lambda claims: claims.rank)

    def _claimed(self, visit: _Visit, claims: Mapping[int, Claims]) -> list[Closure]:
        """The paper's own rule: the largest xi merges when it passes the threshold."""
        if len(claims) < 2:
            return []
        ranked = sorted(claims, key=lambda i: (-claims[i].xi, i))
        closures = []
        for k, old in enumerate(ranked):
            merged = k == 0 and claims[old].xi >= self.config.xi_threshold
            reason = (
                "xi passes the threshold" if merged else "xi below the threshold or not the best"
            )
            closures.append(_closure(visit.id, old, claims[old], None, False, merged, reason))
        return closures

    def _verified(self, visit: _Visit, claims: Mapping[int, Claims]) -> list[Closure]:
        """The best ranked candidates with their grids matched; the best of the merges wins."""
        ranked = sorted(claims, key=lambda i: (-claims[i].rank, i))
        checked = ranked[: self.config.candidates]
        closures = [c for old in checked for c in self._verified_pair(visit, old, claims[old])]
        merges = [c for c in closures if c.merged]
        if merges:
            best = max(merges, key=lambda c: (c.score, -c.old))
            closures = [
                c
                if c is best or not c.merged
                else replace(c, merged=False, reason="another submap fits better")
                for c in closures
            ]
        return sorted(closures, key=lambda c: (not c.merged, not c.verified, -c.xi, c.old))

    def _verified_pair(self, visit: _Visit, old: int, claims: Claims) -> list[Closure]:
        """The best match of a visit with the visits of an old submap that are claimed most."""
        members = self._submaps[old]
        order = sorted(range(len(members)), key=lambda k: (-claims.by_member[k], -k))
        best: Closure | None = None
        for k in order[: self.config.members]:
            member = members[k]
            key = (member.id, visit.id)
            if key in self._checked:
                continue
            old_place = self._places.of(member.id, member.grid)
            new_place = self._places.of(visit.id, visit.grid)
            if old_place is None or new_place is None:
                continue
            check = verify(old_place, new_place)
            self._checked.add(key)
            verdict = self._judge(member, visit, check)
            closure = _closure(visit.id, member.id, claims, check, *verdict)
            if best is None or _merit(closure) > _merit(best):
                best = closure
            if closure.merged:
                break
        return [best] if best is not None else []

    def _judge(self, member: _Visit, visit: _Visit, check: Check | None) -> tuple[bool, bool, str]:
        """Whether a checked pair matches, whether it is one submap, and why or why not."""
        config = self.config
        if check is None or check.score < config.min_score:
            return False, False, "the grids do not match"
        if check.inliers < config.min_inliers:
            return False, False, "too few wall points match"
        if check.overlap < config.min_overlap or check.least_overlap < config.least_overlap:
            return False, False, "the grids overlap too little"
        if check.lead < config.min_lead:
            return False, False, "ambiguous: the grids match in more than one way"
        if not self._plausible(member, visit, check.old_from_new):
            return False, False, "ambiguous: looks the same but is too far away, a twin"
        shared = tracks_overlap(member.track, visit.track, check.old_from_new, config.merge_reach_m)
        if shared < config.merge_overlap:
            return True, False, "the grids match, the robot's tracks do not overlap"
        return True, True, "the grids match and the tracks overlap"

    def _plausible(self, member: _Visit, visit: _Visit, old_from_new: Pose2) -> bool:
        """Whether registration can have drifted as far as a merge would say it has."""
        if member.map_from_submap is None or visit.map_from_submap is None:
            return True
        expected = member.map_from_submap.inverse() @ visit.map_from_submap
        path = abs(visit.travelled_m - member.travelled_m)
        shift = np.hypot(expected.x - old_from_new.x, expected.y - old_from_new.y)
        return bool(not shift > _TWIN_MARGIN_M + self.config.max_drift * path)


def _closure(
    new: int,
    old: int,
    claims: Claims,
    check: Check | None,
    verified: bool,
    merged: bool,
    reason: str,
) -> Closure:
    return Closure(
        new=new,
        old=old,
        xi=claims.xi,
        claims_new_by_old=claims.new_by_old,
        claims_old_by_new=claims.old_by_new,
        verified=verified,
        merged=merged,
        score=check.score if check is not None else float("nan"),
        reason=reason,
        old_from_new=check.old_from_new if check is not None and verified else None,
    )


def _likely_duplicates(
    ids: list[int], adjacency: Mapping[int, Collection[int]]
) -> list[tuple[int, int]]:
    """Pairs (smaller, larger) of submaps one or two edges apart."""
    pairs: list[tuple[int, int]] = []
    for start in ids:
        near = set(adjacency.get(start, ()))
        near |= {n for neighbour in near for n in adjacency.get(neighbour, ())}
        pairs.extend((start, other) for other in sorted(near) if other > start and other in ids)
    return pairs


def _merit(closure: Closure) -> tuple[bool, bool, float]:
    """What makes one match with a submap better than another."""
    return closure.merged, closure.verified, closure.score

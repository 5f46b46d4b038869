"""What pairs of submaps say of two maps: each match of their grids votes for one transform.

Pairs that may be one place are ranked by how each map's classifiers claim the other's scans (xi). A
finished map keeps no scans: what its robot saw is cast anew in its grids, all round, from places on
its track. Votes of different submaps that agree are more than any of them: rooms look alike, but
not all of them and at the same distances.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, nearest_motion, wrap_angle
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.closure.prepared import MapToAlign, PreparedMap
from specmap_cli.recognition.closure.verification import (
    MIN_LEAD,
    Check,
    verify,
)
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.features.virtual import VIRTUAL_BEAMS, VIRTUAL_RANGE_M, cast_circles

_PLACES = 16  # of a submap from which scans are cast: a mean of chances to a tenth
_DECIMALS = 6  # of a chance: the last digits of an exponential depend on the processor
_AREA_PRIOR = 0.5  # times the logarithm of a ratio of areas, where no classifier can be asked

Pair = tuple[int, int]
# Votes for one transform: what a match of two grids is off, and how much more for each metre
# between their places, which an error of its direction, or a bend of a map, makes.
_APART_M, _APART_RAD, _APART_PER_M = 0.4, math.radians(4.0), 0.03
_LEAST_RADIUS_M = 1.0  # of a submap: gives the direction of its vote some weight
_PARTIES, _SEEDS = 8, 24  # the largest votes are tried: of hundreds of rooms most agree
_ROUNDS = 3  # of fitting a transform and collecting the votes for it


def likely_pairs(old: MapToAlign, new: MapToAlign, candidates: int) -> set[Pair]:
    """Pairs (old submap, new submap) worth a match of their grids.

    Of each submap the `candidates` best ranked ones of the other map.
    """
    ranks = _ranks(old, new)
    best_new = np.argsort(-ranks, axis=1, kind="stable")[:, :candidates]
    best_old = np.argsort(-ranks, axis=0, kind="stable")[:candidates]
    chosen = {(i, j) for i, row in enumerate(best_new.tolist()) for j in row}
    chosen |= {(i, j) for row in best_old.tolist() for j, i in enumerate(row)}
    return {(old.ids[i], new.ids[j]) for i, j in chosen}


def _ranks(old: MapToAlign, new: MapToAlign) -> FloatArray:
    """(n_old, n_new) the product of the chances by which two submaps claim each other (eq. 5).

    Of a map that has no classifiers it is the chance by which the other one claims alone.
    """
    ranks = [_claimed(new, by=old), _claimed(old, by=new)]
    known = [ranks[0], None if ranks[1] is None else ranks[1].T]
    claims = [chances for chances in known if chances is not None]
    if claims:
        return np.asarray(np.prod(claims, axis=0))
    # where no classifier can be asked: how alike the free areas of submaps are, in (0, 1]
    areas = [
        np.log([max(map_.grids[i].free_area_m2, 1.0) for i in map_.ids]) for map_ in (old, new)
    ]
    gaps = np.abs(areas[0][:, None] - areas[1][None, :])
    return np.asarray(np.round(np.exp(-_AREA_PRIOR * gaps), _DECIMALS))


def _claimed(of: MapToAlign, *, by: MapToAlign) -> FloatArray | None:
    """(n_by, n_of) mean chances by which the submaps of one map claim scans of another's.

    None where the one cannot be asked, or nobody knows where the robot was in the other.
    """
    asked = None if by.classifiers is None else by.classifiers.virtual
    if asked is None or set(asked.ids) != set(by.ids):
        return None
    if not all(len(of.tracks.get(i, ())) for i in of.ids):
        return None
    scans = []
    for i in of.ids:
        places = evenly(np.asarray(of.tracks[i])[:, :2], _PLACES)
        origins = of.frames[i].inverse().apply(places)
        cast = cast_circles(of.grids[i], origins, VIRTUAL_BEAMS, VIRTUAL_RANGE_M)
        scans.append(np.asarray(scans_features(cast, asked.feature_set), dtype=np.float64))
    starts = np.cumsum([0, *(len(own) for own in scans)])[:-1]
    columns = [asked.ids.index(i) for i in by.ids]
    margins = asked.margins(np.concatenate(scans))[:, columns]
    counts = np.array([len(own) for own in scans], dtype=np.float64)[:, None]
    chances = np.add.reduceat(1.0 / (1.0 + np.exp(-margins)), starts) / counts
    return np.asarray(np.round(chances, _DECIMALS)).T


@dataclass(frozen=True, slots=True, kw_only=True)
class Vote:
    """A pair of submaps whose grids match in one way only, and where the maps lie then.

    `old_from_new` is between the maps. `centre` (2,) and `radius_m` of the new submap in its map;
    `check` is of the two grids.
    """

    old: int
    new: int
    old_from_new: Pose2
    centre: FloatArray
    radius_m: float
    check: Check


@dataclass(frozen=True, slots=True, kw_only=True)
class Party:
    """Votes for one transform between two maps."""

    old_from_new: Pose2
    votes: tuple[Vote, ...]

    @property
    def strength(self) -> int:
        """How many submaps of either map speak for it: those of the map with fewer."""
        return min(len({v.old for v in self.votes}), len({v.new for v in self.votes}))

    @property
    def weight(self) -> tuple[int, float]:
        """What makes one party stronger than another: of as many submaps, the more metres of wall.

        Walls that were seen in two submaps count twice.
        """
        return self.strength, sum(vote.check.confirmed_m for vote in self.votes)


def votes_of(
    pairs: Iterable[Pair], old: PreparedMap, new: PreparedMap, config: RecognitionConfig
) -> list[Vote]:
    """The pairs of submaps whose grids match in one way."""
    votes = []
    for i, j in sorted(pairs, key=lambda pair: (pair[1], pair[0])):  # few grids are kept prepared
        one, other = old.of(i), new.of(j)
        check = None if one is None or other is None else verify(one.grid, other.grid)
        if one and other and check and check.matches(config.min_score) and check.lead >= MIN_LEAD:
            radius_m = math.sqrt(new.map.grids[j].free_area_m2 / math.pi)
            votes.append(
                Vote(
                    old=i,
                    new=j,
                    old_from_new=one.frame @ check.old_from_new @ other.frame.inverse(),
                    centre=np.array(other.frame[:2]),
                    radius_m=max(_LEAST_RADIUS_M, radius_m),
                    check=check,
                )
            )
    return votes


def parties_of(votes: Sequence[Vote]) -> list[Party]:
    """The votes by the transform that they agree on, the strongest party first."""
    left, parties = list(votes), list[Party]()
    while left and len(parties) < _PARTIES:
        seeds = sorted(left, key=lambda vote: -vote.check.confirmed_m)[:_SEEDS]
        party = max((_party(vote, left) for vote in seeds), key=attrgetter("weight"))
        parties.append(party)
        left = [vote for vote in left if not any(vote is other for other in party.votes)]
    return sorted(parties, key=attrgetter("weight"), reverse=True)


def fitted(votes: Sequence[Vote]) -> Pose2:
    """The one transform nearest to those of several votes, by least squares.

    Each counts at four points round its submap's centre, a radius away.
    """
    corners = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    source = [vote.centre + corners * vote.radius_m for vote in votes]
    pairs = zip(votes, source, strict=True)
    target = [vote.old_from_new.apply(points) for vote, points in pairs]
    return nearest_motion(np.concatenate(source), np.concatenate(target))


def _party(seed: Vote, votes: Sequence[Vote]) -> Party:
    """The votes that agree with one, and the transform nearest to all of them.

    A vote agrees that is for the party's transform, where it is cast and where the party's are.
    """
    party = Party(old_from_new=seed.old_from_new, votes=(seed,))
    for _ in range(_ROUNDS):
        middle = np.mean([vote.centre for vote in party.votes], axis=0)
        found = []
        for vote in votes:
            places = np.stack([vote.centre, middle])
            mine, theirs = vote.old_from_new, party.old_from_new
            gap = max(map(math.dist, mine.apply(places), theirs.apply(places)))
            turn = abs(wrap_angle(mine.theta - theirs.theta))
            far = math.dist(vote.centre, middle)
            if turn <= _APART_RAD and gap <= _APART_M + _APART_PER_M * far:
                found.append(vote)
        if not found or tuple(found) == party.votes:
            break
        party = Party(old_from_new=fitted(found), votes=tuple(found))
    return party

"""What pairs of submaps say of two maps: each match of their grids votes for one transform.

Votes of different submaps that agree are more than any of them: rooms look alike, but not all of
them and at the same distances.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, nearest_motion, wrap_angle
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.closure.kinship import Pair
from specmap_cli.recognition.closure.known_map import Pieces
from specmap_cli.recognition.closure.verification import (
    LEAST_OVERLAP,
    MIN_LEAD,
    MIN_OVERLAP,
    MIN_WALL_M,
    Check,
    verify,
)

# Votes for one transform: what a match of two grids is off, and how much more for each metre
# between their places, which an error of its direction, or a bend of a map, makes.
_APART_M, _APART_RAD, _APART_PER_M = 0.4, math.radians(4.0), 0.03
_LEAST_RADIUS_M = 1.0  # of a submap: gives the direction of its vote some weight
_PARTIES, _SEEDS = 8, 24  # the largest votes are tried: of hundreds of rooms most agree
_ROUNDS = 3  # of fitting a transform and collecting the votes for it


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
    def confirmed_m(self) -> float:
        """Metres of wall that the votes confirm; walls seen in two submaps count twice."""
        return sum(vote.check.confirmed_m for vote in self.votes)


def votes_of(
    pairs: Iterable[Pair], old: Pieces, new: Pieces, config: RecognitionConfig
) -> list[Vote]:
    """The pairs of submaps whose grids match in one way."""
    votes = []
    for i, j in sorted(pairs, key=lambda pair: (pair[1], pair[0])):  # few grids are kept prepared
        one, other = old.of(i), new.of(j)
        check = None if one is None or other is None else verify(one, other)
        if check is not None and _is_sure(check, config):
            frames = old.known.frames[i], new.known.frames[j]
            votes.append(_vote((i, j), check, frames, new.known.grids[j].free_area_m2))
    return votes


def parties_of(votes: Sequence[Vote]) -> list[Party]:
    """The votes by the transform that they agree on, the strongest party first."""
    left, parties = list(votes), list[Party]()
    while left and len(parties) < _PARTIES:
        seeds = sorted(left, key=lambda vote: -vote.check.confirmed_m)[:_SEEDS]
        party = max((_party(vote, left) for vote in seeds), key=_weight)
        parties.append(party)
        inside = {id(vote) for vote in party.votes}
        left = [vote for vote in left if id(vote) not in inside]
    return sorted(parties, key=_weight, reverse=True)


def fitted(transforms: Sequence[Pose2], centres: FloatArray, radii: FloatArray) -> Pose2:
    """The one transform nearest to several, each known at its centre (n, 2) and radius (n,) round.

    Least squares over four points of each place.
    """
    corners = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    source = centres[:, None, :] + corners[None] * radii[:, None, None]
    pairs = zip(transforms, source, strict=True)
    target = np.concatenate([pose.apply(points) for pose, points in pairs])
    return nearest_motion(source.reshape(-1, 2), target)


def _is_sure(check: Check, config: RecognitionConfig) -> bool:
    """Whether two grids match, well and in one way only."""
    return (
        check.score >= config.min_score
        and check.confirmed_m >= MIN_WALL_M
        and check.overlap >= MIN_OVERLAP
        and check.least_overlap >= LEAST_OVERLAP
        and check.lead >= MIN_LEAD
    )


def _vote(pair: Pair, check: Check, frames: tuple[Pose2, Pose2], area_m2: float) -> Vote:
    old_frame, new_frame = frames
    return Vote(
        old=pair[0],
        new=pair[1],
        old_from_new=old_frame @ check.old_from_new @ new_frame.inverse(),
        centre=np.array(new_frame[:2]),
        radius_m=max(_LEAST_RADIUS_M, math.sqrt(area_m2 / math.pi)),
        check=check,
    )


def _party(seed: Vote, votes: Sequence[Vote]) -> Party:
    """The votes that agree with one, and the transform nearest to all of them."""
    party = Party(old_from_new=seed.old_from_new, votes=(seed,))
    for _ in range(_ROUNDS):
        found = tuple(vote for vote in votes if _agree(vote, party))
        if not found or found == party.votes:
            break
        transforms = [vote.old_from_new for vote in found]
        centres = np.array([vote.centre for vote in found])
        radii = np.array([vote.radius_m for vote in found])
        party = Party(old_from_new=fitted(transforms, centres, radii), votes=found)
    return party


def _agree(vote: Vote, party: Party) -> bool:
    """Whether a vote is for a party's transform, where it is cast and where the party's are."""
    turn = abs(wrap_angle(vote.old_from_new.theta - party.old_from_new.theta))
    if turn > _APART_RAD:
        return False
    middle = np.mean([other.centre for other in party.votes], axis=0)
    gaps = [_gap(vote.old_from_new, party.old_from_new, place) for place in (vote.centre, middle)]
    far = math.dist(vote.centre, middle)
    return max(gaps) <= _APART_M + _APART_PER_M * far


def _gap(a: Pose2, b: Pose2, place: FloatArray) -> float:
    """How far apart two transforms place a point (2,), metres."""
    return math.dist(a.apply(place[None])[0], b.apply(place[None])[0])


def _weight(party: Party) -> tuple[int, float]:
    return party.strength, party.confirmed_m

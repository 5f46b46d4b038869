"""Where two maps in one frame can be joined: pairs of submaps whose grids match."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure.known_map import Pieces
from specmap_cli.recognition.closure.prepared import PreparedGrid
from specmap_cli.recognition.closure.verification import (
    LEAST_OVERLAP,
    MIN_OVERLAP,
    MIN_WALL_M,
    Check,
    judge,
)

_POINTS, _STEPS, _SHIFT_M = 1000, 15, 0.5  # of a match near the transform of the maps
_MOST_TURN_RAD = math.radians(3.0)
_NEAR_SCORE = 0.1  # of a wide field: two sigma of it, some 0.6 m: no match moves a wall farther

_Placed = tuple[int, PreparedGrid, Pose2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """A submap of the old map and one of the new map whose grids match under an alignment.

    `old_from_new` is between the frames of the two submaps, `map_from_map` what it says of the maps
    (old from new), `off_m` how far from the alignment it puts the new submap. `check` judges it.
    """

    old: int
    new: int
    old_from_new: Pose2
    map_from_map: Pose2
    off_m: float
    check: Check


def joints(
    old: Pieces, new: Pieces, old_from_new: Pose2, config: RecognitionConfig
) -> tuple[Joint, ...]:
    """The pairs of submaps that match near a transform of their maps, by id of new, then of old.

    Only those are told that are the best of one of both submaps: neighbours that see each other
    through a door match, too, but slide along their walls.
    """
    found, most = list[Joint](), dict[tuple[str, int], float]()
    for walls_m, i, j in _shared(old, new, old_from_new):
        ends = ("old", i), ("new", j)
        if all(walls_m <= most.get(end, 0.0) for end in ends):
            continue  # neither's best: no more can be confirmed than lies near
        joint = _joint(_placed(old, i), _placed(new, j), old_from_new, config)
        if joint is not None:
            found.append(joint)
            most |= {end: max(_confirmed_m(joint), most.get(end, 0.0)) for end in ends}
    found.sort(key=lambda joint: (joint.new, joint.old))
    best = {("old", joint.old): joint for joint in sorted(found, key=_confirmed_m)}
    best |= {("new", joint.new): joint for joint in sorted(found, key=_confirmed_m)}
    return tuple(joint for joint in found if any(joint is other for other in best.values()))


def _confirmed_m(joint: Joint) -> float:
    return joint.check.confirmed_m


def _shared(old: Pieces, new: Pieces, old_from_new: Pose2) -> list[tuple[float, int, int]]:
    """Pairs of submaps, old and new, that may match, those first that may share most wall.

    With each the metres of the new one's walls that lie near walls of the old one.
    """
    found = []
    for j in new.known.ids:
        piece = new.of(j)
        for i in () if piece is None else _near(old, new, j, old_from_new):
            one, old_frame = _placed(old, i)[1:]
            assert piece is not None
            guess = old_frame.inverse() @ old_from_new @ new.known.frames[j]
            points = guess.apply(evenly(piece.walls, _POINTS))
            share = float((one.wide.at(points) > _NEAR_SCORE).mean())
            walls_m = share * len(piece.walls) * piece.metres_a_point
            if walls_m >= MIN_WALL_M:
                found.append((walls_m, i, j))
    return sorted(found, key=lambda pair: (-pair[0], pair[2], pair[1]))


def _placed(pieces: Pieces, submap: int) -> _Placed:
    """A submap with its walls prepared, which it has, and its frame in the map."""
    piece = pieces.of(submap)
    assert piece is not None
    return submap, piece, pieces.known.frames[submap]


def _near(old: Pieces, new: Pieces, submap: int, old_from_new: Pose2) -> Iterator[int]:
    """The submaps of the old map whose box meets that of one of the new map."""
    placed = old_from_new @ new.known.frames[submap]
    low, high = _box(new, submap, placed)
    for i in old.known.ids:
        if old.of(i) is not None:
            other_low, other_high = _box(old, i, old.known.frames[i])
            if (low < other_high).all() and (other_low < high).all():
                yield i


def _box(pieces: Pieces, submap: int, frame: Pose2) -> tuple[FloatArray, FloatArray]:
    """The corners (2,) of the box round a submap's walls, placed at a frame."""
    piece = pieces.of(submap)
    assert piece is not None
    walls = frame.apply(piece.walls)
    return walls.min(axis=0), walls.max(axis=0)


def _joint(
    old: _Placed,
    new: _Placed,
    old_from_new: Pose2,
    config: RecognitionConfig,
) -> Joint | None:
    """The match of two submaps near where their maps put them, if it is one."""
    (i, one, old_frame), (j, other, new_frame) = old, new
    guess = old_frame.inverse() @ old_from_new @ new_frame
    best = refine(one.field, evenly(other.walls, _POINTS), guess, _STEPS, _SHIFT_M).pose
    check = judge(one, other, best)
    turn = abs(wrap_angle(best.theta - guess.theta))
    if turn > _MOST_TURN_RAD or not _matches(check, config):
        return None
    middle = other.walls.mean(axis=0)[None]
    return Joint(
        old=i,
        new=j,
        old_from_new=best,
        map_from_map=old_frame @ best @ new_frame.inverse(),
        off_m=float(np.hypot(*(best.apply(middle) - guess.apply(middle))[0])),
        check=check,
    )


def _matches(check: Check, config: RecognitionConfig) -> bool:
    return (
        check.score >= config.min_score
        and check.confirmed_m >= MIN_WALL_M
        and check.overlap >= MIN_OVERLAP
        and check.least_overlap >= LEAST_OVERLAP
    )

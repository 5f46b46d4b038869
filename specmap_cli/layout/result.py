"""The layout of all keyframes, what it rests on, the poses between them, and its frame.

The frame in which a robot is tracked begins with the robot's first pose, so that its axes are those
of nothing. In a frame that follows the walls every recording of a building is drawn alike, walls
run along the rows and columns of the grids, and what is measured in cells hangs less on chance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly, runs
from specmap_cli.core.geometry import (
    FloatArray,
    compose,
    invert,
    wrap_angle,
    wrap_angles,
)
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Agreement
from specmap_cli.layout.path_graph import MATCH_RANGE_M, Draft, Ends, Graph, RowPair
from specmap_cli.layout.pose_graph import Link, graph_text

# Of a claim what the consistency found (see `consistency.py`), or:
# outlier: the solution misses it; walls: the layout with it was not taken.
Reason = Literal["impossible", "outvoted", "alone", "outlier", "walls"]
# relaxed: closures and passes; passes: these alone, closures contradicted them; tracked: as it was
Choice = Literal["relaxed", "passes", "tracked"]

_QUARTER = math.pi / 2.0  # walls meet at right angles: a direction counts but for quarter turns
_MOST = 400  # keyframes asked, evenly spread: what they say of the directions hardly differs
_APART = (4, 8)  # beams from one end of a piece of wall to the other
_LENGTHS_M = (0.2, 1.5)  # of a piece: longer than the noise of a reading, shorter than most walls
_BENT_M = 0.03  # a piece is straight when its middle lies this near to the line of its ends
_BINS = 360  # of a quarter turn
_SPREAD_RAD = math.radians(3.0)  # of the curve that the bins are smoothed by: a layout is bent some
_NEAR_RAD = (0.1, 0.05)  # pieces this near to the direction say what it is exactly, in two rounds
# Of evenly spread directions a ninth is that near to any; a building has one of which are twice as
# many, or it has none.
_CLEAR = 2.0 * 2.0 * _NEAR_RAD[0] / _QUARTER
_STEP_RAD = 1e-4  # what the turn is rounded to: a centimetre over a hundred metres

_SAME = 2e-6  # metres and radians: text files have six decimals


@dataclass(frozen=True, slots=True, kw_only=True)
class PartMove:
    """A piece of the path from keyframe `first` on, after a break, against what bridged the break.

    `moved_m`: its first keyframe seen from the one before, layout against tracked. `votes` closures
    and passes tie it to other parts; without any it is where the guess put it.
    """

    first: int
    moved_m: float
    votes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Relaxed poses (n, 3) of all keyframes, and the pose graph they come from.

    `nodes` are the keyframe numbers in the graph; `odometry`, `kept` and `dropped` its edges, the
    last two being closures and nearby passes. `why` says of the ends of those dropped what speaks
    against them. `loose` are the keyframes at which tracking restarted
    and whose place, and that of what follows, is a guess. `choice` is what the poses come from,
    `parts` how far pieces after a break were moved, `agreement` how the passes stand to each other.
    """

    poses: FloatArray
    nodes: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    odometry: tuple[Link, ...] = ()
    kept: tuple[Link, ...] = ()
    dropped: tuple[Link, ...] = ()
    why: Mapping[RowPair, Reason] = field(default_factory=dict)
    loose: tuple[int, ...] = ()
    choice: Choice = "tracked"
    parts: tuple[PartMove, ...] = ()
    agreement: Agreement = field(default_factory=Agreement)

    @classmethod
    def of(cls, graph: Graph, candidate: Candidate) -> Layout:
        """The layout of all keyframes from the settled draft of the nodes."""
        draft = candidate.draft
        older, newer = Ends.of(graph.row, draft.loops).parts(graph)
        moves = []
        for part in graph.part_numbers[1:]:
            row = int(np.argmax(graph.parts == part))
            was, now = (
                compose(invert(poses[row - 1]), poses[row]) for poses in (graph.poses, draft.poses)
            )
            gap = compose(invert(was), now)
            move = PartMove(
                first=int(graph.nodes[row]),
                moved_m=float(np.hypot(gap[0], gap[1])),
                votes=int(np.count_nonzero((older == part) != (newer == part))),
            )
            moves.append(move)
        return cls(
            poses=propagated(graph.tracked, graph.nodes, draft.poses),
            nodes=graph.nodes,
            odometry=graph.odometry,
            kept=draft.loops,
            dropped=candidate.dropped,
            loose=loose_starts(graph, draft.loops),
            choice=candidate.choice,
            parts=tuple(moves),
            agreement=candidate.agreement,
        )

    def g2o(self) -> str:
        """The pose graph in the format of g2o.

        Vertices carry keyframe numbers, dropped edges are left out.
        """
        nodes = self.nodes.tolist()
        poses = {number: self.poses[number] for number in nodes}
        return graph_text(poses, [*self.odometry, *self.kept], nodes[:1])


@dataclass(frozen=True, slots=True)
class Candidate:
    """A draft that is settled, the links it was settled without, and what it is made of.

    `agreement` is how its passes stand to each other.
    """

    choice: Choice
    draft: Draft
    dropped: tuple[Link, ...]
    agreement: Agreement


def loose_starts(graph: Graph, loops: Sequence[Link]) -> tuple[int, ...]:
    """First keyframes of the parts that no loop ties to the first part, nor over others."""
    ties = Ends.of(graph.row, loops).parts(graph)
    count = len(graph.part_numbers)
    tied = csr_array((np.ones(len(loops)), ties), shape=(count, count))
    _, piece = connected_components(tied, directed=False)
    apart = np.flatnonzero(piece != piece[0])
    return tuple(int(graph.nodes[np.argmax(graph.parts == part)]) for part in apart)


def along_walls(layout: Layout, store: KeyframeStore, config: RelaxationConfig) -> Layout:
    """The layout turned about the map's origin so that most walls are parallel to an axis.

    Of the four such turns it is the smallest, so none is above 45 degrees. A building of which no
    direction stands out stays as it is. Deterministic.
    """
    if not config.follow_walls:
        return layout
    turn = -wall_direction(*_pieces(store, layout.poses))
    if turn == 0.0:
        return layout
    return replace(layout, poses=compose(np.array([0.0, 0.0, turn]), layout.poses))


def wall_direction(directions: FloatArray, lengths: FloatArray) -> float:
    """The direction, in [-pi/4, pi/4], of most metres of wall, or of walls at right angles to them.

    `directions` (n,) are those of pieces of wall, `lengths` (n,) their metres. 0 when no direction
    stands out.
    """
    if not len(lengths):
        return 0.0
    # the direction round which there are most metres of wall
    bins = np.floor(np.mod(directions, _QUARTER) * (_BINS / _QUARTER)).astype(np.intp) % _BINS
    metres = np.bincount(bins, weights=lengths, minlength=_BINS)
    around = np.arange(-_BINS // 2, _BINS // 2)
    curve = np.exp(-0.5 * (around * (_QUARTER / _BINS) / _SPREAD_RAD) ** 2)
    rows = (np.arange(_BINS)[:, None] + around) % _BINS
    peak = int((metres[rows] * curve).sum(axis=1).argmax())
    direction = (peak + 0.5) * (_QUARTER / _BINS)
    for near in _NEAR_RAD:
        # seen from it, in [-pi/4, pi/4), whatever quarter they are in
        off = np.mod(directions - direction + 0.5 * _QUARTER, _QUARTER) - 0.5 * _QUARTER
        taken = np.abs(off) < near
        if lengths[taken].sum() < _CLEAR * (near / _NEAR_RAD[0]) * lengths.sum():
            return 0.0
        direction += float((lengths * off)[taken].sum() / lengths[taken].sum())
    nearest = float(np.mod(direction + 0.5 * _QUARTER, _QUARTER)) - 0.5 * _QUARTER
    return round(nearest / _STEP_RAD) * _STEP_RAD


def _pieces(store: KeyframeStore, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (n,) in the map and lengths (n,) of straight pieces of wall in some keyframes."""
    found = [np.zeros((2, 0))]
    shortest, longest = _LENGTHS_M
    for number in evenly(np.arange(len(store)), _MOST).tolist():
        heading = poses[number, 2] + store.base_from_laser(number).theta
        scan = store.scan(number)
        ranges = np.where(scan.ranges <= MATCH_RANGE_M, scan.ranges, np.nan)
        angles = heading + scan.bearings
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)])
        for apart in _APART:
            start, end, half = points[:, :-apart], points[:, apart:], apart // 2
            along, sag = end - start, 0.5 * (start + end) - points[:, half:-half]
            length = np.hypot(along[0], along[1])
            wall = (length > shortest) & (length < longest) & (np.hypot(sag[0], sag[1]) < _BENT_M)
            found.append(np.stack([np.arctan2(along[1], along[0])[wall], length[wall]]))
    directions, lengths = np.concatenate(found, axis=1)
    return directions, lengths


def corrected(trajectory: Trajectory, store: KeyframeStore, poses: FloatArray) -> Trajectory:
    """The trajectory of every registered scan, moved with the keyframes to their poses (n, 3)."""
    rows = rows_of(trajectory, store.stamps_ns, store.poses)
    return replace(trajectory, poses=bridged(propagated(trajectory.poses, rows, poses), trajectory))


def propagated(tracked: FloatArray, relaxed_rows: IntArray, relaxed: FloatArray) -> FloatArray:
    """Poses (n, 3), each moved with the last relaxed one: its new pose o the tracked motion since.

    `relaxed_rows` (m,) ascending rows of `tracked` (n, 3), `relaxed` (m, 3) their new poses. What
    lies before the first goes with that one; without any nothing moves.
    """
    if not len(relaxed_rows):
        return np.array(tracked)
    rows = np.arange(len(tracked))
    last = np.maximum(np.searchsorted(relaxed_rows, rows, side="right") - 1, 0)
    motion = compose(invert(tracked[relaxed_rows[last]]), tracked)
    return compose(relaxed[last], motion)


def propagated_places(places: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Places (m, 2) moved with the pose nearest to each, of those `before` (n, 3) to `after`."""
    nearest = cKDTree(before[:, :2]).query(places)[1]
    poses = np.column_stack([places, np.zeros(len(places))])
    moved = compose(after[nearest], compose(invert(before[nearest]), poses))
    return np.asarray(moved[:, :2])


def bridged(poses: FloatArray, trajectory: Trajectory) -> FloatArray:
    """Poses (n, 3) in which the guesses of lost scans lead from the scan before to the one after.

    The `trajectory` has them as tracked. What a chain of guesses misses the next known pose by is
    spread over the time: after a hole without scans it was made up in the hole.
    """
    result, tracked, lost = np.array(poses), trajectory.poses, trajectory.lost
    if lost is None:
        return result
    for start, end in runs(lost):
        if not lost[start] or start == 0 or end == len(poses):
            continue
        motions = compose(invert(tracked[start - 1]), tracked[start : end + 1])
        guesses = compose(poses[start - 1], motions)
        elapsed_ns = trajectory.stamps_ns[start : end + 1] - trajectory.stamps_ns[start - 1]
        missed = poses[end] - guesses[-1]
        missed[2] = wrap_angle(missed[2])
        guesses += (elapsed_ns / max(1, elapsed_ns[-1]))[:, None] * missed
        guesses[:, 2] = wrap_angles(guesses[:, 2])
        result[start:end] = guesses[:-1]
    return result


def rows_of(trajectory: Trajectory, stamps_ns: IntArray, poses: FloatArray) -> IntArray:
    """Rows of the trajectory that are some keyframes, by stamps (n,) and poses (n, 3), in order.

    Stamps may repeat or step back, so that the two are walked together. Poses may differ by what
    text files round.
    """
    rows: list[int] = []
    for row, stamp in enumerate(trajectory.stamps_ns):  # no lists: of a long log they are large
        number = len(rows)
        if number == len(stamps_ns):
            break
        if stamp != stamps_ns[number]:
            continue
        x, y, turn = (trajectory.poses[row] - poses[number]).tolist()
        if max(abs(x), abs(y), abs(wrap_angle(turn))) <= _SAME:
            rows.append(row)
    return np.array(rows, dtype=np.int64)

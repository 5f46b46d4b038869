"""Pieces of a recording after ways that nothing measured: do they lie where their walls fit?

While no scans are recorded, or none can be registered, a robot may be carried. Afterwards closures
say where it is, each by one submap; where rooms look alike, several may agree and be wrong. So the
map of all that followed is laid on the map of all before, as two maps of one building are. A
piece that fits elsewhere, and there alone, is moved there. Of one that fits in two places nearly as
well nobody can tell where it lies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, Pose2, compose, invert, travelled
from specmap_cli.core.records import Trajectory
from specmap_cli.grids.keyframes import integrate_keyframes
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import Layout, corrected, rows_of
from specmap_cli.pipelines.map_in_making import Breaks
from specmap_cli.pipelines.session import Session
from specmap_cli.quality.evidence import SAME_PLACE_M, Rival, holes_of
from specmap_cli.quality.holes import doubt_of
from specmap_cli.recognition.closure.alignment import MapToAlign, align
from specmap_cli.recognition.closure.verification import are_rivals

# Way of a piece that is looked at: out of a room, and this share of the drive.
_LEAST_M, _LEAST_SHARE = 10.0, 0.05
_BESIDE_M = 2.0  # between ways that a tie joins: walls around both are the same
_TIE_SIGMA_M, _TIE_SIGMA_RAD = 0.1, 0.02  # spread of where whole maps fit


@dataclass(frozen=True, slots=True)
class Pieces:
    """A layout, and what it was made of: closures, the breaks, ties of pieces that were moved.

    `fitting` are the keyframes with which pieces begin that fit here alone; `rivals` are other
    places where pieces fit as well.
    """

    layout: Layout
    closures: tuple[Link, ...]
    breaks: Breaks
    ties: tuple[Link, ...] = ()
    fitting: frozenset[int] = frozenset()
    rivals: tuple[Rival, ...] = ()


def pieces_placed(session: Session, pieces: Pieces, tracked: Trajectory) -> Pieces:
    """The pieces after unmeasured breaks and doubtful holes where their walls fit.

    `tracked` are the poses of all scans. A piece that is moved takes those after it along.
    """
    layout, breaks, store = pieces.layout, pieces.breaks, session.store
    if not len(layout.nodes):
        return pieces
    rows = rows_of(tracked, store.stamps_ns, store.poses)
    holes = holes_of(store, rows, corrected(tracked, store, layout.poses), layout, breaks)
    starts = {hole.keyframe for hole in holes if doubt_of(hole)}
    starts |= {number for number, bridge in breaks.items() if number and bridge is None}
    for start, end in pairwise([*sorted(starts), len(store)]):
        way = travelled(pieces.layout.poses)
        if way[end - 1] - way[start] >= max(_LEAST_M, _LEAST_SHARE * way[-1]):
            pieces = _placed(session, pieces, start, end)
    return pieces


def _placed(session: Session, pieces: Pieces, start: int, end: int) -> Pieces:
    """The piece of the keyframes from `start` to `end` held against all before."""
    poses = pieces.layout.poses
    x, y, _ = poses[start:end].mean(axis=0).tolist()
    middle = Pose2(x, y, 0.0)
    before = _to_align(session, pieces.layout, range(start))
    places = align(before, _to_align(session, pieces.layout, range(start, end))).places
    elsewhere = [motion for motion in places if are_rivals(motion @ middle, middle)]
    fitting = replace(pieces, fitting=pieces.fitting | {start})
    if not elsewhere:
        return fitting if places else pieces
    ties = _ties(pieces.layout, start, end, places[0])
    if len(places) == 1 and ties:
        ties, breaks = (*pieces.ties, *ties), {**pieces.breaks, start: None}
        layout = relax(
            *(session.store, pieces.closures, breaks, session.config.relaxation), ties=ties
        )
        if not layout.agreement.is_worse_than(pieces.layout.agreement):
            return replace(fitting, layout=layout, breaks=breaks, ties=ties)
    away_m = (middle.inverse() @ elsewhere[0] @ middle).distance
    return replace(pieces, rivals=(*pieces.rivals, Rival(start, away_m)))


def _to_align(session: Session, layout: Layout, span: range) -> MapToAlign:
    """The map that the keyframes of a span make, as the alignment takes it."""
    poses = layout.poses[span.start : span.stop]
    whole = integrate_keyframes(session.store, span, poses, session.config.grid).snapshot()
    return MapToAlign(whole=whole, grids={0: whole}, frames={0: IDENTITY})


def _ties(layout: Layout, start: int, end: int, motion: Pose2) -> tuple[Link, ...]:
    """Ties of nodes of a piece that is moved to the nearest ones before: one every some metres."""
    before, after = (
        layout.nodes[(low <= layout.nodes) & (layout.nodes < high)]
        for low, high in ((0, start), (start, end))
    )
    moved = compose(np.array(motion), layout.poses[after])
    away, nearest = cKDTree(layout.poses[before, :2]).query(moved[:, :2])
    stretch = travelled(moved) // SAME_PLACE_M
    ties = []
    for number in np.unique(stretch[away <= _BESIDE_M]).tolist():
        own = np.flatnonzero(stretch == number)
        best = int(own[away[own].argmin()])
        i = int(before[nearest[best]])
        seen = compose(invert(layout.poses[i]), moved[best])
        ends = i, int(after[best])
        ties.append(Link.closure(*ends, Pose2(*seen.tolist()), _TIE_SIGMA_M, _TIE_SIGMA_RAD))
    return tuple(ties)

"""Pieces of a recording after ways that nothing measured: do they lie where their walls fit?

While no scans are recorded, or none can be registered, a robot may be carried. Afterwards closures
say where it is, each by one submap; where rooms look alike, several may agree and be wrong. So the
map of all that followed is laid on the map of all before, as two maps of one building are. A
piece that fits in one place alone is moved there. Of one that fits in two places nearly as
well nobody can tell where it lies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert, travelled
from specmap_cli.core.records import Trajectory
from specmap_cli.grids.keyframes import integrate_keyframes
from specmap_cli.grids.occupancy import OccupancyGrid
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import Layout, corrected, rows_of
from specmap_cli.pipelines.map_in_making import Breaks
from specmap_cli.pipelines.session import Session
from specmap_cli.quality.evidence import SAME_PLACE_M, Rival, holes_of
from specmap_cli.quality.holes import doubt_of
from specmap_cli.recognition.closure.alignment import align
from specmap_cli.recognition.closure.common_ground import MapToAlign
from specmap_cli.recognition.closure.verification import are_rivals

# Way of a piece that is looked at: out of a room, and this share of the drive.
_LEAST_M, _LEAST_SHARE = 10.0, 0.05
_BESIDE_M = 2.0  # between ways that a tie joins: walls around both are the same
_TIE_SIGMA_M, _TIE_SIGMA_RAD = 0.1, 0.02  # spread of where whole maps fit
_NEAR_M, _NEAR_RAD = 0.2, 0.04  # two of these: a piece that is no farther from there lies right


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
    numbers = sorted(starts)

    @cache
    def own() -> FloatArray:
        inner = [
            link
            for link in pieces.closures
            if np.ptp(np.searchsorted(numbers, (link.source, link.target), side="right")) == 0
        ]
        apart = {**breaks, **dict.fromkeys(numbers)}
        return relax(store, inner, apart, session.config.relaxation).poses

    drawn: _Drawn | None = None
    for start, end in pairwise([*numbers, len(store)]):
        way = travelled(pieces.layout.poses)
        if way[end - 1] - way[start] >= max(_LEAST_M, _LEAST_SHARE * way[-1]):
            if drawn is None or drawn.poses is not pieces.layout.poses:
                drawn = _Drawn(session, pieces.layout.poses)
            pieces = _placed(session, pieces, range(start, end), own, drawn)
    return pieces


class _Drawn:
    """The map of a piece as it is laid out, and that of all before it, to which the last one adds.

    Else all before would be drawn anew for each piece.
    """

    def __init__(self, session: Session, poses: FloatArray) -> None:
        self.poses = poses
        self._session, self._end = session, 0
        self._before, self._piece = (OccupancyGrid(session.config.grid) for _ in range(2))

    def go_on(self, span: range) -> tuple[MapToAlign, MapToAlign]:
        """The maps before a piece, the keyframes of a span, and of the piece; in their order."""
        between = range(self._end, span.start)  # a piece that was not asked, and the first one
        for grid in (self._piece, _grid(self._session, self.poses, between)):
            self._before.include(grid)
        self._piece, self._end = _grid(self._session, self.poses, span), span.stop
        return _to_align(self._before), _to_align(self._piece)


def _placed(
    session: Session, pieces: Pieces, span: range, own: Callable[[], FloatArray], drawn: _Drawn
) -> Pieces:
    """A piece, the keyframes of a span, held against all before.

    It is held as it is laid out and `drawn`. Where it does not lie right so, it has `own` poses
    (n, 3), as it is by itself: what ties it to others may be wrong, and bends it.
    """
    start, laid, fit = span.start, pieces.layout.poses, None
    before, here = drawn.go_on(span)
    middle, fitting = start + len(span) // 2, replace(pieces, fitting=pieces.fitting | {start})
    for bent in (True, False):
        poses = laid if bent else own()
        new = here if bent else _to_align(_grid(session, poses, span))
        places = align(before, new).places
        if not places:
            continue
        as_laid = Pose2(*laid[middle].tolist()) @ Pose2(*poses[middle].tolist()).inverse()
        x, y, _ = poses[start : span.stop].mean(axis=0).tolist()
        centre = Pose2(x, y, 0.0)
        offs = [(as_laid @ centre).inverse() @ place @ centre for place in places]
        elsewhere = [off for off in offs if are_rivals(off, IDENTITY)]
        near = offs[0].distance <= _NEAR_M and abs(offs[0].theta) <= _NEAR_RAD
        if near and not elsewhere and start not in pieces.layout.loose:
            return fitting
        fit = poses, places, elsewhere
    if fit is None:
        return pieces
    poses, places, elsewhere = fit
    ties = _ties(pieces.layout, span, compose(np.array(places[0]), poses))
    if len(places) == 1 and ties:
        ties, breaks = (*pieces.ties, *ties), {**pieces.breaks, start: None}
        layout = relax(
            *(session.store, pieces.closures, breaks, session.config.relaxation), ties=ties
        )
        if not layout.agreement.is_worse_than(pieces.layout.agreement):
            return replace(fitting, layout=layout, breaks=breaks, ties=ties)
    if not elsewhere:
        return fitting
    return replace(pieces, rivals=(*pieces.rivals, Rival(start, elsewhere[0].distance)))


def _grid(session: Session, poses: FloatArray, span: range) -> OccupancyGrid:
    """The grid that the keyframes of a span make at poses (n, 3)."""
    placed = poses[span.start : span.stop]
    return integrate_keyframes(session.store, span, placed, session.config.grid)


def _to_align(grid: OccupancyGrid) -> MapToAlign:
    """A map as the alignment takes it."""
    whole = grid.snapshot()
    return MapToAlign(whole=whole, grids={0: whole}, frames={0: IDENTITY})


def _ties(layout: Layout, span: range, poses: FloatArray) -> tuple[Link, ...]:
    """Ties of nodes of a piece that is moved to the nearest ones before: one every some metres.

    `poses` (n, 3) of the keyframes of the piece are those that it is moved to.
    """
    before, after = (
        layout.nodes[(low <= layout.nodes) & (layout.nodes < high)]
        for low, high in ((0, span.start), (span.start, span.stop))
    )
    moved = poses[after]
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

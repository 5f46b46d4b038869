"""The audit: walls of one pass that stand in the free space of another speak against a layout.

Where two passes come by the same place, each should see the walls that the other one saw. A wall
at the same range agrees, and one that is farther was hidden. One that stands nearer contradicts the
layout, unless other views of its own pass looked through it, or saw what is behind: then it is a
person, or a thing that was moved, and the walls are where they were. Views are thinned to one
return a bearing, so that a layout of a whole log is weighed in a fraction of a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, compose
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.path_graph import LOOP_EVERY_M, LOOP_PATH_M, Graph, rows_every

_RANGE_M = 12.0  # farther returns show every error of the heading
_BEARINGS = 180  # two degrees each: neighbours cover what headings err by
_MOST_VIEWS = 4000  # of a log, evenly; 6 MB
_PARTNERS = 4  # views of other passes that each is compared with: the nearest
_TOGETHER = 256  # pairs of views compared at once: some MB
_PARTNER_M = 4.0  # as far as two views see the same walls from about the same side
_SAME_M, _CLEAR_M = 0.2, 0.4  # a wall at the same range, and one that stands clear before it
_CLEAR_SHARE = 0.03  # and per metre of range: walls seen at a low angle
_OWN_STEPS = (-8, -6, -4, -3, -2, -1, 1, 2, 3, 4, 6, 8)  # other views of a pass, of every metre
_CHANGED = 0.03  # share of what two right passes see that changed between them
DOUBTFUL = 0.01  # share of a whole layout; right ones show .5 %, wrong ones 2 % and more
_CLEARLY = 1.2  # times as large a share is not chance in hundreds of readings
_BY_CHANCE = 30  # readings that may newly contradict anywhere: a door that closed
_FEW = 10  # readings that say nothing of a layout: such a door in one view

Ranges = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Agreement:
    """Readings of two passes that agree in a layout, and those that contradict each other.

    `worst` are the nodes of the graph at which many do, or the most, those with the most first.
    """

    agree: int = 0
    contradict: int = 0
    worst: tuple[int, ...] = ()

    def is_worse_than(self, other: Agreement) -> bool:
        """Whether clearly more contradicts here, and not for what newly agrees.

        Where less agrees than before it is the share that counts.
        """
        if self.agree < other.agree and self.is_doubtful and self.share > _CLEARLY * other.share:
            return True
        gained = max(0, self.agree - other.agree)
        allowed = other.contradict + _BY_CHANCE + _CHANGED * (gained + other.contradict)
        return self.contradict > allowed

    @property
    def share(self) -> float:
        """What contradicts, of all that was compared."""
        return self.contradict / max(1, self.agree + self.contradict)

    @property
    def is_doubtful(self) -> bool:
        """Whether more contradicts than doors and the noise of headings explain."""
        return self.contradict > _FEW + DOUBTFUL * self.agree


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """What was seen at `rows` (V,) of a graph: `ranges` (V, B) of the nearest return a bearing.

    +inf where nothing returned. `mounts` (V, 3) are the lasers in the base frame; `way` (V,) as the
    path of the graph.
    """

    rows: IntArray
    ranges: Ranges
    mounts: FloatArray
    way: FloatArray

    @classmethod
    def of(cls, store: KeyframeStore, graph: Graph) -> Views:
        """A view every `LOOP_EVERY_M` of path, fewer on a very long one."""
        every_m = max(LOOP_EVERY_M, float(graph.path[-1]) / _MOST_VIEWS)
        rows = np.array(rows_every(graph.path, every_m), dtype=np.int64)
        numbers = graph.nodes[rows].tolist()
        ranges = np.full((len(numbers), _BEARINGS), np.inf, dtype=np.float32)
        for nearest, number in zip(ranges, numbers, strict=True):
            x, y = store.scan(number).hits(_RANGE_M).T
            share = (np.arctan2(y, x) + np.pi) / (2 * np.pi)
            bins = np.floor(share * _BEARINGS).astype(np.int64) % _BEARINGS
            np.minimum.at(nearest, bins, np.hypot(x, y))
        return cls(
            rows=rows,
            ranges=ranges,
            mounts=np.array([store.base_from_laser(k) for k in numbers]).reshape(-1, 3),
            way=graph.path[rows],
        )

    def agreement(self, poses: FloatArray) -> Agreement:
        """How the views of all passes stand to each other at poses (M, 3) of the graph's nodes."""
        lasers = compose(poses[self.rows], self.mounts)
        older, newer = self.partners(lasers)
        agree, against = 0, np.zeros(len(self.rows), dtype=np.int64)
        for a, b in ((older, newer), (newer, older)):
            for first in range(0, len(a), _TOGETHER):
                some = slice(first, first + _TOGETHER)
                same, pairs = self._compared(lasers, a[some], b[some])
                agree += same
                np.add.at(against, newer[some][pairs], 1)
        contradict = int(against.sum())
        order = np.argsort(-against, kind="stable")
        many = max(int(contradict > 0), int(np.count_nonzero(against > _FEW)))
        worst = self.rows[order[:many]]
        return Agreement(agree, contradict, tuple(worst.tolist()))

    def partners(self, lasers: FloatArray) -> tuple[IntArray, IntArray]:
        """Views of an older pass and a newer one through the same place (P,), the nearest."""
        pairs: list[tuple[int, int]] = []
        tree = cKDTree(lasers[:, :2])
        for newer, way_m in enumerate(self.way.tolist()):
            found = tree.query_ball_point(lasers[newer, :2], _PARTNER_M, return_sorted=True)
            old = np.array(found, dtype=np.int64)
            old = old[self.way[old] < way_m - LOOP_PATH_M]
            away = np.hypot(*(lasers[old, :2] - lasers[newer, :2]).T)
            near = np.flatnonzero(away < _PARTNER_M)
            best = near[np.argsort(away[near], kind="stable")[:_PARTNERS]]
            pairs += [(int(k), newer) for k in old[best]]
        both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        return both[:, 0], both[:, 1]

    def _compared(self, lasers: FloatArray, a: IntArray, b: IntArray) -> tuple[int, IntArray]:
        """How many walls seen from `b` (P,) agree with what `a` saw, and pairs of those against."""
        pair, beam = np.nonzero(np.isfinite(self.ranges[b]))
        bearing = lasers[b[pair], 2] + (beam + 0.5) * (2 * np.pi / _BEARINGS) - np.pi
        reach = self.ranges[b[pair], beam].astype(np.float64)
        walls = lasers[b[pair], :2] + reach[:, None] * _unit(bearing)
        same, clear, farther = self._seen(lasers, a[pair], walls)
        found = np.flatnonzero(clear & ~same)
        pair, walls, views = pair[found], walls[found], b[pair[found]]
        away = walls - lasers[a[pair], :2]
        behind = walls + farther[found, None] * _unit(np.arctan2(away[:, 1], away[:, 0]))
        passing = np.zeros(len(found), dtype=np.bool_)
        for step in _OWN_STEPS:
            own = np.clip(views + step, 0, len(self.rows) - 1)
            near = (own != views) & (np.abs(self.way[own] - self.way[views]) < LOOP_PATH_M)
            passing |= near & self._seen(lasers, own, walls)[1]
            passing |= near & self._seen(lasers, own, behind)[0]
        return int(same.sum()), pair[~passing]

    def _seen(
        self, lasers: FloatArray, views: IntArray, places: FloatArray
    ) -> tuple[BoolArray, BoolArray, FloatArray]:
        """Whether a view (n,) saw a wall at its place (n, 2) or through it; how much farther."""
        away = places - lasers[views, :2]
        share = (np.arctan2(away[:, 1], away[:, 0]) - lasers[views, 2]) / (2 * np.pi) + 0.5
        column = np.floor(share * _BEARINGS).astype(np.int64)
        distance = np.hypot(away[:, 0], away[:, 1])
        around = [self.ranges[views, (column + k) % _BEARINGS] for k in (-1, 0, 1)]
        gaps = np.stack(around).astype(np.float64) - distance
        slack = _CLEAR_SHARE * distance
        same = np.abs(gaps).min(axis=0) < _SAME_M + slack
        clear = np.isfinite(gaps).all(axis=0) & (gaps.min(axis=0) > _CLEAR_M + slack)
        return same, clear, gaps[1]


def _unit(bearing: FloatArray) -> FloatArray:
    """(n, 2) what points to each bearing."""
    return np.column_stack([np.cos(bearing), np.sin(bearing)])

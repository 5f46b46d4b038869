"""The returns of scans in order: the raw material of every feature.

Those of a full circle start after the widest jump. A turn of the robot, which only shifts the
beams, then leaves them as they are, up to a rotation of the plane. The returns of many scans stand
one scan after another in flat arrays; `Segments` says whose they are, and sums them by scan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import DTypeLike, NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray, PlanarScan

Indices = NDArray[np.intp]
_FEWEST = 3  # places that have one to follow
# These define features: classifiers on disk hold thresholds on what comes of them.
PAIR_STEP_M = 0.1
PAIR_STEPS = 120  # distances of pairs are told apart up to 12 m
_PAIR_POINTS = 90  # 4,005 pairs: the shares are good to a percent, and cheap


@dataclass(frozen=True)  # without slots: some properties are computed once
class Segments:
    """n pieces of flat arrays (..., N): piece k is [starts[k], starts[k + 1]), it may be empty."""

    starts: Indices

    @classmethod
    def of_counts(cls, counts: NDArray[Any]) -> Segments:
        """Pieces with so many items (n,) each."""
        return cls(np.concatenate([[0], np.cumsum(counts)]).astype(np.intp))

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def counts(self) -> Indices:
        """(n,) items of each piece."""
        return np.diff(self.starts)

    @cached_property
    def owner(self) -> Indices:
        """(N,) the piece that each item is in."""
        return np.repeat(np.arange(len(self)), self.counts)

    @cached_property
    def place(self) -> Indices:
        """(N,) number of each item within its piece."""
        return np.arange(int(self.starts[-1])) - self.starts[self.owner]

    @cached_property
    def following(self) -> Indices:
        """(N,) the item after each in its piece, the first one after the last."""
        after, filled = np.arange(1, int(self.starts[-1]) + 1), np.flatnonzero(self.counts)
        after[self.starts[filled + 1] - 1] = self.starts[filled]
        return after

    @cached_property
    def last(self) -> BoolArray:
        """(N,) whether an item is the last one of its piece."""
        return self.following <= np.arange(len(self.following))

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """(..., N) for each item the value (..., n) of its piece."""
        return values.take(self.owner, axis=-1)

    def sum(self, values: NDArray[Any]) -> NDArray[Any]:
        """(..., n) sums of values (..., N), nought where empty; truth values are counted."""
        return self._reduced(np.add, values, np.intp if values.dtype == np.bool_ else values.dtype)

    def mean(self, values: NDArray[Any]) -> NDArray[Any]:
        """(..., n) means of values (..., N), nought where empty."""
        return self.sum(values) / np.maximum(self.counts, 1)

    def max(self, values: FloatArray) -> FloatArray:
        """(..., n) the largest of values (..., N), nought where empty."""
        return self._reduced(np.maximum, values, values.dtype)

    def _reduced(self, function: np.ufunc, values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
        """(..., n) values (..., N) of each piece put together by a function, nought where empty."""
        together = np.zeros((*values.shape[:-1], len(self)), dtype=dtype)
        filled = np.flatnonzero(self.counts)
        if len(filled):
            reduced = function.reduceat(values, self.starts[filled], axis=-1, dtype=dtype)
            together[..., filled] = reduced
        return together

    def argmax(self, values: FloatArray) -> Indices:
        """(n,) the first item with the largest of values (N,), the start of a piece without any."""
        at = self.starts[:-1].copy()
        items = np.flatnonzero(values == self.spread(self.max(values)))[::-1]
        at[self.owner[items]] = items  # of several for one piece, the last written stays
        return at

    def cumsum(self, values: FloatArray) -> FloatArray:
        """(N,) the sum of values (N,) from the first of each piece on, added one by one."""
        sums = np.cumsum(self.padded(values, 0.0), axis=1)
        return np.asarray(sums[self.owner, self.place])

    def padded(self, values: NDArray[Any], fill: float, width: int = 0) -> NDArray[Any]:
        """(..., n, w) values (..., N) in rows, `fill` behind the last; at least `width` columns."""
        widest = int(self.counts.max(initial=width))
        rows = np.full((*values.shape[:-1], len(self), widest), fill, dtype=values.dtype)
        rows[..., self.owner, self.place] = values
        return rows

    def kept(self, mask: BoolArray) -> Segments:
        """The pieces of what is left of flat arrays once only `mask` (N,) of them is kept."""
        return Segments.of_counts(self.sum(mask))


def ratio(above: NDArray[Any], below: NDArray[Any]) -> FloatArray:
    """(n,) quotients, nought where `below` is not above nought."""
    quotients = np.zeros(len(below))
    np.divide(above, below, out=quotients, where=below > 0)
    return quotients


def pair_shares(
    segments: Segments,
    values: NDArray[Any],
    bins: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]],
    count: int,
    of_none: int,
) -> FloatArray:
    """(n, count) shares of the pairs of items in each piece, by bins, from values (d, N) of items.

    `bins` gives those of pairs with values (d, 1, w) and (d, v, w), and `of_none` for NaN.
    """
    # Around a circle of an odd number of places each pair has one that comes at most half of them
    # after the other. Places without an item are NaN.
    width = max(_FEWEST, int(segments.counts.max(initial=0)) | 1)
    rows = segments.padded(values, np.nan, width)
    around = np.concatenate([rows, rows[..., : width // 2]], axis=-1)
    firsts, seconds = rows[..., None, :], sliding_window_view(around[..., 1:], width, axis=-1)
    # piece by piece: what is held of the pairs of one stays in the nearest cache of a processor
    counts = np.array(
        [
            np.bincount(bins(firsts[:, k], seconds[:, k]).ravel(), minlength=count)
            for k in range(len(segments))
        ]
    )
    pairs = segments.counts * (segments.counts - 1) // 2
    counts[:, of_none] += pairs - counts.sum(axis=1)
    return np.asarray(counts / np.maximum(1, pairs)[:, None])


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns:
    """The returns of one scan in the order of their bearings.

    `ranges` (N,) and `bearings` (N,); `points` (N, 2) in the laser frame; `steps` (N - 1,) metres
    from each point to the next; `closed` when the sweep is a full circle, whose last point then
    comes before its first; `beams` readings in all, `no_return` of them without a return.
    """

    ranges: FloatArray
    bearings: FloatArray
    points: FloatArray
    steps: FloatArray
    closed: bool
    beams: int
    no_return: int

    def __len__(self) -> int:
        return len(self.ranges)


@dataclass(frozen=True, kw_only=True)  # without slots: some properties are computed once
class ReturnsBatch:
    """The returns of n scans, one scan after another in flat arrays, N returns in all.

    `ranges` and `bearings` (N,); `points` (2, N), x and y in each laser's frame; `onward` (N,)
    metres from each point to the next of its scan, from the last one to the first; `closed` (n,)
    where the sweep is a full circle; `beams` (n,) readings in all, `no_return` (n,) of them without
    a return.
    """

    segments: Segments
    ranges: FloatArray
    bearings: FloatArray
    points: FloatArray
    onward: FloatArray
    closed: BoolArray
    beams: IntArray
    no_return: IntArray

    @classmethod
    def of(cls, scans: Sequence[PlanarScan]) -> ReturnsBatch:
        """The returns of scans. A reading of `range_max` or more, or infinite, is no return.

        Invalid readings, which are NaN or nought, are neither.
        """
        beams = np.array([len(scan.ranges) for scan in scans], dtype=np.int64)
        readings = Segments.of_counts(beams)
        ranges = np.concatenate([np.zeros(0), *(scan.ranges for scan in scans)])
        bearings = np.concatenate([np.zeros(0), *(scan.bearings for scan in scans)])
        valid = ranges > 0.0
        hit = valid & (ranges < readings.spread(np.array([scan.range_max for scan in scans])))
        segments = readings.kept(hit)
        r, b = ranges[hit], bearings[hit]
        points = np.stack([r * np.cos(b), r * np.sin(b)])
        onward = _onward(segments, points)
        closed = np.array([scan.full_circle for scan in scans], dtype=np.bool_)
        # circles begin after their widest jump
        first, counts = segments.starts[:-1], segments.counts
        widest = segments.argmax(onward)
        some = np.flatnonzero(closed & (counts > 2))
        some = some[onward[widest[some]] > onward[first[some] + counts[some] - 1]]
        turned = np.zeros(len(segments), dtype=np.intp)
        turned[some] = (widest - first + 1)[some]
        place = (segments.place + segments.spread(turned)) % segments.spread(counts)
        order = segments.spread(first) + place
        return cls(
            segments=segments,
            ranges=r[order],
            bearings=b[order],
            points=points[:, order],
            onward=onward[order],
            closed=closed,
            beams=beams,
            no_return=readings.sum(valid) - counts,
        )

    def __len__(self) -> int:
        return len(self.segments)

    def __getitem__(self, scan: int) -> Returns:
        """The returns of one of the scans."""
        start, end = self.segments.starts[scan : scan + 2].tolist()
        own = slice(start, end)
        return Returns(
            ranges=self.ranges[own],
            bearings=self.bearings[own],
            points=np.ascontiguousarray(self.points[:, own].T),
            steps=self.onward[start : max(start, end - 1)],
            closed=bool(self.closed[scan]),
            beams=int(self.beams[scan]),
            no_return=int(self.no_return[scan]),
        )

    @property
    def counts(self) -> IntArray:
        """(n,) returns of each scan."""
        return self.segments.counts

    @cached_property
    def range_changes(self) -> tuple[Segments, FloatArray]:
        """How much each range differs from the next, around the circle when it is one."""
        change = np.abs(self.ranges[self.segments.following] - self.ranges)
        told = ~self.segments.last | self.segments.spread(self.closed & (self.counts > 2))
        return self.segments.kept(told), change[told]

    @cached_property
    def polygons(self) -> tuple[Segments, FloatArray]:
        """The vertices (2, M) of the area that each saw: with the laser itself unless a circle."""
        opened = (~self.closed).astype(np.intp)
        segments = Segments.of_counts(self.counts + opened)
        slots = np.arange(len(self.ranges)) + self.segments.spread(np.cumsum(opened))
        vertices = np.zeros((2, int(segments.starts[-1])))
        vertices[:, slots] = self.points
        return segments, vertices

    @cached_property
    def areas_and_perimeters(self) -> tuple[FloatArray, FloatArray]:
        """Square metres and metres (n,) of the polygons, zero with fewer than two returns."""
        segments, vertices = self.polygons
        (x, y), (x_after, y_after) = vertices, vertices[:, segments.following]
        twice = segments.sum(x * y_after - x_after * y)
        perimeter = segments.sum(_onward(segments, vertices))
        some = self.counts >= 2
        return np.where(some, 0.5 * np.abs(twice), 0.0), np.where(some, perimeter, 0.0)

    @cached_property
    def centred(self) -> FloatArray:
        """(2, N) x and y of each return from the mean of all returns of its scan."""
        return np.asarray(self.points - self.segments.spread(self.segments.mean(self.points)))

    @cached_property
    def centroid_distances(self) -> FloatArray:
        """(N,) metres from each return to the mean of all returns of its scan."""
        x, y = self.centred
        return np.asarray(np.sqrt(x * x + y * y))

    @cached_property
    def pair_shares(self) -> FloatArray:
        """(n, 121) share of pairs of returns by distance in steps of 0.1 m, the last one open.

        All pairs of every k-th return of a scan, at most 90 of them, so that it has one histogram.
        """
        every = np.maximum(1, -(-self.counts // _PAIR_POINTS))
        taken = self.segments.place % self.segments.spread(every) == 0
        segments = self.segments.kept(taken)
        points = self.points[:, taken]
        return pair_shares(segments, points, _distance_steps, PAIR_STEPS + 1, PAIR_STEPS)


def _onward(segments: Segments, points: FloatArray) -> FloatArray:
    """(N,) metres from each point (2, N) to the next of its piece, from the last to the first."""
    dx, dy = points[:, segments.following] - points
    return np.asarray(np.sqrt(dx * dx + dy * dy))


def _distance_steps(first: FloatArray, second: FloatArray) -> IntArray:
    """How many steps of 0.1 m pairs of points (2, ...) are apart; the most where one is none."""
    dx, dy = first - second
    dx *= dx
    dy *= dy
    dx += dy
    np.sqrt(dx, out=dx)
    dx *= 1.0 / PAIR_STEP_M
    np.fmin(dx, PAIR_STEPS, out=dx)
    return np.asarray(dx, dtype=np.intp)

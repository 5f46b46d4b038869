"""Joining clusters that no narrowing separates."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.borders import contacts
from specmap_cli.segmentation.kmeans import LabelArray
from specmap_cli.segmentation.visibility import IndexArray

Pair = tuple[int, int]

_RATIO_SLACK = 1e-9  # a border of just the ratio asked for joins, whatever the last digit
_WIDTH_SLACK = 1e-12  # of two borders equal in proportion the first joins
_TINY = 1e-9  # cells; keeps a cluster without width from dividing by zero


def local_widths(
    clearance: FloatArray, lengths: FloatArray, pairs: IndexArray, widest: float
) -> FloatArray:
    """(n,) local thickness at each node: the largest free disc of a visible node that covers it.

    `clearance` (n,) is each node's own, `lengths` (m,) the distances of the visible `pairs` (m, 2).
    No width is above `widest`. A hall falls into pieces no larger than a sight line, and a border
    that is wide compared with those pieces has to count as wide.
    """
    widths = clearance.copy()
    for one, other in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
        covered = lengths < clearance[other]
        np.maximum.at(widths, one[covered], clearance[other[covered]])
    return np.minimum(widths, widest)


def border_widths(labels: LabelArray, clearance: FloatArray) -> dict[Pair, float]:
    """Largest clearance on the common border of each two touching labels (smaller one first)."""
    touching = contacts(labels)
    width = np.minimum(clearance[tuple(touching.one.T)], clearance[tuple(touching.other.T)])
    pairs, which = np.unique(touching.labels, axis=0, return_inverse=True)
    widest = np.zeros(len(pairs))
    np.maximum.at(widest, which.ravel(), width)
    return {(a, b): w for (a, b), w in zip(pairs.tolist(), widest.tolist(), strict=True)}


def join_wide(
    borders: dict[Pair, float], widths: list[FloatArray], ratio: float, percentile: float
) -> list[int]:
    """New label of each cluster after joining pairs, the widest border in proportion first.

    `widths` holds the local widths of each cluster's nodes. A pair joins while its border is at
    least `ratio` times the geometric mean of the two clusters' `percentile` widths: a corridor
    goes on where its width goes on, and ends where it opens into a hall or a room.
    """
    clusters = _Clusters(borders, widths, percentile)
    while (pair := clusters.widest(ratio)) is not None:
        clusters.join(*pair)
    return clusters.names()


class _Clusters:
    """Clusters, their widths and the widths of their borders while they are being joined."""

    def __init__(
        self, borders: dict[Pair, float], widths: list[FloatArray], percentile: float
    ) -> None:
        self._percentile = percentile
        self._nodes = list(widths)
        self._width = [self._width_of(nodes) for nodes in widths]
        self._kept = np.arange(len(widths))  # of each cluster: the one that it is a part of
        self._touching: list[dict[int, float]] = [{} for _ in widths]
        for (one, other), border in borders.items():
            self._touching[one][other] = self._touching[other][one] = border

    def _width_of(self, nodes: FloatArray) -> float:
        return float(np.percentile(nodes, self._percentile)) if len(nodes) else 0.0

    def widest(self, ratio: float) -> Pair | None:
        """The pair with the widest border in proportion, the first of equals, or None."""
        best, pair = ratio - _RATIO_SLACK, None
        for one, around in enumerate(self._touching):
            for other, border in around.items():
                mean = (self._width[one] * self._width[other]) ** 0.5
                if one < other and border > best * mean + _WIDTH_SLACK:
                    best, pair = border / max(mean, _TINY), (one, other)
        return pair

    def join(self, keep: int, gone: int) -> None:
        """Make cluster `gone` a part of `keep`."""
        self._kept[self._kept == gone] = keep
        self._nodes[keep] = np.concatenate([self._nodes[keep], self._nodes[gone]])
        self._width[keep] = self._width_of(self._nodes[keep])
        for other, border in self._touching[gone].items():
            del self._touching[other][gone]
            if other != keep:
                wider = max(border, self._touching[keep].get(other, 0.0))
                self._touching[keep][other] = self._touching[other][keep] = wider
        self._touching[gone] = {}

    def names(self) -> list[int]:
        """The label of every cluster: those that were kept are numbered 0, 1, ... in order."""
        labels: list[int] = np.unique(self._kept, return_inverse=True)[1].tolist()
        return labels

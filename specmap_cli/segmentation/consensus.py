"""One division from several of the same cells: what most of them agree on.

Where the nodes of the visibility graph happen to stand tips what is nearly a tie: a cluster more or
less. Several divisions whose nodes stand elsewhere tip at other places. Two cells belong together
when most of the divisions have them in one region; how alike two regions are is the mean of that
over their cells (Fred and Jain, "Combining Multiple Clusterings Using Evidence Accumulation", IEEE
Transactions on Pattern Analysis and Machine Intelligence, 2005).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.grids.borders import contacts
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.kmeans import LabelArray

_MAJORITY = 0.5  # share of the divisions, and of two regions that are the same one


def consensus(divisions: Sequence[LabelArray]) -> LabelArray:
    """(h, w) labels 0, 1, ... on which most of some divisions (h, w) agree, -1 where all are -1.

    Neighbouring cells that most divisions have in one region are in one region. A region stays for
    itself when at least half of the divisions have it, too; else it joins the neighbour that it is
    most alike to. Deterministic: of equals the first counts.
    """
    if len(divisions) == 1 or all((division < 0).all() for division in divisions):
        return divisions[0]
    atoms, labels = _atoms(divisions)
    area = np.bincount(atoms[atoms >= 0], minlength=len(labels)).astype(np.float64)
    touching = np.unique(contacts(atoms).labels, axis=0)
    region = np.arange(len(labels))
    for members in _groups(labels):
        pairs = np.searchsorted(members, touching[np.isin(touching, members).all(axis=1)])
        region[members] = members[_agreed(labels[members], area[members], pairs)]
    named = np.unique(region, return_inverse=True)[1].astype(np.int32)
    return np.where(atoms < 0, np.int32(-1), named[np.maximum(atoms, 0)])


def _atoms(divisions: Sequence[LabelArray]) -> tuple[LabelArray, IntArray]:
    """Number (h, w) of the set of labels that each cell has, -1 without one; the sets (m, k)."""
    some = np.any([division >= 0 for division in divisions], axis=0)
    columns = [division[some].astype(np.int64) for division in divisions]
    code = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        code, first = _numbered(code * (int(column.max()) + 2) + column + 1)
    atoms = np.full(some.shape, -1, dtype=np.int32)
    atoms[some] = code
    return atoms, np.column_stack([column[first] for column in columns])


def _numbered(codes: IntArray) -> tuple[IntArray, IntArray]:
    """Codes (n,) as numbers 0, 1, ... in the order in which they appear, and where they first do.

    So no number hangs on what the labels are called. Without sorting: n is that of all cells.
    """
    seen = np.full(int(codes.max()) + 1, -1, dtype=np.int64)
    seen[codes[::-1]] = np.arange(len(codes))[::-1]  # the last one to be written is the first
    first = np.sort(seen[seen >= 0])
    seen[codes[first]] = np.arange(len(first))
    return seen[codes], first


def _groups(labels: IntArray) -> list[IntArray]:
    """The atoms that hang together by labels (m, k) that they share, two or more in each group.

    Atoms of different groups are together in no division.
    """
    count = len(labels)
    spans = np.cumsum([0, *(labels.max(axis=0) + 2)])[:-1]
    names = labels + 1 + spans + count
    atoms = np.repeat(np.arange(count), labels.shape[1])
    size = int(names.max(initial=0)) + 1
    links = coo_array((np.ones(names.size), (atoms, names.ravel())), shape=(size, size))
    group = connected_components(links, directed=False)[1][:count]
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    return [part for part in parts if len(part) > 1]


def _agreed(labels: IntArray, area: FloatArray, pairs: IntArray) -> IntArray:
    """The atom (m,) that stands for the region of each, of atoms with `labels` (m, k).

    `area` (m,) is that of each, `pairs` (p, 2) are those that touch.
    """
    regions = _Regions(labels, area, pairs)
    while (pair := regions.most_alike() or regions.least_known()) is not None:
        regions.join(*pair)
    return regions.of


class _Regions:
    """Atoms while they are being joined: `of` (m,) is the atom that stands for each."""

    def __init__(self, labels: IntArray, area: FloatArray, pairs: IntArray) -> None:
        count, divisions = labels.shape
        self._divisions = int(divisions)
        self.of = np.arange(count)
        self._labels, self._cells, self._area = labels, area, area.copy()
        same = (labels[:, None, :] == labels[None, :, :]).sum(axis=2)
        self._together = same * area[:, None] * area  # pairs of cells, over all divisions
        self._touching = np.zeros((count, count), dtype=bool)
        self._touching[pairs[:, 0], pairs[:, 1]] = self._touching[pairs[:, 1], pairs[:, 0]] = True

    def most_alike(self) -> tuple[int, int] | None:
        """The neighbours that are together in most divisions, if they are in a majority."""
        alike = np.where(self._touching, self._alike(), -1.0)
        one, other = divmod(int(alike.argmax()), len(alike))
        return (one, other) if alike[one, other] > _MAJORITY else None

    def least_known(self) -> tuple[int, int] | None:
        """The smallest region that too few divisions have, and its neighbour most alike to it."""
        alike = np.where(self._touching, self._alike(), -1.0)
        unknown = [
            region
            for region in np.unique(self.of).tolist()
            if self._touching[region].any() and not self._is_known(self.of == region)
        ]
        if not unknown:
            return None
        one = min(unknown, key=lambda region: (self._area[region], region))
        return one, int(alike[one].argmax())

    def join(self, one: int, other: int) -> None:
        """Make the two regions one."""
        keep, gone = min(one, other), max(one, other)
        self.of[self.of == gone] = keep
        self._area[keep] += self._area[gone]
        self._together[keep] += self._together[gone]
        self._together[:, keep] += self._together[:, gone]
        self._touching[keep] |= self._touching[gone]
        self._touching[:, keep] |= self._touching[:, gone]
        self._touching[gone] = self._touching[:, gone] = self._touching[keep, keep] = False

    def _alike(self) -> FloatArray:
        """(m, m) the mean share of divisions that have a cell of each in one region."""
        return np.asarray(self._together / (self._divisions * self._area[:, None] * self._area))

    def _is_known(self, inside: BoolArray) -> bool:
        """Whether half of the divisions have about the region of the atoms `inside` (m,)."""
        known = 0
        for column in (self._labels + 1).T:
            whole = np.bincount(column, weights=self._cells)
            shared = np.bincount(column[inside], weights=self._cells[inside], minlength=len(whole))
            either = whole + self._cells[inside].sum() - shared
            known += bool((shared[1:] > _MAJORITY * either[1:]).any())
        return 2 * known >= self._divisions

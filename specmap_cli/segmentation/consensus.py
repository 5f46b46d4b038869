"""One division from several of the same cells: the regions that most of them have.

Where the nodes of the visibility graph happen to stand tips what is nearly a tie: a cluster more or
less. Several divisions whose nodes stand elsewhere tip at other places. A division has a region,
too, when one of its own covers the same ground by more than half. The regions that most divisions
have are taken, those that more of them have first, each with the cells that its finds have in
common. No region is put together from pieces: then a chain of ties would tip it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.segmentation.kmeans import LabelArray

_SAME = 0.5  # intersection over union above which regions are the same: each has one such at most
_HALF = 0.5  # of the cells of a region: more of them taken by others, and it is not taken itself


def consensus(divisions: Sequence[LabelArray]) -> LabelArray:
    """(h, w) labels 0, 1, ... of the regions that most of some divisions (h, w) have.

    Labels are -1 where all divisions have none. Cells of no such region go to the one that they are
    together with most. Deterministic: of equals the first counts.
    """
    if len(divisions) == 1 or all((division < 0).all() for division in divisions):
        return divisions[0]
    atoms, labels = _atoms(divisions)
    area = np.bincount(atoms[atoms >= 0], minlength=len(labels)).astype(np.float64)
    holds = _regions(labels)
    owner = _with_leftovers(_elected(holds, area, len(divisions)), holds, area, labels)
    named = np.unique(owner, return_inverse=True)[1].astype(np.int32)
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


def _regions(labels: IntArray) -> Any:
    """(r, m) sparse: 1 where a region of any division holds an atom; `labels` (m, k) of each atom.

    Regions stand in the order of their divisions.
    """
    spans = np.cumsum([0, *(labels.max(axis=0) + 1)])
    atoms, division = np.nonzero(labels >= 0)
    regions = (labels + spans[:-1])[atoms, division]
    shape = (int(spans[-1]), len(labels))
    return csr_array((np.ones(len(atoms)), (regions, atoms)), shape)


def _elected(holds: Any, area: FloatArray, divisions: int) -> IntArray:
    """(m,) the number of the elected region that each atom goes to, -1 for none.

    An atom goes to the region of whose finds the largest share holds it.
    """
    owner, most = np.full(len(area), -1), np.zeros(len(area))
    for number, share in enumerate(_elections(holds, area, divisions)):
        more = share > most
        owner[more], most[more] = number, share[more]
    return owner


def _elections(holds: Any, area: FloatArray, divisions: int) -> Iterator[FloatArray]:
    """Of each region that is taken, the share (m,) of its finds that hold each atom."""
    same = _same_regions(holds, area)
    size = holds @ area
    finds, alike = np.diff(same.indptr), same.sum(axis=1)
    free, gone = np.ones(len(area), dtype=bool), np.zeros(len(size), dtype=bool)
    for region in np.lexsort((-size, -alike, -finds)).tolist():
        if 2 * finds[region] <= divisions:
            return
        mine = _row(holds, region)
        if gone[region] or area[mine[free[mine]]].sum() <= _HALF * size[region]:
            continue
        found = _row(same, region)
        votes = np.asarray(holds[found].sum(axis=0))
        free &= 2 * votes <= len(found)
        gone[found] = True
        yield votes / len(found)


def _same_regions(holds: Any, area: FloatArray) -> Any:
    """(r, r) sparse: intersection over union of the regions that are the same, each itself, too."""
    shared = (holds.multiply(area) @ holds.T).tocoo()  # numbers of cells: exact in any order
    size = holds @ area
    iou = shared.data / (size[shared.row] + size[shared.col] - shared.data)
    alike = iou > _SAME
    places = shared.row[alike], shared.col[alike]
    same = csr_array((iou[alike], places), shared.shape)
    same.sort_indices()
    return same


def _row(matrix: Any, number: int) -> IntArray:
    """The columns of a row of a sparse matrix that are not zero."""
    return np.asarray(matrix.indices[matrix.indptr[number] : matrix.indptr[number + 1]])


def _with_leftovers(owner: IntArray, holds: Any, area: FloatArray, labels: IntArray) -> IntArray:
    """The region (m,) of each atom, when some have no `owner` (m,).

    They go to the owner of most of the regions that hold them, or stay what the first division
    that has them makes of them.
    """
    left, taken = np.flatnonzero(owner < 0), np.flatnonzero(owner >= 0)
    count = int(owner.max(initial=-1)) + 1
    owner = owner.copy()
    first = labels[left, (labels[left] >= 0).argmax(axis=1)]
    owner[left] = count + first
    if not count or not len(left):
        return owner
    owned = csr_array((area[taken], (taken, owner[taken])), (len(area), count))
    parts = (holds @ owned).multiply(1.0 / (holds @ area)[:, None]).tocsr()
    together = (holds.T.tocsr()[left] @ parts).toarray()
    some = together.any(axis=1)
    owner[left[some]] = together[some].argmax(axis=1)
    return owner

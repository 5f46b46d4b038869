"""Where the regions of a labelled grid touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.records import IntArray


@dataclass(frozen=True, slots=True)
class Contacts:
    """Pairs of cells that share a side and have different labels, none of them -1.

    `labels` (m, 2) of each pair, the smaller one first; `one` and `other` (m, 2) rows and columns
    of its cells. Cells above each other come first, then cells side by side, each in row order.
    """

    labels: IntArray
    one: IntArray
    other: IntArray


def contacts(labels: NDArray[np.signedinteger[Any]]) -> Contacts:
    """All contacts between regions of `labels` (H, W), where -1 is no region."""
    one, other = [], []
    for here, there, step in (
        (labels[:-1], labels[1:], (1, 0)),
        (labels[:, :-1], labels[:, 1:], (0, 1)),
    ):
        cells: NDArray[np.int64] = np.argwhere((here != there) & (here >= 0) & (there >= 0))
        one.append(cells)
        other.append(cells + step)
    first, second = np.concatenate(one), np.concatenate(other)
    pairs = np.column_stack([labels[tuple(first.T)], labels[tuple(second.T)]])
    return Contacts(np.sort(pairs, axis=1).astype(np.int64), first, second)

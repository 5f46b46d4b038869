"""Joining clusters that no narrowing separates."""

from __future__ import annotations

import numpy as np

from specmap_cli.geometry import FloatArray
from specmap_cli.segmentation.kmeans import LabelArray
from specmap_cli.segmentation.visibility import IndexArray

Pair = tuple[int, int]


def local_widths(clearance: FloatArray, lengths: FloatArray, pairs: IndexArray) -> FloatArray:
    """(n,) local thickness at each node: the largest free disc of a visible node that covers it.

    `clearance` (n,) is each node's own, `lengths` (m,) the distances of the visible `pairs` (m, 2).
    """
    widths = clearance.copy()
    for one, other in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
        covered = lengths < clearance[other]
        np.maximum.at(widths, one[covered], clearance[other[covered]])
    return widths


def border_widths(labels: LabelArray, clearance: FloatArray) -> dict[Pair, float]:
    """Largest clearance on the common border of each two touching labels (smaller one first)."""
    keys, values = [], []
    count = int(labels.max(initial=-1)) + 1
    for one, other, here, there in (
        (labels[1:], labels[:-1], clearance[1:], clearance[:-1]),
        (labels[:, 1:], labels[:, :-1], clearance[:, 1:], clearance[:, :-1]),
    ):
        row, column = np.nonzero((one != other) & (one >= 0) & (other >= 0))
        a, b = one[row, column].astype(np.int64), other[row, column].astype(np.int64)
        keys.append(np.minimum(a, b) * count + np.maximum(a, b))
        values.append(np.minimum(here[row, column], there[row, column]))
    key, value = np.concatenate(keys), np.concatenate(values)
    order = np.lexsort((value, key))
    key, value = key[order], value[order]
    last = np.flatnonzero(key != np.append(key[1:], -1))
    return {(int(key[i] // count), int(key[i] % count)): float(value[i]) for i in last}


def join_wide(
    borders: dict[Pair, float], widths: list[FloatArray], ratio: float, percentile: float
) -> list[int]:
    """New label of each cluster after joining pairs, the widest border in proportion first.

    `widths` holds the local widths of each cluster's nodes; a pair joins while its border is at
    least `ratio` times the smaller of the two clusters' `percentile` width.
    """
    parent = list(range(len(widths)))
    members = list(widths)
    width = [float(np.percentile(w, percentile)) if len(w) else 0.0 for w in widths]
    touching: list[dict[int, float]] = [{} for _ in widths]
    for (a, b), value in borders.items():
        touching[a][b] = touching[b][a] = value
    while True:
        best, pair = ratio, None
        for a, around in enumerate(touching):
            for b, value in around.items():
                score = value / max(min(width[a], width[b]), 1e-9)
                if a < b and (score > best or (pair is None and score >= best)):
                    best, pair = score, (a, b)
        if pair is None:
            return _roots(parent)
        keep, gone = pair
        parent[gone] = keep
        members[keep] = np.concatenate([members[keep], members[gone]])
        width[keep] = float(np.percentile(members[keep], percentile))
        for other, value in touching[gone].items():
            del touching[other][gone]
            if other != keep:
                wider = max(value, touching[keep].get(other, 0.0))
                touching[keep][other] = touching[other][keep] = wider
        touching[gone] = {}


def _roots(parent: list[int]) -> list[int]:
    """The kept label of every label, renumbered 0, 1, ... in order."""
    root = list(range(len(parent)))
    for label in root:
        while parent[root[label]] != root[label]:
            root[label] = parent[root[label]]
    names = {label: number for number, label in enumerate(sorted(set(root)))}
    return [names[label] for label in root]

"""Algorithm 2 of the paper: the nodes of a visibility graph into clusters.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification",
IROS 2007, section II-A. Lines 1 and 2 stand in `affinity.py`, the eigenvectors in `spectrum.py`,
k-means in `kmeans.py`; what the default settings add (docs/segmentation.md) stands in
`division.py`, around the algorithm and not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.segmentation.affinity import local_scales, normalised, similarity
from specmap_cli.segmentation.kmeans import LabelArray, kmeans_unit, unit_rows
from specmap_cli.segmentation.parts import parts_of, touched
from specmap_cli.segmentation.spectrum import eigenpairs_above
from specmap_cli.segmentation.visibility import IndexArray, VisibilityGraph


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """What Algorithm 2 found in a graph of n nodes.

    `labels` (n,) 0, 1, ... the cluster of each node; `eigenvalues` (m,) falling, of all parts
    together; `used` is the number of those that count, which is k summed over the parts.
    """

    labels: LabelArray
    eigenvalues: FloatArray
    used: int


def spectral_clusters(graph: VisibilityGraph, config: SegmentationConfig) -> Spectrum:
    """Algorithm 2 on `graph`, lines 3 to 7 for each of its parts by itself.

    Parts are connected components, which no eigenvector joins, and of components with more than
    `part_nodes` nodes what is left when they are cut at their necks. Clusters that a cut touches
    are dissolved and found once more, together with those beyond the cut.
    """
    nodes = len(graph.nodes)
    scales = local_scales(graph.lengths, graph.pairs, nodes, config.neighbours)
    S = similarity(graph.lengths, graph.pairs, scales, nodes)  # Algorithm 2, line 1
    L, degrees = normalised(S)  # Algorithm 2, line 2
    parts = parts_of(S, config.part_nodes)
    first = _clusters_of_parts(L, degrees, parts, config)
    cut = touched(graph.pairs, parts, first.labels)
    if not len(cut):
        return first
    again = [cut[part] for part in parts_of(S[cut][:, cut], config.part_nodes)]
    second = _clusters_of_parts(L, degrees, again, config)
    labels = np.where(second.labels < 0, first.labels, first.labels.max() + 1 + second.labels)
    return replace(first, labels=_numbered(labels))


def _clusters_of_parts(
    L: Any, degrees: FloatArray, parts: Sequence[IndexArray], config: SegmentationConfig
) -> Spectrum:
    """Lines 3 to 7 for some parts of a graph of which L (n, n) is the whole's; -1 outside them.

    What a cut takes from the row of a node stays in its degree: it goes to a neighbour elsewhere.
    """
    found = [clusters_of(L[part][:, part], degrees[part], config.eigenvalue_min) for part in parts]
    return _together(len(degrees), parts, found)


def clusters_of(L: Any, degrees: FloatArray, least: float) -> Spectrum:
    """Lines 3 to 7 of Algorithm 2 for a connected part: L (n, n) sparse, its D_ii `degrees` (n,).

    k is the number of eigenvalues above `least`. k-means starts at the row of the best and of the
    least connected node, so it needs no random numbers.
    """
    values, vectors = eigenpairs_above(L, least)
    k = max(1, int((values > least).sum()))  # Algorithm 2, line 3
    X = vectors[:, :k]  # Algorithm 2, line 4
    Y = unit_rows(X)  # Algorithm 2, line 5
    starts = [int(degrees.argmax()), int(degrees.argmin())]
    labels = kmeans_unit(Y, k, starts)  # Algorithm 2, lines 6 and 7
    return Spectrum(labels=_numbered(labels), eigenvalues=values, used=k)


def _together(nodes: int, parts: Sequence[IndexArray], found: Sequence[Spectrum]) -> Spectrum:
    """One spectrum of a graph from those of its parts, which hold the nodes `parts`."""
    labels = np.full(nodes, -1, dtype=np.int32)
    clusters = 0
    for part, spectrum in zip(parts, found, strict=True):
        labels[part] = clusters + spectrum.labels
        clusters += int(spectrum.labels.max()) + 1
    values = np.concatenate([np.zeros(0), *(spectrum.eigenvalues for spectrum in found)])
    return Spectrum(
        labels=labels,
        eigenvalues=np.sort(values)[::-1],
        used=sum(spectrum.used for spectrum in found),
    )


def _numbered(labels: LabelArray) -> LabelArray:
    """The labels (n,) renamed 0, 1, ... without empty clusters."""
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)

"""Algorithm 2 of the paper: the nodes of a visibility graph into clusters.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification",
IROS 2007, section II-A. Lines 1 and 2 stand in `affinity.py`, the eigenvectors in `spectrum.py`,
k-means in `kmeans.py`; what the default settings add (docs/segmentation.md) stands in
`division.py`, around the algorithm and not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.segmentation.affinity import local_scales, normalised, similarity
from specmap_cli.segmentation.kmeans import LabelArray, kmeans_unit, unit_rows
from specmap_cli.segmentation.spectrum import eigenpairs_above
from specmap_cli.segmentation.visibility import IndexArray, VisibilityGraph


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """What Algorithm 2 found in a graph of n nodes.

    `labels` (n,) 0, 1, ... the cluster of each node; `eigenvalues` (m,) falling and `eigenvectors`
    (n, m), of all connected components together; an eigenvector is zero outside its component.
    `used` of them, which is k summed over the components, chose the clusters.
    """

    labels: LabelArray
    eigenvalues: FloatArray
    eigenvectors: FloatArray
    used: int


def spectral_clusters(graph: VisibilityGraph, config: SegmentationConfig) -> Spectrum:
    """Algorithm 2 on `graph`, lines 3 to 7 for each connected component by itself.

    No eigenvector joins two components, so their spectra may be looked at one after the other.
    """
    nodes = len(graph.nodes)
    scales = local_scales(graph.lengths, graph.pairs, nodes, config.neighbours)
    S = similarity(graph.lengths, graph.pairs, scales, nodes)  # Algorithm 2, line 1
    L, degrees = normalised(S)  # Algorithm 2, line 2
    _, component = connected_components(S, directed=False)
    parts = [np.flatnonzero(component == c) for c in range(int(component.max(initial=-1)) + 1)]
    least = config.eigenvalue_min
    found = [clusters_of(L[part][:, part], degrees[part], least) for part in parts]
    return _together(nodes, parts, found)


def clusters_of(L: Any, degrees: FloatArray, least: float) -> Spectrum:
    """Lines 3 to 7 of Algorithm 2 for a connected graph: L (n, n) sparse, its D_ii `degrees` (n,).

    k is the number of eigenvalues above `least`. k-means starts at the row of the best and of the
    least connected node, so it needs no random numbers.
    """
    values, vectors = eigenpairs_above(L, least)
    k = max(1, int((values > least).sum()))  # Algorithm 2, line 3
    X = vectors[:, :k]  # Algorithm 2, line 4
    Y = unit_rows(X)  # Algorithm 2, line 5
    starts = [int(degrees.argmax()), int(degrees.argmin())]
    labels = kmeans_unit(Y, k, starts)  # Algorithm 2, lines 6 and 7
    named = np.unique(labels, return_inverse=True)[1].astype(np.int32)  # without empty clusters
    return Spectrum(labels=named, eigenvalues=values, eigenvectors=vectors, used=k)


def _together(nodes: int, parts: Sequence[IndexArray], found: Sequence[Spectrum]) -> Spectrum:
    """One spectrum of a graph from those of its components, which hold the nodes `parts`."""
    labels = np.zeros(nodes, dtype=np.int32)
    vectors = np.zeros((nodes, sum(len(spectrum.eigenvalues) for spectrum in found)))
    clusters = column = 0
    for part, spectrum in zip(parts, found, strict=True):
        labels[part] = clusters + spectrum.labels
        clusters += int(spectrum.labels.max()) + 1
        end = column + len(spectrum.eigenvalues)
        vectors[part, column:end] = spectrum.eigenvectors
        column = end
    values = np.concatenate([np.zeros(0), *(spectrum.eigenvalues for spectrum in found)])
    order = np.argsort(-values, kind="stable")
    return Spectrum(
        labels=labels,
        eigenvalues=values[order],
        eigenvectors=vectors[:, order],
        used=sum(spectrum.used for spectrum in found),
    )

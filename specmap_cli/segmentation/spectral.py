"""Segmentation of a grid map: the visibility graph, eq. 1 and Algorithm 2 of the paper.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification",
IROS 2007, section II. What the default settings add (docs/segmentation.md) stands around the
paper's algorithm, not in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.config import SegmentationConfig
from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, GridMap
from specmap_cli.segmentation.affinity import local_scales, normalised, similarity
from specmap_cli.segmentation.clutter import WorkingGrid, small_obstacles, working_grid
from specmap_cli.segmentation.flood import flood_labels, nearest_labels, spread_labels
from specmap_cli.segmentation.halving import split_again
from specmap_cli.segmentation.kmeans import LabelArray, kmeans_unit
from specmap_cli.segmentation.merging import border_widths, join_wide, local_widths
from specmap_cli.segmentation.spectrum import eigenpairs_above
from specmap_cli.segmentation.visibility import (
    IndexArray,
    VisibilityGraph,
    sample_nodes,
    visibility_graph,
)


@dataclass(frozen=True, slots=True)
class Spectrum:
    """What Algorithm 2 found in a graph: `labels` (n,), `eigenvalues` (k,), `eigenvectors` (n, k).

    The eigenpairs are those of all connected components together, falling; an eigenvector is zero
    outside its component. `used` of them chose the clusters.
    """

    labels: LabelArray
    eigenvalues: FloatArray
    eigenvectors: FloatArray
    used: int


@dataclass(frozen=True, slots=True)
class Segmentation:
    """A labelled map and what led to it.

    `labels` (H, W) int32: -1 unlabelled, otherwise 0, 1, ... by falling area; `nodes` (n, 2) x and
    y in metres with their `node_labels` (n,); `pairs` (m, 2) mutually visible nodes; `spectrum` the
    eigenpairs and the clusters they gave.
    """

    labels: LabelArray
    nodes: FloatArray
    node_labels: LabelArray
    pairs: IndexArray
    spectrum: Spectrum

    @property
    def count(self) -> int:
        """Number of regions."""
        return int(self.labels.max(initial=-1)) + 1


def segment(grid: GridMap, config: SegmentationConfig) -> Segmentation:
    """Divide the free space of `grid` into regions.

    The result does not depend on where the map lies on its grid nor on which of the four ways it is
    turned: the work is done on the map cropped and turned to one canonical orientation.
    """
    window, turn = _canonical(grid.free)
    free = np.rot90(grid.free[window], turn)
    sizes = np.array([config.obstacle_m, config.furniture_m, config.furniture_thick_m])
    opened = free | small_obstacles(free, *(sizes / grid.resolution).tolist())
    work = working_grid(opened, grid.resolution, config.cell_m)
    graph = build_graph(work, config)
    spectrum = spectral_clusters(graph, config)
    clusters = spectrum.labels
    if config.halve:
        clusters = split_again(graph, clusters, config.neighbours, config.halve_eigenvalue)
    cells, clusters = _label_cells(work, graph, clusters, config)
    fine = spread_labels(work.refine(cells, opened.shape), opened)
    turned, names = _by_area(fine if config.fill else np.where(free, fine, np.int32(-1)))
    labels = np.full(grid.cells.shape, -1, dtype=np.int32)
    labels[window] = np.rot90(turned, -turn)
    middles = (graph.nodes + 0.5) * work.step - 0.5
    rows_columns = _turned_back(middles, free.shape, turn) + [side.start for side in window]
    nodes = grid.centres_of(rows_columns)
    return Segmentation(labels, nodes, names[clusters], graph.pairs, spectrum)


def build_graph(work: WorkingGrid, config: SegmentationConfig) -> VisibilityGraph:
    """The visibility graph of section II-B; lengths in coarse cells."""
    least = config.clearance_m / work.cell_m
    block = max(1, round(config.node_step_m / work.cell_m))
    nodes = sample_nodes(work.clearance, block, least, config.nodes)
    return visibility_graph(work.clearance, nodes, config.sight_m / work.cell_m, least)


def spectral_clusters(graph: VisibilityGraph, config: SegmentationConfig) -> Spectrum:
    """Algorithm 2 on each connected component of `graph`."""
    nodes = len(graph.nodes)
    scales = local_scales(graph.lengths, graph.pairs, nodes, config.neighbours)
    affinity = similarity(graph.lengths, graph.pairs, scales, nodes)  # Algorithm 2, line 1
    matrix, degrees = normalised(affinity)  # Algorithm 2, line 2
    _, component = connected_components(affinity, directed=False)
    labels = np.zeros(nodes, dtype=np.int32)
    values: list[FloatArray] = []
    columns: list[FloatArray] = []
    clusters = used = 0
    for number in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == number)
        part = matrix[members][:, members]
        found, vectors = eigenpairs_above(part, config.eigenvalue_min)
        k = max(1, int((found > config.eigenvalue_min).sum()))  # Algorithm 2, line 3
        labels[members] = clusters + _cluster_rows(vectors[:, :k], degrees[members])
        clusters, used = int(labels[members].max()) + 1, used + k
        wide = np.zeros((nodes, len(found)))
        wide[members] = vectors
        values.append(found)
        columns.append(wide)
    if not values:
        return Spectrum(labels, np.zeros(0), np.zeros((0, 0)), 0)
    value = np.concatenate(values)
    order = np.argsort(-value, kind="stable")
    return Spectrum(labels, value[order], np.hstack(columns)[:, order], used)


def _cluster_rows(X: FloatArray, degrees: FloatArray) -> LabelArray:
    """(n,) labels 0, 1, ... from the k largest eigenvectors X (n, k); lines 4 to 7."""
    norm = np.sqrt((X**2).sum(axis=1, keepdims=True))
    Y = X / np.maximum(norm, 1e-12)  # Algorithm 2, line 5
    starts = [int(degrees.argmax()), int(degrees.argmin())]
    labels = kmeans_unit(Y, X.shape[1], starts)  # Algorithm 2, lines 6 and 7
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def _label_cells(
    work: WorkingGrid, graph: VisibilityGraph, clusters: LabelArray, config: SegmentationConfig
) -> tuple[LabelArray, LabelArray]:
    """Labels of the coarse cells (h, w), -1 unlabelled, and of the nodes (n,), after merging."""
    if config.labels == "nearest":
        cells = nearest_labels(work.free, graph.nodes, clusters)
    else:
        cells = flood_labels(work.clearance, graph.nodes, clusters)
    if config.merge and len(clusters):
        own = work.clearance[graph.nodes[:, 0], graph.nodes[:, 1]]
        widths = local_widths(own, graph.lengths, graph.pairs, 0.5 * config.sight_m / work.cell_m)
        groups = [widths[clusters == label] for label in range(int(clusters.max()) + 1)]
        borders = border_widths(cells, work.clearance)
        joined = np.array(
            join_wide(borders, groups, config.merge_ratio, config.width_percentile), dtype=np.int32
        )
        clusters = joined[clusters]
        cells = np.where(cells < 0, np.int32(-1), joined[np.maximum(cells, 0)])
    return cells, clusters


def _by_area(labels: LabelArray) -> tuple[LabelArray, LabelArray]:
    """Labels renamed 0, 1, ... by falling number of cells, and the new name of each old label."""
    sizes = np.bincount(labels[labels >= 0])
    names = np.zeros(len(sizes), dtype=np.int32)
    names[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    if not len(names):
        return labels, names
    return np.where(labels < 0, np.int32(-1), names[np.maximum(labels, 0)]), names


def _canonical(free: BoolArray) -> tuple[tuple[slice, slice], int]:
    """The window of the free cells and how many quarter turns make it smallest as bytes."""
    rows, columns = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if not len(rows):
        return (slice(0, 0), slice(0, 0)), 0
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    turned = [np.rot90(free[window], turn) for turn in range(4)]
    return window, min(range(4), key=lambda turn: (turned[turn].shape, turned[turn].tobytes()))


def _turned_back(cells: NDArray[Any], shape: tuple[int, ...], turn: int) -> FloatArray:
    """Rows and columns (n, 2) before `turn` quarter turns led to a picture of `shape`."""
    for _ in range(turn):
        height, width = shape
        cells = np.column_stack([cells[:, 1], height - 1 - cells[:, 0]])
        shape = (width, height)
    return cells

"""Where maps of one building lie in one another: what aligns two, which of several overlap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import networkx as nx

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.settings import Config
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.learning import submap_grids
from specmap_cli.pipelines.map_in_making import LaidOut, submaps_of
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.closure.alignment import Alignment, MapToAlign, align

Overlaps = Mapping[tuple[int, int], Alignment]  # of maps i < j: where j lies in i


# Two map directories, and the settings to align them with: it can be handed to a worker.
PairOfMaps = tuple[Path, Path, Config]
# What a function says of each of many pairs, in their order.
Spread = Callable[[Callable[[PairOfMaps], Alignment], Sequence[PairOfMaps]], Iterable[Alignment]]


def stored_to_align(stored: Map) -> MapToAlign:
    """A stored map as the alignment takes it. Raises MapError for a damaged map."""
    return MapToAlign(
        whole=stored.map_grid,
        grids=stored.grids,
        frames={i: submap.map_from_submap for i, submap in stored.topology.submaps.items()},
    )


def laid_out_to_align(session: Session, laid: LaidOut) -> MapToAlign:
    """A recording that was laid out by itself as the alignment takes it."""
    submaps, poses = submaps_of(laid.labels.submaps), laid.labels.poses
    with session.clock.stage("grids"):
        grids = submap_grids(session, submaps, poses, silent=True)
    return MapToAlign(
        whole=laid.whole,
        grids=grids,
        frames={id_: Pose2(*poses[own[0]].tolist()) for id_, own in submaps.items()},
    )


@one_blas_thread()
def align_pair(pair: PairOfMaps) -> Alignment:
    """Where the map of one directory lies in that of another. Raises MapError for a damaged map."""
    old, new, config = pair
    one, other = (stored_to_align(read_map(path, config.limits)) for path in (old, new))
    return align(one, other)


def overlaps_of(
    maps: Sequence[Map], to_align: Sequence[MapToAlign], config: Config, spread: Spread | None
) -> Overlaps:
    """The pairs of maps that can be aligned: here, or wherever `spread` has it done."""
    pairs = list(combinations(range(len(maps)), 2))
    found: Iterable[Alignment]
    if spread is None:
        found = (align(to_align[i], to_align[j]) for i, j in pairs)
    else:
        paths = [stored.path.resolve() for stored in maps]
        found = spread(align_pair, [(paths[i], paths[j], config) for i, j in pairs])
    return {
        pair: each for pair, each in zip(pairs, found, strict=True) if each.old_from_new is not None
    }


def parts_of(count: int, overlaps: Overlaps) -> list[set[int]]:
    """The maps that hang together, the part of the first map first."""
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from(overlaps)
    return sorted(nx.connected_components(graph), key=min)


def steps_of(count: int, overlaps: Overlaps) -> list[tuple[int | None, int]]:
    """The maps in the order of joining, each with the one that it is laid into; None: beside all.

    Along the alignments that most wall speaks for (a maximum spanning tree).
    """
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    for (i, j), alignment in overlaps.items():
        graph.add_edge(i, j, weight=alignment.evidence_m)
    tree = nx.maximum_spanning_tree(graph)
    steps: list[tuple[int | None, int]] = []
    for part in parts_of(count, overlaps):
        first = min(part)
        steps += [(None, first), *nx.bfs_edges(tree, first, sort_neighbors=sorted)]
    return steps

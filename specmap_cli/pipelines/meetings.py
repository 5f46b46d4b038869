"""Which of several maps meet, and in which order they are joined."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations

import networkx as nx

from specmap_cli.core.settings import Config
from specmap_cli.maps.store import StoredMap
from specmap_cli.pipelines.kept_map import Seen
from specmap_cli.pipelines.known_maps import PairOfMaps, align_pair
from specmap_cli.recognition.closure.alignment import Alignment, align

Meetings = Mapping[tuple[int, int], Alignment]  # of maps i < j: where j lies in i
# What a function says of each of many things, in their order.
Spread = Callable[[Callable[[PairOfMaps], Alignment], Sequence[PairOfMaps]], Iterable[Alignment]]


def meetings_of(
    maps: Sequence[StoredMap], seen: Sequence[Seen], config: Config, spread: Spread | None
) -> Meetings:
    """The pairs of maps that are aligned: here, or wherever `spread` has it done."""
    pairs = list(combinations(range(len(maps)), 2))
    found: Iterable[Alignment]
    if spread is None:
        found = (align(seen[i].known, seen[j].known, config) for i, j in pairs)
    else:
        paths = [stored.path.resolve() for stored in maps]
        found = spread(align_pair, [PairOfMaps(paths[i], paths[j], config) for i, j in pairs])
    return {
        pair: each for pair, each in zip(pairs, found, strict=True) if each.old_from_new is not None
    }


def parts_of(count: int, meetings: Meetings) -> list[set[int]]:
    """The maps that hang together, the part of the first map first."""
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from(meetings)
    return sorted(nx.connected_components(graph), key=min)


def steps_of(count: int, meetings: Meetings) -> list[tuple[int | None, int]]:
    """The maps in the order of joining, each with the one that it is laid into; None: beside all.

    Along the alignments that most wall speaks for (a maximum spanning tree).
    """
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    for (i, j), alignment in meetings.items():
        walls_m = 0.0 if alignment.ground is None else alignment.ground.confirmed_m
        graph.add_edge(i, j, weight=walls_m)
    tree = nx.maximum_spanning_tree(graph)
    steps: list[tuple[int | None, int]] = []
    for part in parts_of(count, meetings):
        first = min(part)
        steps += [(None, first), *nx.bfs_edges(tree, first, sort_neighbors=sorted)]
    return steps

"""Layouts of several recordings solved as one: an old map, and what was recorded later.

Each piece is consistent in itself and lies about where it belongs. The pieces keep the links that
made them so. The new one is tied to the old one by the passes that come by the same walls, which
are looked for along the new path only: the cost is that of the new recording.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import Pose2, compose
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.closing import Closed
from specmap_cli.layout.contradictions import Views
from specmap_cli.layout.motion_edges import MATCH_RANGE_M, Bridge
from specmap_cli.layout.nearby_passes import find_passes
from specmap_cli.layout.path_graph import Draft, Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import Constraint, Finished, Layout, layout_of
from specmap_cli.layout.solving import settle, tighten
from specmap_cli.layout.walls import Walls


def placed(layout: Layout, map_from_own: Pose2, first: int = 0) -> Layout:
    """A layout moved as a whole into another map, its keyframes numbered from `first` on."""
    return replace(
        layout,
        poses=compose(np.array(map_from_own), layout.poses),
        nodes=layout.nodes + first,
        odometry=_renumbered(layout.odometry, first),
        kept=_renumbered(layout.kept, first),
        dropped=_renumbered(layout.dropped, first),
        loose=tuple(start + first for start in layout.loose),
    )


def without_guesses(layout: Layout, starts: Collection[int]) -> Layout:
    """The layout without a word on how far the recordings that begin at `starts` were moved.

    No guess of tracking joined them, of which that would tell.
    """
    moves = tuple(move for move in layout.evidence.parts if move.first not in starts)
    return replace(layout, evidence=replace(layout.evidence, parts=moves))


def join_layouts(
    store: KeyframeStore,
    old: Layout,
    new: Layout,
    ties: Sequence[Constraint],
    breaks: Mapping[int, Bridge | None],
) -> Layout:
    """The layout of a store that holds the keyframes of `old`, then those of `new`.

    Both are in one map frame, `new` numbered as in the store (see `placed`). `ties` are closures
    between the two, `breaks` those of both, the first keyframe of `new` among them. Where nothing
    ties the two in the end that keyframe is among `loose` of the result. Deterministic.
    """
    ends = {end for tie in ties for end in (tie.source, tie.target)}
    graph = graph_of(store, {*old.nodes.tolist(), *new.nodes.tolist(), *ends}, breaks)
    begun = Draft(
        poses=np.concatenate([old.poses, new.poses])[graph.nodes],
        loops=(*old.kept, *new.kept, *(tie.link for tie in ties)),
        tied=_tied(graph, (*old.loose, *new.loose)),
    )
    walls, views = Walls(store, graph, MATCH_RANGE_M), Views.of(store, graph)
    first = graph.row[len(old.poses)]
    passes = find_passes(graph, begun, walls, first)
    draft, dropped = settle(graph, tighten(graph, passes))
    dropped = (*old.dropped, *new.dropped, *dropped)
    finished = Finished.of("relaxed", draft, dropped, views)
    return layout_of(graph, finished, Closed(draft, ()))


def _renumbered(links: Sequence[Link], first: int) -> tuple[Link, ...]:
    return tuple(
        replace(link, source=link.source + first, target=link.target + first) for link in links
    )


def _tied(graph: Graph, loose: Sequence[int]) -> frozenset[int]:
    """The parts whose place is known: all but those that begin with a keyframe in `loose`."""
    guessed = {int(graph.parts[graph.row[start]]) for start in loose}
    return frozenset(graph.part_numbers) - guessed

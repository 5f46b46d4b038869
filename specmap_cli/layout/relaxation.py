"""Relaxation: poses of all keyframes made consistent over everything the robot saw again.

A pose graph over a thinned set of keyframes, tied by the front end's motion, by verified loop
closures of any drift, and by nearby passes, which are looked for here, once the closures have
brought the passes near each other. Robust: closures are judged, what does not fit in the end is
dropped and reported, and a layout that walls contradict is not taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.consistency import CLAIM_SLACK_M, Judgement, judge
from specmap_cli.layout.contradictions import Views
from specmap_cli.layout.parts import place_parts
from specmap_cli.layout.passes import far_passes, find_passes
from specmap_cli.layout.path_graph import Bridge, Draft, Ends, Graph, graph_of
from specmap_cli.layout.pose_graph import Link, errors
from specmap_cli.layout.result import Candidate, Layout
from specmap_cli.layout.solving import settle, solved, tighten
from specmap_cli.layout.walls import Walls

_VOTES_FOR_PART = 2  # closures that must agree on where a piece after a break lies


def relax(
    store: KeyframeStore,
    closures: Sequence[Link],
    breaks: Mapping[int, Bridge | None],
    config: RelaxationConfig,
) -> Layout:
    """The consistent layout of the store's keyframes.

    `closures` are verified and may span any drift; `breaks` are the numbers of keyframes at which
    tracking started afresh, with the `Bridge` over each: how well odometry knows the motion there,
    None where nothing does. A piece after a break with a bridge moves no farther than that allows.
    Scans are read from the store, a few at a time. With `config.enabled` false the poses stay as
    they were tracked. Deterministic.
    """
    if not config.enabled or len(store) < 2:
        return Layout(poses=store.poses)
    ends = {end for closure in closures for end in (closure.source, closure.target)}
    graph = graph_of(store, ends, breaks)
    walls, views = Walls(store, graph), Views.of(store, graph)
    placed = place_parts(graph, closures, _VOTES_FOR_PART)
    passes = find_passes(graph, replace(placed, hints=tuple(closures)), walls)
    passes = solved(graph, passes)
    closed, judged = close(graph, passes, closures, walls)
    draft, outliers = settle(graph, closed)
    refuted = tuple(one.link for one in judged if not one.believed)
    best = Candidate("relaxed", draft, (*refuted, *outliers), views.agreement(draft.poses))
    return Layout.of(graph, chosen(graph, passes, best, views))


def close(
    graph: Graph, draft: Draft, closures: Sequence[Link], walls: Walls
) -> tuple[Draft, tuple[Judgement, ...]]:
    """The draft with the claims that are believed, and what was found of each, in their order.

    Claims are closures, and walls found where none were expected. They bring passes near each other
    that were far apart: these are searched then.
    """
    finds, draft = far_passes(graph, draft, walls)
    judged = judge(graph, draft, [*closures, *finds])
    believed = [one.link for one in judged if one.believed]
    if believed:
        draft = find_passes(graph, tighten(graph, draft.adding(believed)), walls)
    return draft, judged


def chosen(graph: Graph, passes: Draft, best: Candidate, views: Views) -> Candidate:
    """The best layout, or one nearer to what was tracked that fewer walls contradict.

    That is the layout of nearby passes and of the closures that say what these say, or the path as
    it was tracked.
    """
    links = (*best.draft.loops, *best.dropped)
    closures = tuple(link for link in links if link.kind == "closure")
    if closures:
        ends = Ends.of(graph.row, closures)
        away = errors(passes.poses, ends.i, ends.j, ends.z)
        is_near = np.hypot(away[:, 0], away[:, 1]) <= CLAIM_SLACK_M
        alone, outliers = settle(graph, passes.adding(tuple(compress(closures, is_near))))
        dropped = (*compress(closures, ~is_near), *outliers)
        agreement = views.agreement(alone.poses)
        if best.agreement.is_worse_than(agreement):
            best = Candidate("passes", alone, dropped, agreement)
    tracked = views.agreement(graph.poses)
    if best.agreement.is_worse_than(tracked):
        return Candidate("tracked", replace(passes, poses=graph.poses, loops=()), links, tracked)
    return best

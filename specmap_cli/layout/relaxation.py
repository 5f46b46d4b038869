"""Relaxation: poses of all keyframes made consistent over everything the robot saw again.

A pose graph over a thinned set of keyframes, tied by the front end's motion, by verified loop
closures of any drift, and by nearby passes, which are looked for here, once the closures have
brought the passes near each other. Robust: closures are judged, tried, and tried without each group
under suspicion; what does not fit in the end is dropped and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress

from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.consistency import Judgement, judge
from specmap_cli.layout.contradictions import Views
from specmap_cli.layout.parts import place_parts
from specmap_cli.layout.passes import far_passes, find_passes
from specmap_cli.layout.path_graph import Bridge, Draft, Ends, Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.result import Candidate, Layout
from specmap_cli.layout.solving import settle, solved, tighten
from specmap_cli.layout.uncertainty import CLOSURE_SLACK_M, deviations
from specmap_cli.layout.walls import Walls

_VOTES_FOR_PART = 2  # closures that must agree on where a piece after a break lies
_SUSPECTS_MOST = 6  # groups of closures the layout is tried without, when walls contradict
_JUDGE_ROUNDS = 6  # closures are judged, and passes searched, this often at the most
_FOLLOWS_M = 30.0  # of path on both passes: closures nearer than this stand or fall together


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
    closed, judged = close(graph, passes, closures, walls, views)
    draft, outliers = settle(graph, closed)
    refuted = tuple(one.link for one in judged if not one.believed)
    best = Candidate("relaxed", draft, (*refuted, *outliers), views.agreement(draft.poses))
    return Layout.of(graph, chosen(graph, passes, best, views))


def close(
    graph: Graph, draft: Draft, closures: Sequence[Link], walls: Walls, views: Views
) -> tuple[Draft, tuple[Judgement, ...]]:
    """The draft with the closures that are believed, and what was found of each, in their order.

    Passes found far away follow, which are judged like closures. Closures may bring passes near
    each other that were far apart, and those may show that other closures are right: passes are
    searched and the rest is judged again until nothing is new.
    """
    judged: dict[int, Judgement] = {}
    pool, waiting = list(closures), list(range(len(closures)))
    for _ in range(_JUDGE_ROUNDS):
        claims, draft = far_passes(graph, draft, walls)
        waiting += range(len(pool), len(pool) + len(claims))
        pool += claims
        fresh, cut_short = judge(graph, draft, [pool[k] for k in waiting])
        draft = draft.counting("clique_steps", cut_short)
        draft, fresh = _tried(graph, draft, fresh, views)
        judged.update(zip(waiting, fresh, strict=True))
        if not any(one.believed for one in fresh):
            break
        draft = find_passes(graph, draft, walls)
        waiting = [
            k for k in waiting if not judged[k].believed and judged[k].reason != "contradicted"
        ]
    return draft, tuple(judged[k] for k in range(len(pool)))


def _tried(
    graph: Graph, draft: Draft, judged: Sequence[Judgement], views: Views
) -> tuple[Draft, tuple[Judgement, ...]]:
    """The draft with the believed closures, without groups that bring walls into free space."""
    kept = [k for k, one in enumerate(judged) if one.believed]
    if not kept:
        return draft, tuple(judged)
    before = views.agreement(draft.poses)
    trial = tighten(graph, draft.adding([judged[k].link for k in kept]))
    after = views.agreement(trial.poses)
    if after.is_doubtful or after.is_worse_than(before):
        for group in suspects(graph, judged):
            rest = [k for k in kept if k not in group]
            without = tighten(graph, draft.adding([judged[k].link for k in rest]))
            agreement = views.agreement(without.poses)
            if after.is_worse_than(agreement):
                trial, kept, after = without, rest, agreement
    return trial, tuple(
        replace(one, reason="contradicted") if one.believed and k not in kept else one
        for k, one in enumerate(judged)
    )


def suspects(graph: Graph, judged: Sequence[Judgement]) -> list[list[int]]:
    """Groups of believed closures that follow one another, those that mend most first.

    By their numbers. What the layout says anyway, within `CLOSURE_SLACK_M`, is not suspected.
    """
    ends = Ends.of(graph.row, [one.link for one in judged])
    older, newer = graph.path[ends.i], graph.path[ends.j]
    groups: list[list[int]] = []
    for k, one in enumerate(judged):
        if not one.believed or one.reason == "near":
            continue
        along = (abs(older - older[k]) <= _FOLLOWS_M) & (abs(newer - newer[k]) <= _FOLLOWS_M)
        near = [group for group in groups if along[group].any()]
        groups = [group for group in groups if group not in near]
        groups.append([*(other for group in near for other in group), k])
    groups.sort(key=lambda group: -max(judged[k].away_m for k in group))
    return groups[:_SUSPECTS_MOST]


def chosen(graph: Graph, passes: Draft, best: Candidate, views: Views) -> Candidate:
    """The best layout, or one nearer to what was tracked that fewer walls contradict.

    That is the layout of nearby passes and of the closures that say what these say, or the path as
    it was tracked.
    """
    links = (*best.draft.loops, *best.dropped)
    closures = tuple(link for link in links if link.kind == "closure")
    if closures:
        is_near = deviations(graph, passes, closures)[0] <= CLOSURE_SLACK_M
        alone, outliers = settle(graph, passes.adding(tuple(compress(closures, is_near))))
        dropped = (*compress(closures, ~is_near), *outliers)
        agreement = views.agreement(alone.poses)
        if best.agreement.is_worse_than(agreement):
            best = Candidate("passes", alone, dropped, agreement)
    tracked = views.agreement(graph.poses)
    if best.agreement.is_worse_than(tracked):
        return Candidate("tracked", replace(passes, poses=graph.poses, loops=()), links, tracked)
    return best

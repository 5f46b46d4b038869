"""Closures brought into a layout: judged, tried, and tried without each group under suspicion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from specmap_cli.core.geometry import FloatArray
from specmap_cli.layout.contradictions import Views
from specmap_cli.layout.judging import Judged, judge, spread_of
from specmap_cli.layout.nearby_passes import find_passes
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.solving import tighten
from specmap_cli.layout.walls import Walls
from specmap_cli.layout.wide_passes import wide_claims

_SUSPECTS_MOST = 6  # groups of closures the layout is tried without, when walls contradict
_JUDGE_ROUNDS = 6  # closures are judged, and passes searched, this often at the most
_FOLLOWS_M = 30.0  # of path on both passes: closures nearer than this stand or fall together


@dataclass(frozen=True, slots=True)
class Closed:
    """A draft with its closures, and what was found of each."""

    draft: Draft
    judged: tuple[Judged, ...]


def closed(
    graph: Graph,
    draft: Draft,
    closures: Sequence[Link],
    walls: Walls,
    views: Views,
) -> Closed:
    """The draft with the closures that are believed, and what was found of each, in their order.

    Passes found far away follow, which are judged like closures. Closures may bring passes near
    each other that were far apart, and those may show that other closures are right: passes are
    searched and the rest is judged again until nothing is new.
    """
    verdicts: dict[int, Judged] = {}
    pool, waiting = list(closures), list(range(len(closures)))
    for _ in range(_JUDGE_ROUNDS):
        claims = wide_claims(graph, draft, walls, spread_of(graph, draft))
        draft = replace(draft, tried={**draft.tried, **claims.guesses})
        waiting += range(len(pool), len(pool) + len(claims.links))
        pool += claims.links
        judgement = judge(graph, draft, [pool[k] for k in waiting])
        draft = draft.counting("clique_steps", judgement.cut_short)
        draft, fresh = _tried(graph, draft, judgement.closures, views)
        verdicts.update(zip(waiting, fresh, strict=True))
        if not any(one.believed for one in fresh):
            break
        draft = find_passes(graph, draft, walls)
        waiting = [
            k for k in waiting if not verdicts[k].believed and verdicts[k].reason != "contradicted"
        ]
    return Closed(draft, tuple(verdicts[k] for k in range(len(pool))))


def _tried(
    graph: Graph,
    draft: Draft,
    judged: Sequence[Judged],
    views: Views,
) -> tuple[Draft, tuple[Judged, ...]]:
    """The draft with the believed closures, without groups that bring walls into free space."""
    kept = [one for one in judged if one.believed]
    if not kept:
        return draft, tuple(judged)
    before = views.standing(draft.poses)
    trial = _with(graph, draft, kept)
    after = views.standing(trial.poses)
    if after.is_doubtful or after.is_worse_than(before):
        for group in suspects(graph, kept):
            rest = [one for one in kept if one not in group]
            without = _with(graph, draft, rest)
            standing = views.standing(without.poses)
            if after.is_worse_than(standing):
                trial, kept, after = without, rest, standing
    believed = {id(one) for one in kept}
    return trial, tuple(_weighed(one, id(one) in believed) for one in judged)


def suspects(graph: Graph, believed: Sequence[Judged]) -> list[list[Judged]]:
    """Groups of closures that follow one another, those that mend most first.

    What the layout says anyway, within `CLOSURE_SLACK_M`, is not suspected.
    """
    groups: list[list[Judged]] = []
    for one in believed:
        if one.reason == "near":
            continue
        near = [group for group in groups if any(_follow(graph, one, other) for other in group)]
        groups = [group for group in groups if group not in near]
        groups.append([*(other for group in near for other in group), one])
    groups.sort(key=lambda group: -max(one.away_m for one in group))
    return groups[:_SUSPECTS_MOST]


def _follow(graph: Graph, one: Judged, other: Judged) -> bool:
    """Whether two closures are near each other along both passes."""
    a, b = _ways(graph, one.link), _ways(graph, other.link)
    return all(abs(x - y) <= _FOLLOWS_M for x, y in zip(a, b, strict=True))


def _ways(graph: Graph, link: Link) -> FloatArray:
    """(2,) where on the path the two ends of a link lie, the older first."""
    rows = sorted((graph.row[link.source], graph.row[link.target]))
    return graph.path[rows]


def _with(graph: Graph, draft: Draft, closures: Sequence[Judged]) -> Draft:
    """The draft solved with some more closures."""
    links = tuple(one.link for one in closures)
    return tighten(graph, replace(draft, loops=(*draft.loops, *links)))


def _weighed(one: Judged, stays: bool) -> Judged:
    """A verdict after the trial: what was believed and went contradicts what was seen."""
    if not one.believed or stays:
        return one
    return replace(one, believed=False, reason="contradicted")

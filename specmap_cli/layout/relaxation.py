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

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Views
from specmap_cli.layout.consistency import CLAIM_SLACK_M, Judgement, judge
from specmap_cli.layout.passes import PassesOnTheWay, far_passes, find_passes
from specmap_cli.layout.path_graph import (
    Bridge,
    Draft,
    Ends,
    Graph,
    RowPair,
    settle,
    solved,
    tighten,
)
from specmap_cli.layout.pose_graph import Link, errors
from specmap_cli.layout.result import Candidate, Layout, Reason
from specmap_cli.layout.walls import PLACE_NODES, Walls, match_passes

CLOSURE_OFF_M = 0.3  # grids of submaps were compared that near: what lies beyond was not
# Two links agree when they put a part this near: as far as tracking bends a part of some metres.
_SAME_M, _SAME_RAD = 0.5, 0.15


def relax(
    store: KeyframeStore,
    closures: Sequence[Link],
    breaks: Mapping[int, Bridge | None],
    config: RelaxationConfig,
    passes: PassesOnTheWay | None = None,
    ties: Sequence[Link] = (),
) -> Layout:
    """The consistent layout of the store's keyframes.

    `closures` are verified and may span any drift; `breaks` are the numbers of keyframes at which
    tracking started afresh, with the `Bridge` over each: how well odometry knows the motion there,
    None where nothing does. A piece after a break with a bridge moves no farther than that allows.
    `passes` is the search for nearby passes, where it has begun on the way. `ties` place pieces
    after a break as a whole, and are believed. Scans are read from the store, a few at a time. With
    `config.enabled` false the poses stay as they were tracked. Deterministic.
    """
    if not config.enabled or len(store) < 2:
        return Layout(poses=store.poses)
    ends = {end for link in (*closures, *ties) for end in (link.source, link.target)}
    graph, walls, found = (passes or PassesOnTheWay(store)).ended(breaks, ends)
    if ties:
        placed = place_parts(graph, found, ties).adding(ties)
        found = find_passes(graph, tighten(graph, placed), walls)
    views, tied = Views.of(store, graph), solved(graph, found)
    closed, judged = close(graph, tied, closures, walls)
    draft, outliers = settle(graph, closed)
    refuted = tuple(one.link for one in judged if not one.believed)
    best = Candidate("relaxed", draft, (*refuted, *outliers), views.agreement(draft.poses))
    layout = Layout.of(graph, chosen(graph, tied, best, views))
    return replace(layout, why=explained(layout, judged))


def measured(graph: Graph, walls: Walls, claim: Link) -> Link | None:
    """A claim told more precisely, by the walls around its two keyframes; None unless these fit.

    Grids of whole submaps, and walls of many nodes, match to their cells, which lie otherwise in
    another frame; and a path that drifts within them bends them.
    """
    rows = graph.row[claim.source], graph.row[claim.target]
    guess = claim.source_from_target
    near = match_passes(graph, walls, graph.poses, rows, guess, CLOSURE_OFF_M, PLACE_NODES)
    if near is None or (guess.inverse() @ near.source_from_target).distance > CLOSURE_OFF_M:
        return None
    return replace(claim, source_from_target=near.source_from_target)


def close(
    graph: Graph, draft: Draft, closures: Sequence[Link], walls: Walls, first: int = 0
) -> tuple[Draft, tuple[Judgement, ...]]:
    """The draft with the claims believed, and what was found of each, in order.

    Claims are closures, and walls found from row `first` on where none were expected. They bring
    passes near each other, which are searched then.
    """
    claims = (*closures, *far_passes(graph, draft, walls, first))
    judged = judge(graph, draft, [measured(graph, walls, claim) or claim for claim in claims])
    believed = [one.link for one in judged if one.believed]
    if believed:
        draft = place_parts(graph, draft, believed).adding(believed)
        draft = find_passes(graph, tighten(graph, draft), walls, first)
    return draft, judged


def explained(layout: Layout, judged: Sequence[Judgement]) -> dict[RowPair, Reason]:
    """Why each link of a layout was dropped, by its ends."""
    judgements = {(one.link.source, one.link.target): one.reason for one in judged}
    found: dict[RowPair, Reason] = {}
    for link in layout.dropped:
        reason = judgements.get((link.source, link.target))
        if reason == "impossible" or reason == "outvoted" or reason == "alone":
            found[link.source, link.target] = reason
        else:
            found[link.source, link.target] = "outlier" if layout.choice == "relaxed" else "walls"
    return found


def place_parts(graph: Graph, draft: Draft, links: Sequence[Link]) -> Draft:
    """The draft with each part moved as a whole to where most links to older parts put it.

    A robust solution takes what is metres off for an outlier. Parts that hang on a moved one move
    with it. Those without a link stay a guess.
    """
    ends = Ends.of(graph.row, links)
    older, newer = ends.parts(graph)
    for part in graph.part_numbers[1:]:
        across = (newer == part) & (older < part)
        if part in draft.tied or not across.any():
            continue
        claimed = compose(draft.poses[ends.i[across]], ends.z[across])
        motions = compose(claimed, invert(draft.poses[ends.j[across]]))  # of the map
        centre = draft.poses[graph.parts == part, :2].mean(axis=0)
        poses, later = np.array(draft.poses), graph.parts >= part
        poses[later] = compose(most_voted(motions, centre)[0], poses[later])
        draft = replace(draft, poses=poses, tied=draft.tied | {part})
    return draft


def most_voted(motions: FloatArray, centre: FloatArray) -> tuple[FloatArray, int]:
    """The motion that most others agree with, and how many do, itself included.

    `centre` (2,) is where the motions (L, 3) are compared: a turn far from the origin moves much.
    The first of equals is taken.
    """
    placed = compose(motions, np.array([centre[0], centre[1], 0.0]))
    apart = np.hypot(*(placed[:, None, :2] - placed[None, :, :2]).transpose(2, 0, 1))
    turned = np.abs(wrap_angles(placed[:, None, 2] - placed[None, :, 2]))
    votes = ((apart <= _SAME_M) & (turned <= _SAME_RAD)).sum(axis=1)
    best = int(votes.argmax())
    return motions[best], int(votes[best])


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

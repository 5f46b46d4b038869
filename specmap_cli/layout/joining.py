"""Layouts of several recordings solved as one, and a layout without some of its keyframes.

An old map and what was recorded later are each consistent in itself and lie about where they
belong. They keep the links that made them so. The new one is tied to the old one by the passes that
come by the same walls, which are looked for along the new path only: the cost is that of the new
recording.

Where keyframes are left out, what was known of them is said of their neighbours. The poses of the
others stay. Where the path has a gap its motion is the one that was laid out, so that what tracking
had drifted by meanwhile does not come back. A link that ended in a keyframe that is gone ends in
the next of its recording along the way, and is less sure by the error of that way.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, inverse3, invert, step_lengths
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Views
from specmap_cli.layout.consistency import Uncertainty
from specmap_cli.layout.passes import find_passes
from specmap_cli.layout.path_graph import (
    NODE_M,
    Bridge,
    Draft,
    chosen_nodes,
    graph_of,
    motion_links,
    settle,
    tighten,
)
from specmap_cli.layout.pose_graph import Link, adjoint, moved_covariance
from specmap_cli.layout.relaxation import close, explained, measured
from specmap_cli.layout.result import Candidate, Layout
from specmap_cli.layout.walls import Walls

# What a layout knows of two places that walls tie, seen by several passes: two fifths of a cell of
# 5 cm, and as much 4 m away.
_LAID_OUT = Bridge(0.02, 0.005)


def placed(layout: Layout, map_from_own: Pose2, first: int = 0) -> Layout:
    """A layout moved as a whole into another map, its keyframes numbered from `first` on."""
    odometry, kept, dropped = (
        tuple(replace(one, source=one.source + first, target=one.target + first) for one in links)
        for links in (layout.odometry, layout.kept, layout.dropped)
    )
    return replace(
        layout,
        poses=compose(np.array(map_from_own), layout.poses),
        nodes=layout.nodes + first,
        odometry=odometry,
        kept=kept,
        dropped=dropped,
        why={(a + first, b + first): reason for (a, b), reason in layout.why.items()},
        loose=tuple(start + first for start in layout.loose),
    )


def join_layouts(
    store: KeyframeStore,
    old: Layout,
    new: Layout,
    ties: Sequence[Link],
    breaks: Mapping[int, Bridge | None],
) -> Layout:
    """The layout of a store that holds the keyframes of `old`, then those of `new`.

    Both are in one map frame, `new` numbered as in the store (see `placed`). `ties` are closures
    between the two: those count that walls around their ends measure anew, all if none does.
    `breaks` are those of both, the first keyframe of `new` among them. Where nothing ties the two
    in the end that keyframe is among `loose` of the result. Deterministic.
    """
    ends = {end for tie in ties for end in (tie.source, tie.target)}
    graph = graph_of(store, {*old.nodes.tolist(), *new.nodes.tolist(), *ends}, breaks)
    guessed = {int(graph.parts[graph.row[start]]) for start in (*old.loose, *new.loose)}
    walls, views = Walls(store, graph), Views.of(store, graph)
    # submaps of which little is seen in both maps match some decimetres off
    precise = list[Link]()
    for tie in ties:
        near = measured(graph, walls, tie)
        precise += [] if near is None else [near]
    begun = Draft(
        poses=np.concatenate([old.poses, new.poses])[graph.nodes],
        loops=(*old.kept, *new.kept, *(precise or ties)),
        tied=frozenset(graph.part_numbers) - guessed,
    )
    first = graph.row[len(old.poses)]
    passes = tighten(graph, find_passes(graph, begun, walls, first))
    closed, judged = close(graph, passes, (), walls, first)
    draft, dropped = settle(graph, closed)
    refuted = (one.link for one in judged if not one.believed)
    dropped = (*old.dropped, *new.dropped, *refuted, *dropped)
    agreement = views.agreement(draft.poses)
    layout = Layout.of(graph, Candidate("relaxed", draft, dropped, agreement))
    return replace(layout, why={**explained(layout, judged), **old.why, **new.why})


def gaps_of(poses: FloatArray, thinned: IntArray) -> dict[int, Bridge]:
    """The keyframes that come after gaps, and how well the motion over each gap is known.

    `poses` (n, 3) are those of all keyframes, `thinned` (n,) the recordings that some were taken
    from, -1 for one that is whole. A step longer than those between nodes is a gap there.
    """
    far = step_lengths(poses) > NODE_M
    after = 1 + np.flatnonzero(far & (thinned[1:] >= 0) & (thinned[1:] == thinned[:-1]))
    return dict.fromkeys(after.tolist(), _LAID_OUT)


def tracked_over_gaps(
    tracked: FloatArray, placed: FloatArray, numbers: IntArray, gaps: Collection[int]
) -> FloatArray:
    """(k, 3) the poses of some keyframes, ascending, as if only these had been tracked.

    `tracked` (n, 3) are the poses of all as registered, `placed` (n, 3) those of the layout: over
    `gaps`, which are known by the keyframes after them, counted among the k, and where any are left
    out the motion is that of the layout.
    """
    skipped = (1 + np.flatnonzero(np.diff(numbers) != 1)).tolist()
    starts = sorted({0, *skipped, *gaps})
    parts = [tracked[numbers[: starts[1] if len(starts) > 1 else None]]]
    for start, end in pairwise([*starts[1:], len(numbers)]):
        before, first = numbers[start - 1], numbers[start]
        gap = compose(invert(placed[before]), placed[first])
        begun = compose(parts[-1][-1], gap)
        since = compose(invert(tracked[first]), tracked[numbers[start:end]])
        parts.append(compose(begun, since))
    return np.concatenate(parts)


def without_keyframes(
    store: KeyframeStore,
    layout: Layout,
    numbers: IntArray,
    recordings: IntArray,
    breaks: Mapping[int, Bridge | None],
) -> Layout:
    """The layout of the keyframes `numbers` (k,) alone, ascending, which get new numbers from 0 on.

    `store` and `breaks`, gaps among them, are those of the new numbers already; `recordings` (n,)
    are those of all keyframes, of each of which some are left. What was found out about the layout
    stays as it was said of all of them.
    """
    row = {number: k for k, number in enumerate(numbers.tolist())}
    links = _links_of(layout, numbers, recordings)
    kept = tuple(replace(one, source=row[one.source], target=row[one.target]) for one in links)
    ends = {end for link in kept for end in (link.source, link.target)}
    old = {row[node] for node in layout.nodes.tolist() if node in row}
    nodes = chosen_nodes(store.poses, {*old, *ends, *breaks})
    known = {(one.source, one.target): one for one in layout.odometry}  # by their old numbers
    motions: list[Link] = []
    for source, target in pairwise(nodes.tolist()):
        one = known.get((int(numbers[source]), int(numbers[target])))
        if one is None:
            motions += motion_links(store, np.array([source, target]), breaks)
        else:
            motions.append(replace(one, source=source, target=target))
    agreement = layout.agreement
    left = np.searchsorted(numbers, layout.nodes[list(agreement.worst)])  # or the next that is left
    worst = np.minimum(np.searchsorted(nodes, left), len(nodes) - 1)
    agreement = replace(agreement, worst=tuple(dict.fromkeys(worst.tolist())))
    return replace(
        layout,
        poses=layout.poses[numbers],
        nodes=nodes,
        agreement=agreement,
        odometry=tuple(motions),
        kept=kept,
        dropped=(),
        why={},
        loose=tuple(row[start] for start in layout.loose),
    )


def _links_of(layout: Layout, numbers: IntArray, recordings: IntArray) -> list[Link]:
    """Links by old numbers; ends that are gone move along the way, and one a pair is kept then."""
    nearest = np.arange(len(recordings))
    kept = np.isin(nearest, numbers)
    for recording in np.unique(recordings[~kept]).tolist():
        own = recordings == recording
        left, gone = np.flatnonzero(own & kept), np.flatnonzero(own & ~kept)
        after = np.clip(np.searchsorted(left, gone), 1, max(1, len(left) - 1))
        before, after = left[after - 1], left[np.minimum(after, len(left) - 1)]
        nearest[gone] = np.where(gone - before <= after - gone, before, after)
    links = [one for one in layout.kept if kept[one.source] and kept[one.target]]
    pairs = {frozenset((one.source, one.target)) for one in links}
    spread = Uncertainty.along(layout.poses[layout.nodes], layout.odometry, 0.0)
    for one in layout.kept:
        source, target = int(nearest[one.source]), int(nearest[one.target])
        pair = frozenset((source, target))
        if len(pair) == 2 and pair not in pairs:
            pairs.add(pair)
            links.append(_between(layout, spread, source, target, one))
    return links


def _between(layout: Layout, spread: Uncertainty, source: int, target: int, link: Link) -> Link:
    """A link moved to two other keyframes as laid out; to its error comes that of the ways."""
    ends = layout.poses[[source, link.source, link.target, target]]
    rows = np.searchsorted(layout.nodes, [source, link.source, link.target, target], side="right")
    way_there, way_on = (
        spread.between(rows[k : k + 1] - 1, rows[k + 1 : k + 2] - 1) for k in (0, 2)
    )
    seen = adjoint(compose(invert(ends[3]), ends[1:3]))  # the ends of the link from the new target
    covariance = (
        moved_covariance(seen[:1], way_there)
        + moved_covariance(seen[1:], inverse3(link.information[None]))
        + way_on
    )
    return replace(
        link,
        source=source,
        target=target,
        source_from_target=Pose2(*compose(invert(ends[0]), ends[3]).tolist()),
        information=inverse3(covariance)[0],
    )

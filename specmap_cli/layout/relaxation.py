"""The layout: poses of all keyframes made consistent over everything the robot saw again.

A pose graph over a thinned set of keyframes, tied by the front end's motion, by verified loop
closures of any drift, and by nearby passes, which are looked for here, once the closures have
brought the passes near each other. Robust: what does not fit in the end is dropped and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.core.text import counted
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.carrying import carried, keyframe_rows
from specmap_cli.layout.drift import sort_by_drift
from specmap_cli.layout.nearby_passes import find_passes
from specmap_cli.layout.parts import loose_starts, place_parts
from specmap_cli.layout.path_graph import Draft, Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.solving import settle, solved, tighten
from specmap_cli.layout.walls import Walls


@dataclass(frozen=True, slots=True)
class Constraint:
    """A verified loop closure between two keyframes, by their numbers in the store.

    `information` (3, 3) weighs the error of `source_from_target` in the target's frame.
    """

    source: int
    target: int
    source_from_target: Pose2
    information: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Relaxed poses (n, 3) of all keyframes, and the pose graph they come from.

    `nodes` are the keyframe numbers in the graph; `odometry`, `kept` and `dropped` its edges, the
    last two being closures and nearby passes. `loose` are the keyframes at which tracking restarted
    and whose place, and that of what follows, is a guess. `limits` counts by the name of a setting
    how often it cut the work short, if it did: passes searched less far than the path may have
    drifted (`loop_search_max_m`), parts given up (`stray_tries`), searches made coarser
    (`stray_cells`), solutions stopped before they had settled (`solve_iterations`).
    """

    poses: FloatArray
    nodes: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    odometry: tuple[Link, ...] = ()
    kept: tuple[Link, ...] = ()
    dropped: tuple[Link, ...] = ()
    warnings: tuple[str, ...] = ()
    loose: tuple[int, ...] = ()
    limits: Mapping[str, int] = field(default_factory=dict)


def relax(
    store: KeyframeStore,
    constraints: Sequence[Constraint],
    breaks: Sequence[int],
    config: RelaxationConfig,
) -> Layout:
    """The consistent layout of the store's keyframes.

    `constraints` come from verified closures and may span any drift; `breaks` are the numbers of
    keyframes at which tracking started afresh. Scans are read from the store, a few at a time.
    With `config.enabled` false the poses stay as they were tracked. Deterministic.
    """
    if not config.enabled or len(store) < 2:
        return Layout(poses=store.poses)
    closures = [_closure(constraint) for constraint in constraints]
    ends = {end for closure in closures for end in (closure.source, closure.target)}
    graph = graph_of(store, ends, breaks, config)
    walls = Walls(store, graph, config.match_range_m)
    draft = find_passes(graph, place_parts(graph, closures), walls, config)
    draft = solved(graph, draft, config)
    found = sort_by_drift(graph, draft, closures, config)
    draft = replace(draft, loops=(*draft.loops, *found.near, *found.far))
    if found.far:  # they may bring passes near each other that were far apart
        draft = find_passes(graph, tighten(graph, draft, config), walls, config)
    draft, dropped = settle(graph, draft, config)
    return _layout(store, graph, draft, (*found.refuted, *dropped), config)


def corrected(trajectory: Trajectory, store: KeyframeStore, layout: Layout) -> Trajectory:
    """The trajectory of every registered scan, moved with the keyframes of a layout."""
    anchors = keyframe_rows(trajectory, store)
    return replace(trajectory, poses=carried(trajectory.poses, anchors, layout.poses))


def _closure(constraint: Constraint) -> Link:
    return Link(
        source=constraint.source,
        target=constraint.target,
        source_from_target=constraint.source_from_target,
        information=constraint.information,
        kind="closure",
    )


def _layout(
    store: KeyframeStore,
    graph: Graph,
    draft: Draft,
    dropped: tuple[Link, ...],
    config: RelaxationConfig,
) -> Layout:
    """The layout of all keyframes from the settled draft of the nodes."""
    loose = loose_starts(graph, draft.loops)
    spent = [part for part, tries in draft.tries.items() if tries >= config.stray_tries]
    given_up = sum(part not in draft.tied for part in spent)
    return Layout(
        poses=carried(graph.tracked, graph.nodes, draft.poses),
        nodes=graph.nodes,
        odometry=graph.odometry,
        kept=draft.loops,
        dropped=dropped,
        warnings=_warnings(dropped, [store.stamps_ns[keyframe] for keyframe in loose]),
        loose=loose,
        limits=draft.counting("stray_tries", given_up).limits,
    )


def _warnings(dropped: Sequence[Link], loose_stamps_ns: Sequence[int]) -> tuple[str, ...]:
    """What a user should know about the layout."""
    closures = sum(link.kind == "closure" for link in dropped)
    verb = "contradicts" if closures == 1 else "contradict"
    left_out = [f"layout: {counted(closures, 'loop closure')} {verb} the rest: left out"]
    guessed = [
        f"layout: a guess only places what follows {stamp_ns * 1e-9:.3f} s"
        for stamp_ns in loose_stamps_ns
    ]
    return (*(left_out if closures else []), *guessed)

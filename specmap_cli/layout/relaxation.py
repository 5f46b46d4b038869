"""The layout: poses of all keyframes made consistent over everything the robot saw again.

A pose graph over a thinned set of keyframes, tied by the front end's motion, by verified loop
closures of any drift, and by nearby passes, which are looked for here, once the closures have
brought the passes near each other. Robust: what does not fit in the end is dropped and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.carrying import bridged, carried, keyframe_rows
from specmap_cli.layout.closing import Closed, closed
from specmap_cli.layout.contradictions import Standing, Views
from specmap_cli.layout.drift import CLOSURE_SLACK_M, deviations
from specmap_cli.layout.evidence import (
    Choice,
    Healing,
    LayoutEvidence,
    part_moves,
    settled_verdicts,
)
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.nearby_passes import find_passes
from specmap_cli.layout.parts import loose_starts, place_parts
from specmap_cli.layout.path_graph import Breaks, Draft, Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.solving import settle, solved
from specmap_cli.layout.strays import STRAY_TRIES
from specmap_cli.layout.walls import Walls

_PART_VOTES = 2  # closures that must agree on where a piece after a break lies


@dataclass(frozen=True, slots=True)
class Constraint:
    """A verified loop closure between two keyframes, by their numbers in the store.

    `information` (3, 3) weighs the error of `source_from_target` in the target's frame.
    """

    source: int
    target: int
    source_from_target: Pose2
    information: FloatArray

    @property
    def link(self) -> Link:
        """The edge of the pose graph."""
        return Link(
            source=self.source,
            target=self.target,
            source_from_target=self.source_from_target,
            information=self.information,
            kind="closure",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Relaxed poses (n, 3) of all keyframes, and the pose graph they come from.

    `nodes` are the keyframe numbers in the graph; `odometry`, `kept` and `dropped` its edges, the
    last two being closures and nearby passes. `loose` are the keyframes at which tracking restarted
    and whose place, and that of what follows, is a guess. `evidence` tells what was judged and how
    far things moved, `healing` what the audit mended, if anything. `limits` count passes searched
    less far than the path may have drifted (`loop_search_max_m`), parts given up (`stray_tries`),
    searches made coarser (`stray_cells`), sets of closures that may not be the largest
    (`clique_steps`), solutions stopped before they had settled (`solve_iterations`).
    """

    poses: FloatArray
    nodes: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    odometry: tuple[Link, ...] = ()
    kept: tuple[Link, ...] = ()
    dropped: tuple[Link, ...] = ()
    loose: tuple[int, ...] = ()
    evidence: LayoutEvidence = field(default_factory=LayoutEvidence)
    healing: Healing | None = None

    @property
    def limits(self) -> Mapping[str, int]:
        """How often a setting cut the work short, by its name."""
        return self.evidence.limits


def relax(
    store: KeyframeStore,
    constraints: Sequence[Constraint],
    breaks: Breaks,
    config: RelaxationConfig,
) -> Layout:
    """The consistent layout of the store's keyframes.

    `constraints` come from verified closures and may span any drift; `breaks` are the numbers of
    keyframes at which tracking started afresh, or these with the `Bridge` over each break: how well
    odometry knows the motion there, None where nothing does. A piece after a break with a bridge
    moves no farther than that allows. Scans are read from the store, a few at a time.
    With `config.enabled` false the poses stay as they were tracked. Deterministic.
    """
    if not config.enabled or len(store) < 2:
        return Layout(poses=store.poses)
    closures = [constraint.link for constraint in constraints]
    ends = {end for closure in closures for end in (closure.source, closure.target)}
    graph = graph_of(store, ends, breaks)
    walls, views = Walls(store, graph, MATCH_RANGE_M), Views.of(store, graph)
    placed = place_parts(graph, closures, _PART_VOTES)
    passes = find_passes(graph, replace(placed, hints=tuple(closures)), walls)
    passes = solved(graph, passes)
    found = closed(graph, passes, closures, walls, views)
    draft, dropped = settle(graph, found.draft)
    judged = settled_verdicts(found.judged, dropped)
    refuted = tuple(one.link for one in found.judged if not one.believed)
    tracked = views.standing(graph.poses)
    finished = Finished.of("relaxed", draft, (*refuted, *dropped), views)
    finished = chosen(graph, passes, finished, tracked, views)
    return layout_of(graph, finished, replace(found, judged=judged))


@dataclass(frozen=True, slots=True)
class Finished:
    """A draft that is settled, the links it was settled without, and what it is made of.

    `standing` is how its passes stand to each other.
    """

    choice: Choice
    draft: Draft
    dropped: tuple[Link, ...]
    standing: Standing

    @classmethod
    def of(
        cls,
        choice: Choice,
        draft: Draft,
        dropped: tuple[Link, ...],
        views: Views,
    ) -> Finished:
        """The draft, weighed by what was seen along it."""
        return cls(choice, draft, dropped, views.standing(draft.poses))


def chosen(
    graph: Graph,
    passes: Draft,
    finished: Finished,
    tracked: Standing,
    views: Views,
) -> Finished:
    """The finished layout, or one nearer to what was tracked that fewer walls contradict.

    That is the layout of nearby passes and of the closures that say what these say, or the path as
    it was tracked, whose standing is `tracked`.
    """
    links = (*finished.draft.loops, *finished.dropped)
    closures = tuple(link for link in links if link.kind == "closure")
    if closures:
        is_near = deviations(graph, passes, closures).away_m <= CLOSURE_SLACK_M
        near = tuple(compress(closures, is_near))
        alone, outliers = settle(graph, replace(passes, loops=(*passes.loops, *near)))
        dropped = (*compress(closures, ~is_near), *outliers)
        trial = Finished.of("passes", alone, dropped, views)
        if finished.standing.is_worse_than(trial.standing):
            finished = trial
    if finished.standing.is_worse_than(tracked):
        return Finished("tracked", replace(passes, poses=graph.poses, loops=()), links, tracked)
    return finished


def corrected(trajectory: Trajectory, store: KeyframeStore, layout: Layout) -> Trajectory:
    """The trajectory of every registered scan, moved with the keyframes of a layout."""
    anchors = keyframe_rows(trajectory, store)
    poses = carried(trajectory.poses, anchors, layout.poses)
    if trajectory.lost is not None:
        poses = bridged(poses, trajectory.poses, trajectory.lost)
    return replace(trajectory, poses=poses)


def layout_of(
    graph: Graph,
    finished: Finished,
    found: Closed,
) -> Layout:
    """The layout of all keyframes from the settled draft of the nodes.

    `found` says what was judged on the way.
    """
    draft, dropped = finished.draft, finished.dropped
    loose = loose_starts(graph, draft.loops)
    spent = [part for part, tries in draft.tries.items() if tries >= STRAY_TRIES]
    given_up = sum(part not in draft.tied for part in spent)
    evidence = LayoutEvidence(
        choice=finished.choice,
        closures=found.judged,
        parts=part_moves(graph, draft),
        standing=finished.standing,
        limits=draft.counting("stray_tries", given_up).limits,
    )
    return Layout(
        poses=carried(graph.tracked, graph.nodes, draft.poses),
        nodes=graph.nodes,
        odometry=graph.odometry,
        kept=draft.loops,
        dropped=dropped,
        loose=loose,
        evidence=evidence,
    )

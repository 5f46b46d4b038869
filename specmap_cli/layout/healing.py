"""Healing: what the audit finds drawn twice is matched, and the layout solved again with it.

A disagreement with an offset says where the later pass belongs. There the walls of both passes are
matched, as those of nearby passes are, and become links. The layout with them is taken only if the
audit finds less wall that is contradicted, and if no more contradicts all over the map.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import Pose2, compose, invert
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Audit, Disagreement, audit
from specmap_cli.layout.carrying import carried
from specmap_cli.layout.contradictions import Views
from specmap_cli.layout.evidence import Healing, part_moves
from specmap_cli.layout.judging import judge
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.nearby_passes import LOOP_SEARCH_M
from specmap_cli.layout.parts import loose_starts
from specmap_cli.layout.pass_matching import match_passes
from specmap_cli.layout.path_graph import Draft, Graph, joined
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import Layout
from specmap_cli.layout.solving import settle, tighten
from specmap_cli.layout.wall_matching import nearby_link
from specmap_cli.layout.walls import PLACE_NODES, Walls

_HEAL_ROUNDS = 3  # walls drawn twice are matched and solved again this often at the most


@dataclass(frozen=True, slots=True)
class Audited:
    """A layout and what the audit says of it."""

    layout: Layout
    audit: Audit


def healed(
    store: KeyframeStore,
    layout: Layout,
    breaks: Collection[int],
) -> Audited:
    """The layout with its audit, mended where passes disagree and it shows how far they are apart.

    Tried `_HEAL_ROUNDS` times at the most; a trial that is no better ends it. Where the layout has
    no graph nothing is mended. Deterministic.
    """
    first = best = Audited(layout, audit(store, layout.poses, breaks))
    for _ in range(_HEAL_ROUNDS if len(layout.nodes) else 0):
        trial = _mended(store, best)
        if trial is None:
            break
        again = Audited(trial, audit(store, trial.poses, breaks))
        if not _is_better(again, best):
            break
        best = again
    return best if best is first else _told(first, best)


def _told(first: Audited, best: Audited) -> Audited:
    """A layout that was mended, which says so."""
    before = {id(link) for link in first.layout.kept}
    away = best.layout.poses[:, :2] - first.layout.poses[:, :2]
    healing = Healing(
        links=tuple(link for link in best.layout.kept if id(link) not in before),
        walls_m=first.audit.walls_m,
        moved_m=float(np.hypot(away[:, 0], away[:, 1]).max()),
    )
    return replace(best, layout=replace(best.layout, healing=healing))


def _is_better(trial: Audited, before: Audited) -> bool:
    """Whether less wall is contradicted, and not more all over the map."""
    now, was = trial.layout.evidence.standing, before.layout.evidence.standing
    less = trial.audit.walls_m < before.audit.walls_m and trial.audit.share <= before.audit.share
    return less and not now.is_worse_than(was)


def _mended(store: KeyframeStore, found: Audited) -> Layout | None:
    """The layout solved with the claims of the audit that are believed, if there are any.

    One claim alone may mend little, as a pass found far away: others must agree with it.
    """
    layout, disagreements = found.layout, found.audit.disagreements
    if all(one.offset is None for one in disagreements):
        return None
    graph = joined(store.poses, layout.nodes, layout.odometry)
    draft = _draft_of(graph, layout)
    claims = _claims(graph, draft, disagreements, Walls(store, graph, MATCH_RANGE_M))
    believed = judge(graph, draft, claims).links(believed=True)
    if not believed:
        return None
    trial = tighten(graph, replace(draft, loops=(*draft.loops, *believed)))
    trial, dropped = settle(graph, trial)
    evidence = replace(
        layout.evidence,
        choice="passes" if layout.evidence.choice == "tracked" else layout.evidence.choice,
        parts=part_moves(graph, trial),
        standing=Views.of(store, graph).standing(trial.poses),
        limits=trial.limits,
    )
    return replace(
        layout,
        poses=carried(graph.tracked, graph.nodes, trial.poses),
        kept=trial.loops,
        dropped=(*layout.dropped, *dropped),
        loose=loose_starts(graph, trial.loops),
        evidence=evidence,
    )


def _draft_of(graph: Graph, layout: Layout) -> Draft:
    """A settled layout as a draft again."""
    loose = {int(graph.parts[graph.row[start]]) for start in layout.loose}
    return Draft(
        poses=layout.poses[graph.nodes],
        loops=layout.kept,
        tied=frozenset(graph.part_numbers) - loose,
        limits=layout.limits,
    )


def _claims(
    graph: Graph,
    draft: Draft,
    disagreements: Sequence[Disagreement],
    walls: Walls,
) -> list[Link]:
    """Links between passes that disagree, where their walls fit when moved by the offset."""
    claims = []
    for one in disagreements:
        if one.offset is None:
            continue
        old, new = (_row_at(graph, number) for number in (one.earlier, one.later))
        moved = compose(np.array(one.offset), draft.poses[new])
        guess = Pose2(*compose(invert(draft.poses[old]), moved).tolist())
        newer, older = ((row, PLACE_NODES) for row in (new, old))
        drift_m = LOOP_SEARCH_M
        fit = match_passes(walls, draft.poses, newer, older, guess, drift_m)
        if fit is not None:
            claims.append(nearby_link(graph, old, new, fit))
    return claims


def _row_at(graph: Graph, keyframe: int) -> int:
    """The row of the last node up to a keyframe."""
    return int(np.searchsorted(graph.nodes, keyframe, side="right")) - 1

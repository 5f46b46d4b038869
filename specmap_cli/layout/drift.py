"""Closures against the drift of the path: what it explains, and what nothing explains.

Drift grows along the shortest chain of links between the two keyframes of a closure. In look-alike
rooms off one corridor that chain is short, and a closure between them impossible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.layout.motion_edges import GUESS_M
from specmap_cli.layout.path_graph import Draft, Graph, lengths_matrix
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.uncertainty import DRIFT_SHARE

_CLOSURE_DRIFT_SHARE = 0.15  # metres per metre driven between its ends that a closure may mend
CLOSURE_SLACK_M = 0.5  # what any closure may mend
_LEAST_M = 1e-3  # length of a link between two nodes at one place: csgraph takes 0 for no edge
_BRIDGE_SIGMAS = 3.0  # of a bridge that are still no surprise
_CUT_SHORT = 0.9  # a chain below this share of the path goes over a nearby pass


@dataclass(frozen=True, slots=True)
class Deviations:
    """How far a layout is from what closures say, `away_m` (c,), and what drift allows (c,)."""

    away_m: FloatArray
    allowed_m: FloatArray


def deviations(graph: Graph, draft: Draft, closures: Sequence[Link]) -> Deviations:
    """How far the layout in the making is from what each closure says, and may be by drift alone.

    Any of them may mend `CLOSURE_SLACK_M`. Along a chain that passes cut short drift is
    `DRIFT_SHARE` of its length, along another one `_CLOSURE_DRIFT_SHARE`. Over a break of which
    nothing is known it is the guess that may be off, by three times `GUESS_M`: parts are moved
    farther as a whole only, when several links agree where to.
    """
    chains = chain_lengths(graph, draft.loops, closures)
    away, allowed = [], []
    for closure, chain_m in zip(closures, chains.tolist(), strict=True):
        share = _CLOSURE_DRIFT_SHARE
        if chain_m < _CUT_SHORT * _path_between(graph, closure):
            share = DRIFT_SHARE
        drift_m = share * chain_m if np.isfinite(chain_m) else _BRIDGE_SIGMAS * GUESS_M
        away.append(_away_m(graph, draft.poses, closure))
        allowed.append(CLOSURE_SLACK_M + drift_m)
    return Deviations(np.array(away), np.array(allowed))


def chain_lengths(graph: Graph, loops: Sequence[Link], closures: Sequence[Link]) -> FloatArray:
    """(c,) metres along the shortest chain of links between the ends of each closure.

    The chain runs over motions that were tracked and over `loops`; inf where there is none. A break
    that odometry bridged counts as the way along which tracking drifts as far, another one ends it.
    By Dijkstra's algorithm, once for each keyframe from which a closure starts.
    """
    if not closures:
        return np.zeros(0)
    links = [link for link in (*graph.odometry, *loops) if link.kind != "loose"]
    lengths = [max(_length(link), _LEAST_M) for link in links]
    matrix = lengths_matrix(len(graph.nodes), [_rows(graph, link) for link in links], lengths)
    starts, ends = zip(*(_rows(graph, closure) for closure in closures), strict=True)
    unique, which = np.unique(starts, return_inverse=True)
    return np.asarray(dijkstra(matrix, directed=False, indices=unique)[which, list(ends)])


def _length(link: Link) -> float:
    """Metres of a link, with what a bridge adds: three sigmas of its place."""
    if link.kind != "bridge":
        return link.source_from_target.distance
    reach_m = _BRIDGE_SIGMAS / float(np.sqrt(link.information[:2, :2].trace() / 2))
    return link.source_from_target.distance + reach_m / _CLOSURE_DRIFT_SHARE


def _rows(graph: Graph, link: Link) -> tuple[int, int]:
    return graph.row[link.source], graph.row[link.target]


def _path_between(graph: Graph, link: Link) -> float:
    """Metres driven between the two ends of a link."""
    source, target = _rows(graph, link)
    return abs(float(graph.path[target] - graph.path[source]))


def _away_m(graph: Graph, poses: FloatArray, link: Link) -> float:
    """Metres between where a link and the poses (M, 3) put its target."""
    source, target = (Pose2(*poses[row].tolist()) for row in _rows(graph, link))
    expected = source.inverse() @ target
    return (link.source_from_target.inverse() @ expected).distance

"""Drafts of the layout solved: as they are, over any drift, and without what does not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.layout.condensing import Condensed
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import (
    SETTLED,
    Link,
    LinkArrays,
    Solution,
    errors,
    solve,
    squared,
)

_KERNEL_SIGMAS = 2.0  # closures and passes farther off than this pull less and less
_OUTLIER_CHI2 = 25.0  # closures and passes above it, five sigmas off, are dropped in the end
_SOLVE_ITERATIONS = 20  # steps of the solver at the most
_HASTY = 5  # steps at a width that the next one replaces
_ROUGHLY = 1e-3  # share of the cost below which a step moves nodes by a millimetre or two
_EXACT = 1e-8  # metres and radians: what rounding makes of a motion that fits
_DECIMALS = 9  # of poses solved: a nanometre; libraries differ from the fourteenth on
_NARROWER = 3.0  # from one width of the kernel to the next: outvoted closures let go one by one


def solved(graph: Graph, draft: Draft) -> Draft:
    """The draft with the poses that fit its links best."""
    return _with(draft, _solution(graph, draft, _KERNEL_SIGMAS))


def renewed(graph: Graph, draft: Draft) -> Draft:
    """The draft solved roughly, good enough to look for more from there."""
    return _with(draft, _solution(graph, draft, _KERNEL_SIGMAS, _ROUGHLY))


def tighten(graph: Graph, draft: Draft) -> Draft:
    """Loops pull over any drift at first; those outvoted are let go step by step.

    Graduated non-convexity (Yang et al., RA-L 2020): Cauchy's kernel starts wider than the largest
    error and narrows to its usual width. Solved roughly: others follow, `settle` the last of them.
    """
    solution = _solution(graph, draft, np.inf, _ROUGHLY)
    width = float(np.sqrt(solution.chi2[len(graph.odometry) :].max(initial=0.0)))
    while width > _KERNEL_SIGMAS:
        rounded = replace(draft, poses=np.round(solution.poses, _DECIMALS))
        solution = _solution(graph, rounded, width, _ROUGHLY, hasty=True)
        width /= _NARROWER
    return renewed(graph, replace(draft, poses=solution.poses))


def settle(graph: Graph, draft: Draft) -> tuple[Draft, tuple[Link, ...]]:
    """The draft solved without the loops that do not fit, and these loops.

    What does not fit is dropped and the rest solved anew until all that is left fits.
    """
    dropped: list[Link] = []
    while True:
        solution = _solution(graph, draft, _KERNEL_SIGMAS)
        fits = solution.chi2[len(graph.odometry) :] <= _OUTLIER_CHI2
        dropped += [link for link, fit in zip(draft.loops, fits, strict=True) if not fit]
        loops = tuple(link for link, fit in zip(draft.loops, fits, strict=True) if fit)
        draft = replace(_with(draft, solution), loops=loops)
        if fits.all():
            return draft, tuple(dropped)


def _solution(
    graph: Graph,
    draft: Draft,
    width: float,
    settled: float = SETTLED,
    *,
    hasty: bool = False,
) -> Solution:
    """The solution with Cauchy's kernel of `width` sigmas on the loops."""
    widths = {"closure": width, "nearby": width, "loose": _KERNEL_SIGMAS, "bridge": _KERNEL_SIGMAS}
    links = LinkArrays.of((*_motions(graph, draft), *draft.loops), graph.row, widths)
    steps = _HASTY if hasty else _SOLVE_ITERATIONS
    count = _first_rows(draft.poses, links, len(graph.odometry))
    among = (links.i < count) & (links.j < count)
    found = _solved(draft.poses[:count], links.some(among), steps, settled)
    tail = compose(invert(draft.poses[count - 1]), draft.poses[count:])
    poses = np.concatenate([found.poses, compose(found.poses[-1], tail)])
    return replace(found, poses=poses, chi2=squared(poses, links))


def _solved(poses: FloatArray, links: LinkArrays, iterations: int, settled: float) -> Solution:
    """The solution of a path (M, 3), of which the first M - 1 links are the motions.

    Where a rough one will do its chains are solved as one motion each.
    """
    if settled <= SETTLED:
        return solve(poses, links, iterations, settled)
    condensed = Condensed.of(links, len(poses) - 1)
    found = solve(poses[condensed.kept], condensed.links, iterations, settled)
    return replace(found, poses=condensed.expanded(found.poses))


def _first_rows(poses: FloatArray, links: LinkArrays, motions: int) -> int:
    """How many rows there are up to the last one that a link may move.

    What follows hangs on it by motions alone, the first of the links, and lies where they say: it
    goes with it as it is.
    """
    pulls = np.abs(errors(poses, links)).max(axis=1, initial=0.0) > _EXACT
    pulls[motions:] = True
    return 1 + int(np.maximum(links.i, links.j)[pulls].max(initial=0))


def _motions(graph: Graph, draft: Draft) -> tuple[Link, ...]:
    """The motions; where a part was placed the guess that led to it says nothing any more.

    It holds the part where it is, so that it does not bend the path that closures tie.
    """
    return tuple(
        _as_placed(graph, draft, motion)
        if motion.kind == "loose" and int(graph.parts[graph.row[motion.target]]) in draft.tied
        else motion
        for motion in graph.odometry
    )


def _as_placed(graph: Graph, draft: Draft, motion: Link) -> Link:
    source, target = draft.poses[[graph.row[motion.source], graph.row[motion.target]]]
    placed = compose(invert(source), target)
    return replace(motion, source_from_target=Pose2(*placed.tolist()))


def _with(draft: Draft, solution: Solution) -> Draft:
    """The draft at the poses of a solution; one that was cut short is counted."""
    moved = replace(draft, poses=solution.poses)
    return moved.counting("solve_iterations", 0 if solution.converged else 1)

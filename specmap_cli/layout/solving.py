"""Drafts of the layout solved: as they are, over any drift, and without what does not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import Pose2, compose, invert
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


def solved(graph: Graph, draft: Draft, *, roughly: bool = False) -> Draft:
    """The draft with the poses that fit its links best; roughly to look for more from there."""
    solution = _solution(graph, draft, _KERNEL_SIGMAS, _ROUGHLY if roughly else SETTLED)
    return replace(draft, poses=solution.poses)


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
    return solved(graph, replace(draft, poses=solution.poses), roughly=True)


def settle(graph: Graph, draft: Draft) -> tuple[Draft, tuple[Link, ...]]:
    """The draft solved anew until all its loops fit, and the loops dropped on the way."""
    dropped: list[Link] = []
    while True:
        solution = _solution(graph, draft, _KERNEL_SIGMAS)
        fits = solution.chi2[len(graph.odometry) :] <= _OUTLIER_CHI2
        dropped += [link for link, fit in zip(draft.loops, fits, strict=True) if not fit]
        loops = tuple(link for link, fit in zip(draft.loops, fits, strict=True) if fit)
        draft = replace(draft, poses=solution.poses, loops=loops)
        if fits.all():
            return draft, tuple(dropped)


def _solution(
    graph: Graph, draft: Draft, width: float, settled: float = SETTLED, *, hasty: bool = False
) -> Solution:
    """The solution with Cauchy's kernel of `width` sigmas on the loops."""
    widths = {"closure": width, "nearby": width, "loose": _KERNEL_SIGMAS, "bridge": _KERNEL_SIGMAS}
    motions = list(graph.odometry)
    for row, motion in enumerate(motions):
        # where a part was placed, the guess that led to it says nothing any more: it holds the part
        # where it is, so that it does not bend the path that closures tie
        if motion.kind == "loose" and int(graph.parts[row + 1]) in draft.tied:
            placed = compose(invert(draft.poses[row]), draft.poses[row + 1])
            motions[row] = replace(motion, source_from_target=Pose2(*placed.tolist()))
    links = LinkArrays.of((*motions, *draft.loops), graph.row, widths)
    steps = _HASTY if hasty else _SOLVE_ITERATIONS
    # what follows the last row that a link may move hangs on it by motions and goes with it
    missed = errors(draft.poses, links.i, links.j, links.z)
    pulls = np.abs(missed).max(axis=1, initial=0.0) > _EXACT
    pulls[len(motions) :] = True
    count = 1 + int(np.maximum(links.i, links.j)[pulls].max(initial=0))
    path, inner = draft.poses[:count], (links.i < count) & (links.j < count)
    some = LinkArrays._make(each[inner] for each in links)
    found = solve(path, some, steps, settled)
    tail = compose(invert(draft.poses[count - 1]), draft.poses[count:])
    poses = np.concatenate([found.poses, compose(found.poses[-1], tail)])
    return replace(found, poses=poses, chi2=squared(poses, links))

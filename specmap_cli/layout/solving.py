"""Drafts of the layout solved: as they are, over any drift, and without what does not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import Link, LinkArrays, Solution, solve

_NARROWER = 3.0  # from one width of the kernel to the next: outvoted closures let go one by one


def solved(graph: Graph, draft: Draft, config: RelaxationConfig) -> Draft:
    """The draft with the poses that fit its links best."""
    return _with(draft, _solution(graph, draft, config.kernel_sigmas, config))


def tighten(graph: Graph, draft: Draft, config: RelaxationConfig) -> Draft:
    """Loops pull over any drift at first; those outvoted are let go step by step.

    Graduated non-convexity (Yang et al., RA-L 2020): Cauchy's kernel starts wider than the largest
    error and narrows to its usual width.
    """
    solution = _solution(graph, draft, np.inf, config)
    width = float(np.sqrt(solution.chi2[len(graph.odometry) :].max(initial=0.0)))
    while width > config.kernel_sigmas:
        solution = _solution(graph, _with(draft, solution), width, config)
        width /= _NARROWER
    return solved(graph, _with(draft, solution), config)


def settle(graph: Graph, draft: Draft, config: RelaxationConfig) -> tuple[Draft, tuple[Link, ...]]:
    """The draft solved without the loops that do not fit, and these loops.

    What does not fit is dropped and the rest solved anew until all that is left fits.
    """
    dropped: list[Link] = []
    while True:
        solution = _solution(graph, draft, config.kernel_sigmas, config)
        fits = solution.chi2[len(graph.odometry) :] <= config.outlier_chi2
        dropped += [link for link, fit in zip(draft.loops, fits, strict=True) if not fit]
        loops = tuple(link for link, fit in zip(draft.loops, fits, strict=True) if fit)
        draft = replace(_with(draft, solution), loops=loops)
        if fits.all():
            return draft, tuple(dropped)


def _solution(graph: Graph, draft: Draft, width: float, config: RelaxationConfig) -> Solution:
    """The solution with Cauchy's kernel of `width` sigmas on the loops."""
    widths = {"closure": width, "nearby": width, "loose": config.kernel_sigmas}
    links = LinkArrays.of((*graph.odometry, *draft.loops), graph.row, widths)
    return solve(draft.poses, links, config.solve_iterations)


def _with(draft: Draft, solution: Solution) -> Draft:
    """The draft at the poses of a solution; one that was cut short is counted."""
    moved = replace(draft, poses=solution.poses)
    return moved.counting("solve_iterations", 0 if solution.converged else 1)

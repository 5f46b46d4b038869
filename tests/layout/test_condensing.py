"""A smaller graph that says the same: chains of motions taken for one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose
from specmap_cli.layout.condensing import Condensed
from specmap_cli.layout.pose_graph import Link, LinkArrays, solve
from tests.layout.driving import (
    as_tracked,
    drifted,
    graph_by_hand,
    link,
    round_trip,
    true_link,
)
from tests.strategies import seeds

WIDTHS = {"closure": 2.0, "nearby": 2.0, "loose": 2.0, "bridge": 2.0}


def problem(loops: int, breaks: tuple[int, ...] = ()) -> tuple[FloatArray, LinkArrays]:
    """A drive of two laps that drifted, and true links from the second lap to the first."""
    truth = round_trip(2.0)
    half = len(truth) // 2
    graph = graph_by_hand(drifted(truth), breaks, every=3)
    rows = np.linspace(30, len(graph.nodes) // 2 - 30, loops).astype(int)
    known: list[Link] = []
    for row in rows.tolist():
        older = int(graph.nodes[row])
        newer = int(graph.nodes[np.searchsorted(graph.nodes, older + half)])
        known.append(true_link(truth, older, newer))
    links = LinkArrays.of((*graph.odometry, *known), graph.row, WIDTHS)
    return as_tracked(graph).poses, links


@pytest.mark.parametrize("loops", [1, 4, 12])
@pytest.mark.parametrize("breaks", [(), (300,)])
def test_the_solution_is_that_of_the_whole_graph(loops: int, breaks: tuple[int, ...]) -> None:
    poses, links = problem(loops, breaks)
    whole = solve(poses, links, 50)
    small = Condensed.of(links, len(poses) - 1)
    assert len(small.kept) < 0.25 * len(poses)
    found = small.expanded(solve(poses[small.kept], small.links, 50).poses)
    assert np.abs(whole.poses - poses)[:, :2].max() > 0.3, "there was something to mend"
    assert np.hypot(*(found - whole.poses)[:, :2].T).max() < 0.005
    assert np.abs(found - whole.poses)[:, 2].max() < 0.002


@given(seeds)
def test_what_fits_stays_where_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = [np.zeros(3)]
    for step in rng.normal(0.0, 0.3, (60, 3)):
        poses.append(compose(poses[-1], step))
    path = np.array(poses)
    graph = graph_by_hand(path)
    links = LinkArrays.of((*graph.odometry, true_link(path, 7, 33)), graph.row, WIDTHS)
    small = Condensed.of(links, len(path) - 1)
    assert {0, 7, 33, 60} <= set(small.kept.tolist())
    assert np.allclose(small.expanded(path[small.kept]), path, atol=1e-9)


@given(st.integers(1, 40), st.floats(0.01, 0.3))
def test_a_chain_is_as_stiff_as_its_motions(motions: int, sigma_m: float) -> None:
    """Straight on, without turns: variances add up, and what is missing is shared out evenly."""
    information = np.diag([sigma_m**-2, sigma_m**-2, 1e12])
    path = np.column_stack([0.3 * np.arange(motions + 1), np.zeros((motions + 1, 2))])
    chain = [link(k, k + 1, (0.3, 0.0, 0.0), "odometry", information) for k in range(motions)]
    links = LinkArrays.of(chain, {k: k for k in range(motions + 1)}, WIDTHS)
    small = Condensed.of(links, motions)
    lengths = np.diff(small.kept)
    assert lengths.sum() == motions
    assert lengths.max() <= 16
    assert np.allclose(1.0 / small.links.w[:, 0, 0], lengths * sigma_m**2, rtol=1e-6)
    stretched = path[small.kept] * (1.1, 1.0, 1.0)
    assert np.allclose(small.expanded(stretched), path * (1.1, 1.0, 1.0), atol=1e-6)


def test_motions_over_a_break_are_kept_as_they_are() -> None:
    poses, links = problem(3, (300,))
    small = Condensed.of(links, len(poses) - 1)
    over = int(np.flatnonzero(np.isfinite(links.width[: len(poses) - 1]))[0])
    number = int(np.searchsorted(small.kept, over))
    assert small.kept[number] == over
    assert small.kept[number + 1] == over + 1
    assert small.links.width[number] == 2.0
    assert np.allclose(small.links.w[number], links.w[over])
    assert np.allclose(small.links.z[number], links.z[over])


def test_a_path_of_one_row_is_itself() -> None:
    links = LinkArrays.of((), {}, WIDTHS)
    small = Condensed.of(links, 0)
    assert small.kept.tolist() == [0]
    assert np.array_equal(small.expanded(np.zeros((1, 3))), np.zeros((1, 3)))

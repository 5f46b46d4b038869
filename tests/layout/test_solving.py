"""The solver against scipy's least squares and by hand; the graph as text; drafts solved."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares, minimize

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.layout.path_graph import _KERNEL_SIGMAS, Graph, settle, solved, tighten
from specmap_cli.layout.pose_graph import (
    Link,
    LinkArrays,
    errors,
    read_g2o,
    solve,
    spread_between,
    squared,
)
from specmap_cli.layout.result import Layout
from tests.layout.driving import arc, as_tracked, chained, drifted, graph_by_hand, link, true_link
from tests.strategies import few, pose_arrays, seeds
from tests.turning import turned


def random_graph(
    seed: int, nodes: int, loops: int, noise: float = 0.05
) -> tuple[FloatArray, FloatArray, list[Link]]:
    """True poses, drifted poses, and noisy edges: a chain and some loops."""
    rng = np.random.default_rng(seed)
    turns = [(1.0, 0.0, rng.normal(0, 0.5)) for _ in range(nodes - 1)]
    truth = chained(np.zeros(3), np.array(turns))
    pairs = [(k, k + 1) for k in range(nodes - 1)]
    pairs += [tuple(sorted(rng.choice(nodes, 2, replace=False).tolist())) for _ in range(loops)]
    links = []
    for i, j in pairs:
        z = compose(compose(invert(truth[i]), truth[j]), rng.normal(0, noise, 3) * (1, 1, 0.3))
        root = rng.normal(size=(3, 3))
        information = root @ root.T + np.diag([50.0, 50.0, 200.0])
        kind = "odometry" if j == i + 1 else "nearby"
        links.append(link(i, j, z.tolist(), kind, information))  # type: ignore[arg-type]
    steps = np.array([edge.source_from_target for edge in links[: nodes - 1]])
    return truth, chained(truth[0], steps), links


def arrays(links: list[Link], nodes: int, width: float = np.inf) -> LinkArrays:
    return LinkArrays.of(links, {k: k for k in range(nodes)}, {"nearby": width})


def oracle(start: FloatArray, edges: LinkArrays) -> FloatArray:
    """scipy's answer to the same squares."""
    roots = np.linalg.cholesky(edges.w).transpose(0, 2, 1)

    def residuals(x: FloatArray) -> FloatArray:
        missed = errors(np.vstack([start[:1], x.reshape(-1, 3)]), edges.i, edges.j, edges.z)
        return np.asarray(np.einsum("eab,eb->ea", roots, missed).ravel())

    found = least_squares(residuals, start[1:].ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-12)
    return np.vstack([start[:1], found.x.reshape(-1, 3)])


def robust_cost(poses: FloatArray, edges: LinkArrays) -> float:
    """Cauchy's kernel over the edges, as its textbook formula."""
    c = np.where(np.isinf(edges.width), 1e6, edges.width)
    return float((c**2 * np.log1p(squared(poses, edges) / c**2)).sum())


@pytest.mark.parametrize(("a", "b"), [(0, 4), (2, 7), (7, 2)])
def test_the_spread_between_poses_is_that_of_their_motion_under_noise(a: int, b: int) -> None:
    """Against the derivatives of the motion and of all errors by differences."""
    _, poses, links = random_graph(3, 8, 3, noise=0.01)
    edges = arrays(links, 8)
    poses = solve(poses, edges).poses
    roots = np.linalg.cholesky(edges.w).transpose(0, 2, 1)
    between = compose(invert(poses[[a]]), poses[[b]])

    def missed(x: FloatArray) -> FloatArray:
        moved = np.vstack([poses[:1], x.reshape(-1, 3)])
        pair = errors(moved, np.array([a]), np.array([b]), between)[0]
        all_of = errors(moved, edges.i, edges.j, edges.z)
        return np.concatenate([pair, np.einsum("eab,eb->ea", roots, all_of).ravel()])

    x = poses[1:].ravel()
    steps = 1e-6 * np.eye(len(x))
    by_x = np.array([(missed(x + step) - missed(x - step)) / 2e-6 for step in steps]).T
    expected = by_x[:3] @ np.linalg.inv(by_x[3:].T @ by_x[3:]) @ by_x[:3].T
    found = spread_between(poses, edges, np.array([0, a]), np.array([1, b]))
    assert np.allclose(found[1], expected, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_scipy_least_squares(seed: int) -> None:
    """Also where two edges are equal."""
    _, start, links = random_graph(seed, nodes=12, loops=6)
    edges = arrays([*links, links[-1]], 12)
    ours, theirs = solve(start, edges, 50), oracle(start, edges)
    assert ours.cost == pytest.approx(float(squared(theirs, edges).sum()), rel=1e-5)
    assert np.abs(ours.poses[:, :2] - theirs[:, :2]).max() < 1e-3
    assert np.abs(wrap_angles(ours.poses[:, 2] - theirs[:, 2])).max() < 1e-3
    assert np.allclose(ours.chi2, squared(ours.poses, edges))


@pytest.mark.parametrize("seed", range(3))
def test_a_robust_solution_is_where_scipy_finds_nothing_lower(seed: int) -> None:
    _, start, links = random_graph(seed, nodes=7, loops=4, noise=0.2)
    edges = arrays(links, 7, width=2.0)
    ours = solve(start, edges, 100)

    def cost(x: FloatArray) -> float:
        return robust_cost(np.vstack([start[:1], x.reshape(-1, 3)]), edges)

    theirs = minimize(cost, ours.poses[1:].ravel(), method="BFGS")
    assert ours.cost == pytest.approx(cost(ours.poses[1:].ravel()), rel=1e-5)
    assert ours.cost == pytest.approx(float(theirs.fun), rel=1e-4)


def test_a_wrong_loop_is_outvoted() -> None:
    truth, start, links = random_graph(5, nodes=30, loops=15, noise=0.01)
    wrong = link(2, 25, (40.0, -30.0, 2.0), "nearby", np.diag([1e3, 1e3, 1e3]))
    robust = solve(start, arrays([*links, wrong], 30, width=2.0), 50)
    assert np.hypot(*(robust.poses - truth)[:, :2].T).max() < 0.2
    assert robust.chi2[-1] > 1e4


@given(st.integers(0, 1000), st.integers(2, 10))
def test_a_perfect_graph_stays_as_it_is(seed: int, nodes: int) -> None:
    truth, _, links = random_graph(seed, nodes, loops=3, noise=0.0)
    solution = solve(truth, arrays(links, nodes, width=2.0))
    assert solution.cost < 1e-12
    assert np.allclose(solution.poses[:, :2], truth[:, :2], atol=1e-6)


@given(st.integers(0, 1000), st.integers(0, 6), st.sampled_from([np.inf, 2.0]))
def test_a_solution_costs_no_more_than_its_start(seed: int, loops: int, width: float) -> None:
    _, start, links = random_graph(seed, nodes=8, loops=loops, noise=0.3)
    edges, before = arrays(links, 8, width), np.array(start)
    one, many = solve(start, edges, 1), solve(start, edges, 30)
    assert many.cost <= one.cost <= robust_cost(start, edges) * (1 + 1e-6)
    assert np.array_equal(start, before), "the argument is left alone"
    assert (many.poses[:, 2] >= -np.pi).all()
    assert (many.poses[:, 2] < np.pi).all()


def test_the_number_of_steps_is_a_limit_and_what_has_settled_stays() -> None:
    _, start, links = random_graph(3, nodes=12, loops=6)
    edges = arrays(links, 12)
    stopped, settled = solve(start, edges, 1), solve(start, edges, 50)
    assert stopped.cost > settled.cost
    assert solve(settled.poses, edges, 2).cost == pytest.approx(settled.cost, rel=1e-6)


def test_what_no_edge_holds_and_the_first_pose_stay_where_they_are() -> None:
    _, start, links = random_graph(7, nodes=9, loops=3)
    assert np.array_equal(solve(start, arrays(links, 9)).poses[0], start[0])
    more = np.vstack([start, [7.0, 8.0, 0.5]])
    assert np.allclose(solve(more, arrays(links, 10)).poses[9], more[9])
    alone = solve(start[:1], arrays([], 1))
    assert np.array_equal(alone.poses, start[:1])
    assert alone.cost == 0.0
    assert np.array_equal(solve(start, arrays([], 9)).poses, start)


# three poses on a line, 1 m apart by odometry, and an edge that says 2.3 m from end to end
BY_HAND = """
# a remark
VERTEX_SE3:QUAT 1 2 3
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2 0 0
FIX 0
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 1000
EDGE_SE2 1 2 1 0 0 100 0 0 100 0 1000
EDGE_SE2 0 2 2.3 0 0 100 0 0 100 0 1000
EDGE_SE2_XY 0 1 2 3
"""


def test_a_graph_by_hand_relaxes_to_what_the_hand_finds() -> None:
    """Springs of one stiffness: each takes a third of the 0.3 m. Other tags are passed over."""
    vertices, links = read_g2o(BY_HAND)
    assert list(vertices) == [0, 1, 2]
    assert [edge.kind for edge in links] == ["odometry", "odometry", "closure"]
    rows = {number: row for row, number in enumerate(vertices)}
    poses = solve(np.array(list(vertices.values())), LinkArrays.of(links, rows, {})).poses
    assert np.allclose(poses, [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [2.2, 0.0, 0.0]], atol=1e-6)


@given(pose_arrays(6), pose_arrays(2), seeds)
def test_there_and_back_as_text(poses: FloatArray, motions: FloatArray, seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(3, 3))
    information = root @ root.T
    layout = Layout(
        poses=poses,
        nodes=np.array([0, 3, 5]),
        odometry=(link(0, 3, motions[0].tolist(), "odometry", information),),
        kept=(link(3, 5, motions[1].tolist(), "closure", np.eye(3)),),
        dropped=(link(0, 5, (9.0, 9.0, 0.0), "closure"),),
    )
    vertices, links = read_g2o(layout.g2o())
    assert list(vertices) == [0, 3, 5]
    assert np.allclose(list(vertices.values()), poses[[0, 3, 5]])
    assert [(edge.source, edge.target) for edge in links] == [(0, 3), (3, 5)], "what was dropped"
    assert np.allclose(links[0].information, information, rtol=1e-8, atol=1e-9)
    assert np.array_equal(links[0].information, links[0].information.T)
    assert np.allclose([edge.source_from_target for edge in links], motions, rtol=1e-8)


def test_the_text_is_what_g2o_reads() -> None:
    """The first vertex is fixed, last; of the information the upper triangle goes row by row."""
    information = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])
    assert Layout(
        poses=np.array([[0.0, 0.0, 0.0], [1.0, -0.25, 0.5]]),
        nodes=np.array([0, 1]),
        odometry=(link(0, 1, (1.0, -0.25, 0.5), "odometry", information),),
    ).g2o().splitlines() == [
        "VERTEX_SE2 0 0 0 0",
        "VERTEX_SE2 1 1 -0.25 0.5",
        "EDGE_SE2 0 1 1 -0.25 0.5 1 2 3 4 5 6",
        "FIX 0",
    ]
    assert Layout(poses=np.zeros((0, 3))).g2o() == ""
    assert read_g2o("") == ({}, [])


@pytest.mark.parametrize(
    "line",
    [
        "VERTEX_SE2 0 1 2",
        "VERTEX_SE2 0 1 2 3 4",
        "VERTEX_SE2 zero 1 2 3",
        "EDGE_SE2 0 1 x 0 0 1 0 0 1 0 1",
        "EDGE_SE2 0 1 0 0 0 1 0 0 1 0",
        "EDGE_SE2",
    ],
)
def test_a_bad_line_is_named(line: str) -> None:
    tag = line.split()[0]
    with pytest.raises(InputError) as caught:
        read_g2o("VERTEX_SE2 0 0 0 0\n" + line)
    assert str(caught.value) == f"g2o, line 2: {line!r} is no {tag}; mend the line"


LAP = 60


def driven(bias: float = 0.002) -> tuple[FloatArray, Graph]:
    """True poses around a circle, two laps, and the graph of a robot that turned too far."""
    truth = arc(2 * LAP, 2 * np.pi / LAP)
    return truth, graph_by_hand(drifted(truth, bias))


def rightly(truth: FloatArray, *starts: int) -> tuple[Link, ...]:
    """Passes from the first lap to the second, as they are."""
    return tuple(true_link(truth, k, k + LAP) for k in starts)


def off(poses: FloatArray, truth: FloatArray, every: int) -> float:
    """Largest error of where the second lap lies, seen from every so many places of the first."""
    gaps = compose(invert(poses[:LAP:every]), poses[LAP::every])
    true = compose(invert(truth[:LAP:every]), truth[LAP::every])
    return float(np.hypot(*(gaps - true)[:, :2].T).max())


def test_loops_pull_the_laps_together_also_roughly() -> None:
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, 0, 15, 30, 45))
    assert off(draft.poses, truth, 15) > 0.4
    after, rough = solved(graph, draft), solved(graph, draft, roughly=True)
    assert off(after.poses, truth, 15) < 0.04
    assert np.array_equal(draft.poses, graph.poses), "the draft before is as it was"
    assert after.loops == draft.loops
    assert np.allclose(rough.poses, after.poses, atol=0.01)


@few(10)
@given(st.integers(0, LAP - 1), st.floats(1.5, 20), st.floats(-3, 3))
def test_a_dropped_outlier_leaves_the_others_alone(at: int, away: float, turn: float) -> None:
    truth, graph = driven()
    right, wrong = rightly(truth, 0, 15, 30, 45), link(at, at + 50, (away, away, turn))
    with_wrong, dropped = settle(graph, as_tracked(graph, *right, wrong))
    without, none = settle(graph, as_tracked(graph, *right))
    assert (dropped, none) == ((wrong,), ())
    assert with_wrong.loops == without.loops == right
    assert np.allclose(with_wrong.poses[:, :2], without.poses[:, :2], atol=0.02)


def test_what_is_dropped_is_told_in_order_and_motions_stay() -> None:
    truth, graph = driven()
    right = rightly(truth, 0, 15, 30, 45)
    first, second = link(5, 70, (30.0, 0.0, 0.0)), link(9, 80, (0.0, -40.0, 0.0))
    draft, dropped = settle(graph, as_tracked(graph, first, *right, second))
    assert (dropped, draft.loops) == ((first, second), right)
    alone, nothing = settle(graph, as_tracked(graph))
    assert nothing == ()
    assert np.allclose(alone.poses, graph.poses)
    assert np.allclose(tighten(graph, as_tracked(graph)).poses, graph.poses)


def test_what_counts_as_an_outlier_is_set() -> None:
    truth, graph = driven(bias=0.0)
    x, y, theta = true_link(truth, 0, LAP).source_from_target
    unlikely = link(0, LAP, (x + 0.16, y, theta))  # four sigmas off
    loops = (*rightly(truth, *range(20)), unlikely)
    for limit, expected in ((25.0, ()), (4.0, (unlikely,))):
        with turned("layout.path_graph", _OUTLIER_CHI2=limit):
            assert settle(graph, as_tracked(graph, *loops))[1] == expected


def test_closures_that_agree_win_over_any_drift() -> None:
    """Metres off, each of them is an outlier to begin with; together they outvote the wrong one."""
    truth, graph = driven(0.02)
    wrong = link(3, 100, (6.0, 5.0, 1.0), "closure")
    start = as_tracked(graph, *rightly(truth, 0, 10, 20, 30, 40, 50), wrong)
    assert off(start.poses, truth, 10) > 2.0
    assert len(settle(graph, start)[1]) == 7, "none is believed as it is"
    draft, dropped = settle(graph, tighten(graph, start))
    assert dropped == (wrong,)
    assert off(draft.poses, truth, 10) < 0.1


@pytest.mark.parametrize("starts", [(0,), (0, 9), (5, 30, 55)])
def test_what_follows_the_last_loop_goes_with_it(starts: tuple[int, ...]) -> None:
    """Only the rows before are solved; all rows solved at once lie the same."""
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, *starts))
    links = LinkArrays.of((*graph.odometry, *draft.loops), graph.row, {"nearby": _KERNEL_SIGMAS})
    whole = solve(draft.poses, links, 100)
    assert np.abs(whole.poses - draft.poses).max() > 0.05
    assert np.allclose(solved(graph, draft).poses, whole.poses, atol=1e-4)


def test_a_bent_end_is_straightened_again() -> None:
    """Its loop was dropped: nothing but the motions holds it."""
    truth, graph = driven()
    straight = as_tracked(graph, *rightly(truth, 0))
    bent = graph.poses
    bent[100:] = compose(np.array([0.5, 0.2, 0.05]), bent[100:])
    after = solved(graph, replace(straight, poses=bent))
    assert np.allclose(after.poses, solved(graph, straight).poses, atol=1e-4)

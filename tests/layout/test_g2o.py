"""The pose graph as g2o text: there and back, and a file written by hand."""

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.layout.g2o import read_g2o, write_g2o
from specmap_cli.layout.pose_graph import LinkArrays, solve
from specmap_cli.layout.relaxation import Layout
from tests.layout.driving import link
from tests.strategies import pose_arrays, seeds

# three poses on a line, 1 m apart by odometry, and an edge that says 2.3 m from end to end
BY_HAND = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2 0 0
FIX 0
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 1000
EDGE_SE2 1 2 1 0 0 100 0 0 100 0 1000
EDGE_SE2 0 2 2.3 0 0 100 0 0 100 0 1000
"""


def test_a_graph_by_hand_relaxes_to_what_the_hand_finds() -> None:
    """Springs of one stiffness in series and parallel: each takes a third of the 0.3 m."""
    vertices, links = read_g2o(BY_HAND)
    rows = {number: row for row, number in enumerate(vertices)}
    poses = solve(np.array(list(vertices.values())), LinkArrays.of(links, rows, {})).poses
    assert np.allclose(poses, [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [2.2, 0.0, 0.0]], atol=1e-6)


@given(pose_arrays(6), pose_arrays(2), seeds)
def test_there_and_back(poses: FloatArray, motions: FloatArray, seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(3, 3))
    information = root @ root.T
    layout = Layout(
        poses=poses,
        nodes=np.array([0, 3, 5]),
        odometry=(link(0, 3, motions[0].tolist(), "odometry", information),),
        kept=(link(3, 5, motions[1].tolist(), "closure", np.eye(3)),),
        dropped=(link(0, 5, (9.0, 9.0, 0.0), "closure"),),
    )
    vertices, links = read_g2o(write_g2o(layout))
    assert list(vertices) == [0, 3, 5]
    assert np.allclose(list(vertices.values()), poses[[0, 3, 5]])
    assert [(edge.source, edge.target) for edge in links] == [(0, 3), (3, 5)], "what was dropped"
    assert np.allclose(links[0].information, information, rtol=1e-8, atol=1e-9)
    assert np.array_equal(links[0].information, links[0].information.T)
    assert np.allclose([edge.source_from_target for edge in links], motions, rtol=1e-8)


def test_the_text_is_what_g2o_reads() -> None:
    """The first vertex is fixed, last; of the information the upper triangle goes row by row."""
    information = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])
    layout = Layout(
        poses=np.array([[0.0, 0.0, 0.0], [1.0, -0.25, 0.5]]),
        nodes=np.array([0, 1]),
        odometry=(link(0, 1, (1.0, -0.25, 0.5), "odometry", information),),
    )
    assert write_g2o(layout).splitlines() == [
        "VERTEX_SE2 0 0 0 0",
        "VERTEX_SE2 1 1 -0.25 0.5",
        "EDGE_SE2 0 1 1 -0.25 0.5 1 2 3 4 5 6",
        "FIX 0",
    ]


def test_an_empty_layout_is_empty_text() -> None:
    assert write_g2o(Layout(poses=np.zeros((0, 3)))) == ""
    assert read_g2o("") == ({}, [])


def test_other_tags_are_passed_over_and_successive_vertices_are_odometry() -> None:
    text = "\n# a remark\nVERTEX_SE3:QUAT 1 2 3\n" + BY_HAND + "EDGE_SE2_XY 0 1 2 3\n"
    vertices, links = read_g2o(text)
    assert list(vertices) == [0, 1, 2]
    assert [edge.kind for edge in links] == ["odometry", "odometry", "closure"]


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

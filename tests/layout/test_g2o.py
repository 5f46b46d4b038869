"""The pose graph as g2o text: there and back, and a file written by hand."""

import numpy as np
import pytest

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import Pose2
from specmap_cli.layout.g2o import read_g2o, write_g2o
from specmap_cli.layout.pose_graph import Edges, Link, solve
from specmap_cli.layout.relaxation import Layout

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
    poses = solve(np.array(list(vertices.values())), Edges.of(links, rows, {})).poses
    assert np.allclose(poses, [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [2.2, 0.0, 0.0]], atol=1e-6)


def test_there_and_back() -> None:
    rng = np.random.default_rng(0)
    poses = rng.normal(size=(6, 3))
    root = rng.normal(size=(3, 3))
    odometry = [Link(0, 3, Pose2(0.1, 0.2, 0.3), root @ root.T, "odometry")]
    kept = [Link(3, 5, Pose2(-1.0, 2.0, 3.0), np.eye(3), "closure")]
    dropped = [Link(0, 5, Pose2(9.0, 9.0, 0.0), np.eye(3), "closure")]
    layout = Layout(poses, np.array([0, 3, 5]), odometry, kept, dropped, 0.0, [])
    vertices, links = read_g2o(write_g2o(layout))
    assert list(vertices) == [0, 3, 5]
    assert np.allclose(list(vertices.values()), poses[[0, 3, 5]])
    assert [(link.source, link.target) for link in links] == [(0, 3), (3, 5)]
    assert np.allclose(links[0].information, root @ root.T)
    assert np.allclose(links[1].source_from_target, kept[0].source_from_target)


def test_an_empty_layout_is_empty_text() -> None:
    layout = Layout(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), [], [], [], 0.0, [])
    assert write_g2o(layout) == ""


@pytest.mark.parametrize("line", ["VERTEX_SE2 0 1 2", "EDGE_SE2 0 1 x 0 0 1 0 0 1 0 1", "EDGE_SE2"])
def test_a_bad_line_is_named(line: str) -> None:
    with pytest.raises(InputError, match="line 2"):
        read_g2o("VERTEX_SE2 0 0 0 0\n" + line)

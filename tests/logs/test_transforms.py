"""The tree of frames against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.frames import TransformTree, tilt_of
from specmap_cli.logs.messages import TransformRecord


def random_transform(rng: np.random.Generator) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


def test_any_two_frames_of_a_tree_are_joined() -> None:
    rng = np.random.default_rng(2)
    tree = TransformTree()
    root_from = {"root": np.eye(4)}
    for number in range(12):
        parent = sorted(root_from)[rng.integers(len(root_from))]
        matrix = random_transform(rng)
        tree.add(TransformRecord(0, parent, f"frame{number}", matrix), dynamic=False)
        root_from[f"frame{number}"] = root_from[parent] @ matrix
    for target, root_from_target in root_from.items():
        for source, root_from_source in root_from.items():
            expected = np.linalg.inv(root_from_target) @ root_from_source
            found = tree.lookup(target, source)
            assert found is not None
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert tree.lookup("root", "elsewhere") is None
    assert tree.frames == set(root_from)


def test_later_transforms_replace_earlier_ones_and_loops_end() -> None:
    tree = TransformTree()
    tree.add(TransformRecord(0, "a", "b", np.eye(4)), dynamic=False)
    moved = np.eye(4)
    moved[0, 3] = 2.0
    tree.add(TransformRecord(1, "a", "b", moved), dynamic=True)
    found = tree.lookup("a", "b")
    assert found is not None
    assert found[0, 3] == 2.0
    assert tree.edges()[0][3]
    tree.add(TransformRecord(0, "b", "a", np.eye(4)), dynamic=False)
    tree.add(TransformRecord(0, "c", "c", np.eye(4)), dynamic=False)
    assert tree.lookup("c", "a") is None


def chain(length: int) -> TransformTree:
    """frame0 -> frame1 -> ..., each a metre ahead of its parent."""
    step = np.eye(4)
    step[0, 3] = 1.0
    tree = TransformTree()
    for number in range(length):
        record = TransformRecord(0, f"frame{number}", f"frame{number + 1}", step)
        tree.add(record, dynamic=number % 2 == 1)
    return tree


def test_ancestors_are_the_frames_up_to_the_root() -> None:
    tree = chain(3)
    assert list(tree.ancestors("frame3")) == ["frame3", "frame2", "frame1", "frame0"]
    assert list(tree.ancestors("elsewhere")) == ["elsewhere"]
    found = tree.lookup("frame0", "frame3")
    assert found is not None
    assert found[0, 3] == 3.0


def test_a_chain_of_frames_without_end_is_a_loop() -> None:
    assert chain(90).lookup("frame0", "frame90") is not None
    assert chain(200).lookup("frame0", "frame200") is None
    tree = chain(3)
    tree.add(TransformRecord(0, "frame3", "frame0", np.eye(4)), dynamic=False)
    assert tree.lookup("frame0", "elsewhere") is None
    assert len(list(tree.ancestors("frame0"))) == 100


def test_edges_are_told_by_child_with_what_moves() -> None:
    edges = chain(3).edges()
    assert [(parent, child, moves) for parent, child, _, moves in edges] == [
        ("frame0", "frame1", False),
        ("frame1", "frame2", True),
        ("frame2", "frame3", False),
    ]


def test_a_copy_changes_on_its_own() -> None:
    tree = chain(2)
    copy = tree.copy()
    copy.add(TransformRecord(0, "frame2", "hand", np.eye(4)), dynamic=True)
    copy.add(TransformRecord(0, "frame0", "frame1", np.eye(4)), dynamic=True)
    assert "hand" not in tree.frames
    assert tree.edges()[0][2][0, 3] == 1.0
    assert not tree.edges()[0][3]


@given(roll=st.floats(-3.14, 3.14), pitch=st.floats(-1.5, 1.5), yaw=st.floats(-3.14, 3.14))
def test_the_tilt_is_the_angle_between_the_z_axes(roll: float, pitch: float, yaw: float) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    expected = np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1, 1))
    assert tilt_of(matrix) == pytest.approx(expected, abs=1e-6)

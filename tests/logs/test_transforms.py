"""The tree of frames against SciPy, and odometry between stamps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.logs.messages import TransformRecord
from specmap_cli.logs.transforms import OdometryBuffer, TransformTree

MS = 1_000_000


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


@settings(max_examples=50, deadline=None, derandomize=True)
@given(share=st.floats(0.0, 1.0), start=st.floats(-3.1, 3.1), turn=st.floats(-1.5, 1.5))
def test_poses_between_stamps_lie_on_the_way(share: float, start: float, turn: float) -> None:
    buffer = OdometryBuffer()
    buffer.add(1000 * MS, Pose2(1.0, 2.0, start))
    buffer.add(1100 * MS, Pose2(3.0, -2.0, start + turn))
    pose = buffer.at(1000 * MS + round(share * 100 * MS))
    assert pose is not None
    assert pose.x == pytest.approx(1.0 + 2.0 * share)
    assert pose.y == pytest.approx(2.0 - 4.0 * share)
    assert math.remainder(pose.theta - start - share * turn, 2 * math.pi) == pytest.approx(
        0.0, abs=1e-6
    )


def test_the_order_of_arrival_does_not_matter() -> None:
    rng = np.random.default_rng(6)
    stamps = rng.permutation(50)
    buffer = OdometryBuffer()
    for stamp in stamps.tolist():
        buffer.add(1000 * MS + stamp * 20 * MS, Pose2(float(stamp), 0.0, 0.0))
    for tenth in range(490):
        pose = buffer.at(1000 * MS + tenth * 2 * MS)
        assert pose is not None
        assert pose.x == pytest.approx(tenth / 10)


def test_there_is_no_pose_in_holes_nor_far_outside() -> None:
    buffer = OdometryBuffer()
    assert buffer.at(5) is None
    buffer.add(1000 * MS, Pose2(1.0, 0.0, 0.0))
    buffer.add(9000 * MS, Pose2(9.0, 0.0, 0.0))
    assert buffer.at(5000 * MS) is None
    assert buffer.at(1000 * MS) == (1.0, 0.0, 0.0)
    assert buffer.at(950 * MS) == (1.0, 0.0, 0.0), "held for a tenth of a second"
    assert buffer.at(9050 * MS) == (9.0, 0.0, 0.0)
    assert buffer.at(800 * MS) is None
    assert buffer.at(9200 * MS) is None


def test_a_repeated_stamp_replaces_the_pose() -> None:
    buffer = OdometryBuffer()
    buffer.add(1000 * MS, Pose2(1.0, 0.0, 0.0))
    buffer.add(1000 * MS, Pose2(2.0, 0.0, 0.0))
    assert buffer.at(1000 * MS) == (2.0, 0.0, 0.0)


def test_a_clock_set_back_starts_anew() -> None:
    buffer = OdometryBuffer()
    buffer.add(100_000 * MS, Pose2(1.0, 0.0, 0.0))
    buffer.add(1000 * MS, Pose2(5.0, 0.0, 0.0))
    assert buffer.latest_ns == 1000 * MS
    assert buffer.at(100_000 * MS) is None


def test_memory_is_bounded() -> None:
    buffer = OdometryBuffer()
    for number in range(20_000):
        buffer.add(number * MS, Pose2(float(number), 0.0, 0.0))
    assert len(buffer._stamps) <= OdometryBuffer.MAX_POSES
    assert buffer.at(19_990 * MS) == (19_990.0, 0.0, 0.0)
    assert buffer.at(0) is None

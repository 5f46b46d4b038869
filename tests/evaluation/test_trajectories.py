"""Trajectory errors on trajectories whose error is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import Pose2, compose, invert
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation.trajectories import (
    Relations,
    associate,
    best_motion,
    read_relations,
    read_tum,
    reference_errors,
    relation_errors,
)
from tests.strategies import poses


def walk(count: int = 400) -> Trajectory:
    """A path of 40 m that winds."""
    steps = np.tile([0.1, 0.0, 0.0], (count, 1))
    steps[:, 2] = 0.05 * np.sin(np.arange(count) / 10)
    path = [np.zeros(3)]
    for step in steps[1:]:
        path.append(compose(path[-1], step))
    return Trajectory(np.arange(count, dtype=np.int64) * 10**8, np.array(path))


def test_reads_tum_with_comments_and_exact_stamps(tmp_path: Path) -> None:
    file = tmp_path / "a.tum"
    half = np.sqrt(0.5)
    file.write_text(
        "# timestamp x y z qx qy qz qw\n\n"
        "1134864629.895182123 1 2 0 0 0 0 1\n"
        f"1134864630.5,3,4,0,0,0,{half},{half}  # commas too\n"
    )
    found = read_tum(file)
    assert found.stamps_ns.tolist() == [1134864629895182123, 1134864630500000000]
    assert np.allclose(found.poses, [[1.0, 2.0, 0.0], [3.0, 4.0, np.pi / 2]])


def test_reads_relations(tmp_path: Path) -> None:
    file = tmp_path / "a.relations"
    file.write_text("1216.630413 1217.5 0.4 -0.01 0 0 0 -0.07\n")
    found = read_relations(file)
    assert found.earlier_ns.tolist() == [1216630413000]
    assert found.later_ns.tolist() == [1217500000000]
    assert np.allclose(found.poses, [[0.4, -0.01, -0.07]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds no"),
        ("# nothing\n", "holds no"),
        ("1 2 3\n", ":1: 3 columns"),
        ("\n1 2 0 0 0 0 x 1\n", ":2: .* not all numbers"),
        ("1 2 nan 0 0 0 0 1\n", "not all finite"),
        ("x 2 0 0 0 0 0 1\n", "not all numbers"),
        ("1e300 2 0 0 0 0 0 1\n", "no time in seconds"),
    ],
)
def test_malformed_files_are_one_clear_line(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "bad.txt"
    file.write_text(text)
    for read in (read_tum, read_relations):
        with pytest.raises(InputError, match=says) as caught:
            read(file)
        assert "\n" not in str(caught.value)


def test_missing_and_binary_files_are_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="UTF-8"):
        read_relations(tmp_path / "b.tum")


@given(st.lists(st.integers(0, 300), max_size=30), st.lists(st.integers(0, 300), max_size=30))
def test_association_is_the_nearest_within_tolerance(have: list[int], want: list[int]) -> None:
    stamps, wanted = np.array(have, dtype=np.int64), np.array(want, dtype=np.int64)
    rows, found = associate(stamps, wanted, 5)
    expected = [k for k, w in enumerate(want) if any(abs(s - w) <= 5 for s in have)]
    assert rows.tolist() == expected
    for row, k in zip(rows.tolist(), found.tolist(), strict=True):
        assert abs(have[k] - want[row]) == min(abs(s - want[row]) for s in have)
        assert k == have.index(have[k])


@given(poses)
def test_a_perfect_trajectory_has_no_error_in_any_frame(motion: Pose2) -> None:
    truth = walk()
    moved = Trajectory(truth.stamps_ns, compose(np.array(motion), truth.poses))
    found = reference_errors(moved, truth)
    assert sorted(found.relative) == [1.0, 5.0, 20.0]
    assert found.ate_m < 1e-6
    assert found.end_m < 1e-6
    assert all(r.translation_m.max < 1e-6 for r in found.relative.values())
    back = best_motion(moved.poses[:, :2], truth.poses[:, :2])
    assert np.allclose((back @ motion)[:2], 0.0, atol=1e-6)


def test_a_scale_error_grows_with_the_length_of_path() -> None:
    truth = walk()
    straight = Trajectory(truth.stamps_ns, truth.poses * (1, 0, 0))
    longer = Trajectory(truth.stamps_ns, straight.poses * (1.02, 1, 1))
    found = reference_errors(longer, straight)
    for length, errors in found.relative.items():
        assert errors.translation_m.mean == pytest.approx(0.02 * length, rel=0.1)
        assert errors.rotation_deg.max == 0.0
    end = float(straight.poses[-1, 0] - straight.poses[0, 0])
    assert found.end_m == pytest.approx(0.02 * end)
    assert found.as_dict()["relative"]["5"]["matched"] == found.relative[5.0].matched


def test_relation_errors_are_those_put_in() -> None:
    truth = walk()
    i, j = np.arange(0, 300, 10), np.arange(50, 350, 10)
    right = compose(invert(truth.poses[i]), truth.poses[j])
    wrong = compose(right, np.array([0.03, 0.04, np.radians(2.0)]))
    relations = Relations(
        np.append(truth.stamps_ns[i], 10**15),
        np.append(truth.stamps_ns[j], 10**15 + 1),
        np.vstack([wrong, [0, 0, 0]]),
    )
    found = relation_errors(truth, relations)
    assert (found.matched, found.total) == (30, 31)
    assert found.translation_m.mean == pytest.approx(0.05)
    assert found.translation_m.std == pytest.approx(0.0, abs=1e-9)
    assert found.rotation_deg.median == pytest.approx(2.0)


def test_foreign_truth_is_said() -> None:
    truth = walk(20)
    later = Trajectory(truth.stamps_ns + 10**15, truth.poses)
    with pytest.raises(InputError, match="no stamps in common"):
        reference_errors(later, truth)
    with pytest.raises(InputError, match="no stamps in common"):
        relation_errors(later, Relations(truth.stamps_ns, truth.stamps_ns, truth.poses))

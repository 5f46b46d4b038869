"""Trajectory errors on trajectories whose error is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import Pose2, compose, nearest_motion
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation import trajectories
from specmap_cli.evaluation.trajectories import Relations, read_relations
from specmap_cli.maps.text_files import read_tum
from tests.strategies import poses, seeds


def walk(count: int = 400) -> Trajectory:
    """A path of 40 m that winds."""
    steps = np.tile([0.1, 0.0, 0.0], (count, 1))
    steps[:, 2] = 0.05 * np.sin(np.arange(count) / 10)
    path = [np.zeros(3)]
    for step in steps[1:]:
        path.append(compose(path[-1], step))
    return Trajectory(np.arange(count, dtype=np.int64) * 10**8, np.array(path))


STAMPS = {
    **{"5": 5_000_000_000, "5.": 5_000_000_000, ".5": 500_000_000, "-2.25": -2_250_000_000},
    **{"1700000000.123456789": 1_700_000_000_123_456_789, "0.1234567891": 123_456_789},
    **{"1.5e3": 1_500_000_000_000, "+3": 3_000_000_000},
}


def test_comments_commas_stamps_in_any_notation_and_tilted_bodies_are_read(tmp_path: Path) -> None:
    file = tmp_path / "a.tum"
    tilted = 3.0 * Rotation.from_euler("ZYX", [0.8, 0.2, -0.1]).as_quat()  # of any length
    lines = [f"{stamp},3,4,5,{','.join(map(str, tilted))}  # too" for stamp in STAMPS]
    file.write_text("\n".join(["# timestamp x y z qx qy qz qw", "", "9 1 2 0 0 0 0 1", *lines]))
    found = read_tum(file)
    assert found.stamps_ns.tolist() == [9 * 10**9, *STAMPS.values()]
    assert np.allclose(found.poses, [[1.0, 2.0, 0.0], *[[3.0, 4.0, 0.8]] * len(STAMPS)])
    file.write_text("1216.630413 1217.5 0.4 -0.01 0 0 0 -0.07\n")
    relations = read_relations(file)
    assert relations.earlier_ns.tolist() == [1216630413000]
    assert relations.later_ns.tolist() == [1217500000000]
    assert np.allclose(relations.poses, [[0.4, -0.01, -0.07]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"\xff\xfe\x00\x80", "not UTF-8 text"),
        (b"", "holds no"),
        (b"# nothing\n", "holds no"),
        (b"1 2 3\n", ":1: 3 columns"),
        (b"\n1 2 0 0 0 0 x 1\n", ":2: .* not all numbers"),
        (b"1 2 nan 0 0 0 0 1\n", "not all finite"),
        (b"x 2 0 0 0 0 0 1\n", "not all numbers"),
        (b"1e300 2 0 0 0 0 0 1\n", "no time in seconds"),
        (b"99999999999999999999 2 0 0 0 0 0 1\n", "no time in seconds"),
        (b"1e10 2 0 0 0 0 0 1\n", ":1: '1e10' is no time in seconds; mend or remove the line"),
        (b"-1e10 2 0 0 0 0 0 1\n", "no time in seconds"),
        (b"9200000000 2 0 0 0 0 0 1\n", "no time in seconds"),
    ],
)
def test_malformed_files_are_one_clear_line(tmp_path: Path, text: bytes, says: str) -> None:
    file = tmp_path / "bad.txt"
    file.write_bytes(text)
    for read in (read_tum, read_relations):
        with pytest.raises(InputError, match=says) as caught:
            read(file)
        assert "\n" not in str(caught.value)
        with pytest.raises(InputError, match=r"none\.tum: cannot be read: No such file"):
            read(tmp_path / "none.tum")


@given(st.lists(st.integers(0, 300), max_size=30), st.lists(st.integers(0, 300), max_size=30))
def test_association_is_the_nearest_within_tolerance(have: list[int], want: list[int]) -> None:
    stamps, wanted = np.array(have, dtype=np.int64), np.array(want, dtype=np.int64)
    rows, found = trajectories.associate(stamps, wanted, 5)
    expected = [k for k, w in enumerate(want) if any(abs(s - w) <= 5 for s in have)]
    assert rows.tolist() == expected
    for row, k in zip(rows.tolist(), found.tolist(), strict=True):
        assert abs(have[k] - want[row]) == min(abs(s - want[row]) for s in have)
        assert k == have.index(have[k])


def test_a_scale_error_grows_with_the_length_of_path_as_far_as_it_reaches() -> None:
    truth = walk()
    straight = Trajectory(truth.stamps_ns, truth.poses * (1, 0, 0))
    longer = Trajectory(truth.stamps_ns, straight.poses * (1.02, 1, 1))
    found = trajectories.reference_errors(longer, straight)
    for length, errors in found.relative.items():
        assert errors.translation_m.mean == pytest.approx(0.02 * length, rel=0.1)
        assert errors.rotation_deg.max == 0.0
    end = float(straight.poses[-1, 0] - straight.poses[0, 0])
    assert found.end_m == pytest.approx(0.02 * end)
    assert found.as_dict()["relative"]["5"]["matched"] == found.relative[5.0].matched
    for count, lengths in ((5, []), (30, [1.0]), (120, [1.0, 5.0]), (400, [1.0, 5.0, 20.0])):
        short = walk(count)
        assert list(trajectories.reference_errors(short, short).relative) == lengths


def anywhere(seed: int, count: int) -> Trajectory:
    """Poses (count, 3) of a random walk, a tenth of a second apart."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0.0, (0.5, 0.5, 0.3), (count, 3))
    stamps = 1_700_000_000_123_456_789 + 10**8 * np.arange(count)
    return Trajectory(stamps, np.cumsum(steps, axis=0))


@given(seeds, poses)
def test_the_best_motion_is_that_of_a_singular_value_decomposition(
    seed: int, motion: Pose2
) -> None:
    """Arun et al. (PAMI 1987), by numpy, on points that do not fit exactly."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5, 5, (12, 2))
    targets = motion.apply(points) + rng.normal(0.0, 0.3, (12, 2))
    found = nearest_motion(points, targets)
    p, t = points - points.mean(axis=0), targets - targets.mean(axis=0)
    u, _, vt = np.linalg.svd(p.T @ t)
    rotation = vt.T @ np.diag([1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    np.testing.assert_allclose(found.rotation(), rotation, atol=1e-9)
    np.testing.assert_allclose(found.apply(points).mean(axis=0), targets.mean(axis=0), atol=1e-9)


@given(seeds)
def test_relation_errors_are_those_of_homogeneous_matrices(seed: int) -> None:
    """Each relation by itself: inverse(wanted) times measured, as in Burgard et al."""
    driven, rng = anywhere(seed, 30), np.random.default_rng(seed)
    i, j = rng.integers(0, 30, (2, 9))
    wanted = rng.normal(0, 1, (10, 3))
    # the last has no pose
    earlier, later = (np.append(driven.stamps_ns[k], 10**15) for k in (i, j))
    found = trajectories.relation_errors(driven, Relations(earlier, later, wanted))
    assert (found.matched, found.total) == (9, 10)
    lengths, angles = [], []
    for first, second, pose in zip(i, j, wanted[:9], strict=True):
        a, b = (Pose2(*driven.poses[k].tolist()).matrix() for k in (first, second))
        error = np.linalg.inv(Pose2(*pose.tolist()).matrix()) @ np.linalg.inv(a) @ b
        lengths.append(np.linalg.norm(error[:2, 3]))
        angles.append(abs(np.degrees(np.arctan2(error[1, 0], error[0, 0]))))
    for spread, values in ((found.translation_m, lengths), (found.rotation_deg, angles)):
        assert spread.mean == pytest.approx(np.mean(values))
        assert spread.std == pytest.approx(np.std(values))
        assert spread.median == pytest.approx(np.median(values))
        assert spread.p95 == pytest.approx(np.percentile(values, 95))
        assert spread.max == pytest.approx(np.max(values))


def test_the_absolute_error_is_after_the_best_motion_and_the_end_error_before_any() -> None:
    """Of the poses that match: those between the scans do not."""
    truth = walk(100)
    bent = Trajectory(truth.stamps_ns, truth.poses + (0.0, 0.0, np.radians(3.0)))
    stamps = np.concatenate([truth.stamps_ns, truth.stamps_ns + 5 * 10**7])
    found = trajectories.reference_errors(bent, Trajectory(stamps, np.tile(truth.poses, (2, 1))))
    assert (found.matched, found.total) == (100, 200)
    assert found.ate_m == pytest.approx(0.0, abs=1e-9)
    assert found.end_deg == pytest.approx(0.0, abs=1e-9)
    way = truth.poses[-1, :2] - truth.poses[0, :2]
    assert found.end_m == pytest.approx(2 * np.sin(np.radians(1.5)) * np.hypot(*way))


@pytest.mark.parametrize(("common", "words"), [(0, "no stamps"), (1, "one stamp")])
def test_one_common_pose_is_too_few(common: int, words: str) -> None:
    truth = walk(20)
    stamps = truth.stamps_ns + 10**15
    stamps[:common] = truth.stamps_ns[:common]
    foreign = Trajectory(stamps, truth.poses)
    with pytest.raises(InputError, match=rf"have {words} in common \(20 in the truth\)"):
        trajectories.reference_errors(foreign, truth)
    relations = Relations(truth.stamps_ns[1:], truth.stamps_ns[1:], truth.poses[1:])
    with pytest.raises(InputError, match="no stamps in common"):
        trajectories.relation_errors(foreign, relations)

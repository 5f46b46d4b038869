"""A sweep in front of the local map: its score, its alignment kernel by kernel, its search."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.matching import Window
from specmap_cli.registration.aligner import SensorKind
from specmap_cli.registration.local_map import Bounds, Fit, LocalMap
from tests.registration.aligners import ToldAligner
from tests.registration.drives import scene_in, scene_of, turned, view_of_points
from tests.strategies import seeds
from tests.turning import configured

LADDER = (2.0, 1.0, 0.5, 0.25)


def test_kernels_shrink_and_only_the_fine_ones_need_all_points(world: GridMap) -> None:
    aligner = ToldAligner()
    scene = scene_in(world, aligner)
    scene.align(np.eye(4), LADDER)
    assert [asked.kernel_m for asked in aligner.asked] == pytest.approx([0.2, 0.1, 0.05, 0.025])
    assert [asked.coarse for asked in aligner.asked] == [True, True, False, False]
    for asked in aligner.asked:
        assert asked.points is (scene.view.sparse if asked.coarse else scene.view.cloud)
    assert len(scene.view.sparse) < len(scene.view.cloud)


def test_kernels_are_in_voxels_of_the_sensor(world: GridMap) -> None:
    aligner = ToldAligner()
    scene_in(world, aligner, voxel_m=0.3).align(np.eye(4), (1.0,))
    assert aligner.asked[0].kernel_m == pytest.approx(0.3)


def test_every_alignment_starts_where_the_one_before_ended(world: GridMap) -> None:
    aligner = ToldAligner(lambda guess: guess @ Pose2(0.1, 0.0, 0.0).matrix())
    fit = scene_in(world, aligner).align(np.eye(4), LADDER)
    assert [float(asked.guess[0, 3]) for asked in aligner.asked] == pytest.approx(
        [0, 0.1, 0.2, 0.3]
    )
    assert fit.planar.x == pytest.approx(0.4)
    assert fit.refused == 0


def test_near_by_few_kernels_begin_where_steps_on_the_score_field_end(world: GridMap) -> None:
    guess, aligner = turned(0.06, 0.04, 0.0), ToldAligner()
    scene = scene_in(world, aligner)
    scene.align_quickly(guess, Bounds.around(guess, scene.config))
    (asked,) = aligner.asked
    assert asked.kernel_m == pytest.approx(0.025)
    assert asked.guess == pytest.approx(np.eye(4), abs=0.01)


def test_in_space_few_kernels_begin_at_the_guess(world: GridMap) -> None:
    guess, aligner = turned(0.06, 0.04, 0.0), ToldAligner()
    scene = scene_in(world, aligner)
    scene.local.sensor = dataclasses.replace(scene.local.sensor, in_space=True)
    scene.align_quickly(guess, Bounds.around(guess, scene.config))
    assert [asked.kernel_m for asked in aligner.asked] == pytest.approx([0.15, 0.025])
    assert np.array_equal(aligner.asked[0].guess, guess)


def broken(guess: FloatArray) -> FloatArray:
    return np.full_like(guess, np.nan)


def moved(
    x: float = 0.0, yaw: float = 0.0, roll: float = 0.0
) -> Callable[[FloatArray], FloatArray]:
    return lambda guess: guess @ turned(x, yaw, roll)


@pytest.mark.parametrize(
    "answer",
    [broken, moved(x=1.51), moved(yaw=0.81), moved(yaw=-0.81), moved(roll=0.31), moved(x=1e300)],
)
def test_an_alignment_that_runs_off_is_refused_and_ends_the_ladder(
    world: GridMap, answer: Callable[[FloatArray], FloatArray]
) -> None:
    answers = [moved(x=0.2), answer]
    aligner = ToldAligner(lambda guess: answers.pop(0)(guess))
    fit = scene_in(world, aligner).align(np.eye(4), LADDER)
    assert len(aligner.asked) == 2
    assert fit.refused == 1
    assert fit.planar == Pose2(0.2, 0.0, 0.0)  # the result before it stands


@pytest.mark.parametrize("answer", [moved(x=1.49), moved(yaw=0.79), moved(roll=0.29)])
def test_an_alignment_within_the_limits_is_followed(
    world: GridMap, answer: Callable[[FloatArray], FloatArray]
) -> None:
    fit = scene_in(world, ToldAligner(answer)).align(np.eye(4), (1.0,))
    assert fit.refused == 0
    assert np.array_equal(fit.pose, answer(np.eye(4)))


def test_the_limits_count_from_the_first_guess_of_all_kernels(world: GridMap) -> None:
    aligner = ToldAligner(moved(x=0.6))
    fit = scene_in(world, aligner).align(np.eye(4), LADDER)
    assert fit.planar.x == pytest.approx(1.2)  # the third step would be 1.8 m away
    assert fit.refused == 1


@pytest.mark.parametrize(
    ("setting", "value", "answer"),
    [
        ("max_shift_m", 3.0, moved(x=2.5)),
        ("max_shift_rad", 2.0, moved(yaw=1.5)),
        ("max_tilt_rad", 0.6, moved(roll=0.5)),
    ],
)
def test_limits_of_an_alignment_are_settings(
    world: GridMap, setting: str, value: float, answer: Callable[[FloatArray], FloatArray]
) -> None:
    assert scene_in(world, ToldAligner(answer)).align(np.eye(4), (1.0,)).refused == 1
    wider = scene_in(world, ToldAligner(answer), **{setting: value})
    assert wider.align(np.eye(4), (1.0,)).refused == 0


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_score_is_that_of_the_distances_to_the_nearest_walls(
    world: GridMap, x: float, y: float, turn: float
) -> None:
    scene = scene_in(world, ToldAligner())
    place = Pose2(x, y, turn)
    distance, _ = KDTree(scene.view.walls).query(place.apply(scene.view.probe))
    exact = float(np.exp(-(distance**2) / (2 * 0.1**2)).mean())  # sigma is a voxel
    assert scene.score(place) == pytest.approx(exact, abs=0.12)  # cells of 7.5 cm


def test_the_score_is_of_the_alignment_that_stands(world: GridMap) -> None:
    scene = scene_in(world, ToldAligner(moved(x=0.3)))
    fit = scene.align(np.eye(4), (1.0,))
    assert fit.score == scene.score(Pose2(0.3, 0.0, 0.0)) < scene.score(IDENTITY)


@pytest.mark.parametrize("away", [Pose2(0.2, -0.15, 0.2), Pose2(-0.25, 0.1, -0.3)])
def test_a_search_finds_the_place_from_a_wrong_guess(world: GridMap, away: Pose2) -> None:
    aligner = ToldAligner()
    scene = scene_in(world, aligner)
    fit = scene.search(away.matrix(), Window(distance_m=0.3, angle_rad=0.35, step_m=0.05), LADDER)
    assert fit.planar.distance < 0.08
    assert abs(fit.planar.theta) < 0.03
    assert len(aligner.asked) == len(LADDER)  # what was found is aligned


def test_a_search_in_the_plane_keeps_height_and_tilt_of_the_guess(world: GridMap) -> None:
    guess = turned(0.2, 0.1, 0.05)
    guess[2, 3] = 0.7
    fit = scene_in(world, ToldAligner()).search(
        guess, Window(distance_m=0.3, angle_rad=0.2, step_m=0.05), LADDER
    )
    assert fit.pose[2, 3] == pytest.approx(0.7)
    assert fit.pose[2, 2] == pytest.approx(guess[2, 2])
    assert np.allclose(fit.pose[:3, :3] @ fit.pose[:3, :3].T, np.eye(3))
    assert fit.planar.distance < 0.08


@pytest.mark.parametrize(
    ("score", "taken"), [(0.4, False), (0.5, False), (0.51, False), (0.53, True), (0.9, True)]
)
def test_another_fit_must_be_clearly_better(score: float, taken: bool) -> None:
    first = Fit(pose=np.eye(4), score=0.5, refused=1)
    second = Fit(pose=Pose2(1.0, 0.0, 0.0).matrix(), score=score, refused=2)
    best = first.or_better(second)
    assert best.planar.x == float(taken)
    assert best.score == (score if taken else 0.5)
    assert best.refused == 3


@given(seeds)
def test_the_local_map_keeps_the_walls_of_the_last_keyframes_only(seed: int) -> None:
    """Against a list of all keyframes and a slice of its end; rebuilt at every other one."""
    rng = np.random.default_rng(seed)
    few = {"window_keyframes": 3, "rebuild_keyframes": 2}
    config = configured(RegistrationConfig, "registration", few)
    sensor = SensorKind(in_space=False, voxel_m=0.1, range_m=20.0)
    local, walls = LocalMap(ToldAligner(), sensor, config), []
    for x, y, turn in rng.uniform(-2, 2, (7, 3)).tolist():
        view = view_of_points(rng.uniform(-1.5, 1.5, (5, 2)))
        pose = Pose2(x, y, turn)
        local.insert(view, pose.matrix())
        walls.append(pose.apply(view.walls))
        now = np.concatenate(walls[-3:])
        assert len(local) == min(3, len(walls))
        assert local.field.score(now, IDENTITY) == pytest.approx(1.0)
        kept = 3 if len(walls) % 2 else 4  # the oldest goes at the next rebuild
        for old in walls[:-kept]:
            distance, _ = KDTree(np.concatenate(walls[-kept:])).query(old)
            gone = old[distance > 0.5]
            assert local.field.score(gone, IDENTITY) < 1e-3
    local.clear()
    assert len(local) == 0


def test_the_field_follows_the_robot_when_keyframes_are_far_apart() -> None:
    """Forty keyframes every 2 m along a corridor: the walls round the last one count."""
    config = RegistrationConfig()
    sensor = SensorKind(in_space=False, voxel_m=0.1, range_m=20.0)
    local = LocalMap(ToldAligner(), sensor, config)
    walls = np.array([[x, y] for x in np.arange(-3.0, 3.0, 0.05).tolist() for y in (-1.0, 1.0)])
    view = view_of_points(walls, 5.0)
    for k in range(40):
        local.insert(view, Pose2(2.0 * k, 0.0, 0.0).matrix())
    last = Pose2(78.0, 0.0, 0.0)
    assert local.field.score(walls, last) == pytest.approx(1.0)
    assert local.field.left_out > 0
    assert local.seen.holds(last.apply(walls)).all()
    assert not local.seen.holds(walls).any()  # walls that score nothing are no evidence


def test_support_counts_only_what_could_be_seen() -> None:
    """Against the score of each half alone."""
    old = np.column_stack([np.linspace(-2.0, 2.0, 80), np.full(80, 1.0)])
    new = old + (0.0, 20.0)
    scene = scene_of(np.concatenate([old, new]), old, ToldAligner(), looked_m=5.0)
    support = scene.support(IDENTITY)
    assert support.score == pytest.approx(1.0, abs=1e-6)
    assert (support.share, support.count) == (0.5, 40)
    assert scene.score(IDENTITY) == pytest.approx(0.5, abs=1e-6)
    shifted = Pose2(0.0, 0.2, 0.0)
    assert scene.gain(IDENTITY, shifted) < -0.6  # the half that neither sees does not dilute it
    assert scene.gain(shifted, IDENTITY) == pytest.approx(-scene.gain(IDENTITY, shifted))
    far = Pose2(0.0, 30.0, 0.0)
    assert scene.support(far).count == 0
    assert scene.gain(IDENTITY, far) == 0.0

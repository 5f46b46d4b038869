"""A sweep in front of the local map: its score, its alignment kernel by kernel, its search."""

import cv2
import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import FREE, GridMap
from specmap_cli.grids.matching import Window
from specmap_cli.registration.aligner import SensorKind
from specmap_cli.registration.local_map import Fit, LocalMap, seen_space
from specmap_cli.registration.sweep_view import outline_of
from tests.registration.aligners import ToldAligner
from tests.registration.drives import circle, scene_in, scene_of, turned, view_of_points
from tests.strategies import seeds

LADDER = (2.0, 1.0, 0.5, 0.25)


@pytest.mark.parametrize(
    ("answer", "settings", "followed"),
    [
        (np.full((4, 4), np.nan), {}, False),
        (turned(1e300, 0.0, 0.0), {}, False),
        (turned(1.51, 0.0, 0.0), {}, False),
        (turned(1.49, 0.0, 0.0), {}, True),
        (turned(2.5, 0.0, 0.0), {"max_shift_m": 3.0}, True),
        (turned(0.0, 0.81, 0.0), {}, False),
        (turned(0.0, -0.81, 0.0), {}, False),
        (turned(0.0, 0.79, 0.0), {}, True),
        (turned(0.0, 1.5, 0.0), {"max_shift_rad": 2.0}, True),
        (turned(0.0, 0.0, 0.31), {}, False),
        (turned(0.0, 0.0, 0.29), {}, True),
        (turned(0.0, 0.0, 0.5), {"max_tilt_rad": 0.6}, True),
    ],
)
def test_an_alignment_that_runs_off_is_refused_and_ends_the_ladder(
    world: GridMap, answer: FloatArray, settings: dict[str, float], followed: bool
) -> None:
    """The result before it stands."""
    before = turned(0.2, 0.0, 0.0)
    answers = [before, answer, answer]
    aligner = ToldAligner(lambda _: answers.pop(0))
    fit = scene_in(world, aligner, **settings).align(np.eye(4), (2.0, 1.0, 0.5))
    assert len(aligner.kernels_m) == 2 + followed
    assert fit.refused == 1 - followed
    assert np.array_equal(fit.pose, answer if followed else before)


@pytest.mark.parametrize("away", [Pose2(0.2, -0.15, 0.2), Pose2(-0.25, 0.1, -0.3)])
def test_a_search_finds_the_place_from_a_wrong_guess(world: GridMap, away: Pose2) -> None:
    """In the plane: height and tilt are those of the guess."""
    aligner = ToldAligner()
    guess = away.matrix() @ turned(0.0, 0.0, 0.05)
    guess[2, 3] = 0.7
    window = Window(distance_m=0.3, angle_rad=0.35, step_m=0.05)
    fit = scene_in(world, aligner).search(guess, window, LADDER)
    assert fit.planar.distance < 0.08
    assert abs(fit.planar.theta) < 0.03
    assert len(aligner.kernels_m) == len(LADDER)  # what was found is aligned
    assert fit.pose[2, 3] == pytest.approx(0.7)
    assert fit.pose[2, 2] == pytest.approx(guess[2, 2])
    assert np.allclose(fit.pose[:3, :3] @ fit.pose[:3, :3].T, np.eye(3))


@pytest.mark.parametrize(
    ("score", "taken"), [(0.4, False), (0.5, False), (0.51, False), (0.53, True), (0.9, True)]
)
def test_another_fit_must_be_clearly_better(score: float, taken: bool) -> None:
    first = Fit(pose=np.eye(4), score=0.5, refused=1)
    best = first.or_better(Fit(pose=Pose2(1.0, 0.0, 0.0).matrix(), score=score, refused=2))
    assert best.planar.x == float(taken)
    assert best.score == (score if taken else 0.5)
    assert best.refused == 3


def new_map() -> LocalMap:
    sensor = SensorKind(in_space=False, voxel_m=0.1, range_m=20.0)
    return LocalMap(ToldAligner(), sensor, RegistrationConfig())


def test_the_local_map_forgets_what_left_its_window() -> None:
    """Eighty keyframes, which leave with every fourth one."""
    local = new_map()
    walls = np.column_stack([np.linspace(-1.0, 1.0, 40), np.full(40, 1.0)])
    first = Pose2(0.0, 15.0, 0.0)
    local.insert(view_of_points(walls), first.matrix())
    for _ in range(79):
        local.insert(view_of_points(walls), np.eye(4))
    assert local.field.score(walls, first) == pytest.approx(1.0)
    local.insert(view_of_points(walls), np.eye(4))
    assert local.field.score(walls, first) < 1e-3
    assert len(local) == 80
    local.clear()
    assert len(local) == 0


def test_the_field_follows_the_robot_when_keyframes_are_far_apart() -> None:
    """Forty keyframes every 2 m along a corridor: the walls round the last one count."""
    local = new_map()
    walls = np.array([[x, y] for x in np.arange(-3.0, 3.0, 0.05).tolist() for y in (-1.0, 1.0)])
    view = view_of_points(walls, 5.0)
    for k in range(40):
        local.insert(view, Pose2(2.0 * k, 0.0, 0.0).matrix())
    last = Pose2(78.0, 0.0, 0.0)
    assert local.field.score(walls, last) == pytest.approx(1.0)
    assert local.field.left_out > 0
    assert (local.seen.values_at(last.apply(walls)) == FREE).all()
    assert (local.seen.values_at(walls) != FREE).all()  # walls that score nothing are no evidence


def test_support_counts_only_what_could_be_seen() -> None:
    """Against the score of each half alone."""
    old = np.column_stack([np.linspace(-2.0, 2.0, 80), np.full(80, 1.0)])
    scene = scene_of(np.concatenate([old, old + (0.0, 20.0)]), old, ToldAligner(), looked_m=5.0)
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


CELL_M = 0.2
Points = list[tuple[float, float]]


@given(seeds)
def test_space_inside_of_an_outline_was_seen_and_space_outside_was_not(seed: int) -> None:
    """Against the signed distance of each point from each outline."""
    rng = np.random.default_rng(seed)
    scans = [circle(0, rng.uniform(1.0, 5.0, 24)).planar for _ in range(3)]
    outlines = [outline_of(scan, Pose2(*rng.uniform(-2, 2, 3)), 20.0) for scan in scans]
    points = rng.uniform(-8, 8, (200, 2))
    polygons = [outline[1:].astype(np.float32) for outline in outlines]
    deep = [[cv2.pointPolygonTest(one, at, True) for one in polygons] for at in points.tolist()]
    depths = np.max(deep, axis=1)
    found = seen_space(outlines, CELL_M, 20.0).values_at(points) == FREE
    assert found[depths > 0.0].all()
    assert not found[depths < -3 * CELL_M].any()


def half_circle() -> PlanarScan:
    """Walls to the right, no returns to the left, and nothing looks back."""
    bearings = np.linspace(-np.pi / 2, np.pi / 2, 181)
    return PlanarScan(0, bearings, np.where(bearings < 0.0, 3.0, np.inf), 10.0, full_circle=False)


FAR = circle(0, np.full(90, 9.0)).planar


HALF = outline_of(half_circle(), IDENTITY, 10.0)
NEAR = outline_of(FAR, Pose2(1.0, 0.0, 0.3), 4.0)  # no farther than walls are registered
WIDE = outline_of(FAR, IDENTITY, 20.0)


@pytest.mark.parametrize(
    ("outline", "side_m", "inside", "outside"),
    [
        (HALF, 10.0, [(1.0, -1.0)], [(1.0, 1.5), (-1.0, -1.0), (2.5, -3.0)]),
        (NEAR, 20.0, [(4.5, 0.0), (-2.5, 0.0)], [(6.0, 0.0)]),
        (WIDE, 5.0, [(4.9, 4.9)], [(5.5, 0.0), (-1e6, 0.0), (0.0, 1e9)]),  # points off the grid
    ],
    ids=["half a circle", "near", "off the grid"],
)
def test_what_was_seen(outline: FloatArray, side_m: float, inside: Points, outside: Points) -> None:
    seen = seen_space([outline], CELL_M, side_m)
    assert (seen.values_at(np.array(inside)) == FREE).all()
    assert (seen.values_at(np.array(outside)) != FREE).all()


@pytest.mark.parametrize("beams", [4, 359, 720, 5000])
def test_outlines_of_many_beams_are_thinned(beams: int) -> None:
    outline = outline_of(circle(0, np.full(beams, 2.0)).planar, IDENTITY, 10.0)
    assert len(outline) <= 362
    assert np.allclose(outline[0], 0.0)
    assert np.allclose(np.hypot(*outline[1:].T), 2.0)
    assert np.allclose(outline[1], outline[-1])

"""From the guess to the best pose: which searches are made, which guess is taken, what slips."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.registration.guess import UNKNOWN, ExpectedMotion, Reliance, best_guess
from specmap_cli.registration.local_map import Fit, Scene
from specmap_cli.registration.trust import (
    FAIR_SCORE,
    GOOD_SCORE,
    POOR_SCORE,
    SURE_SCORE,
    Located,
    judge,
)
from specmap_cli.registration.trust import locate as located_by
from tests.registration.aligners import ToldAligner
from tests.registration.drives import expecting, guess_of, scene_in, scene_of, turned
from tests.turning import turned as constants


def locate(
    scene: Scene, at: Pose2, expected: ExpectedMotion, motion: Pose2, reliance: Reliance = UNKNOWN
) -> Located:
    return located_by(scene, guess_of(at, expected, reliance, motion))


WORTHLESS = Reliance((9.0,) * 60, (9.0,) * 60, (9.0,) * 60)
BAD_TURNS = Reliance((0.1,) * 60, (0.1,) * 60, (9.0,) * 60)


@pytest.mark.parametrize(
    ("guess", "searched"),
    [(IDENTITY, False), (Pose2(0.15, 0.0, 0.0), True), (Pose2(0.0, 0.0, 0.11), True)],
)
def test_a_good_fit_far_off_is_searched_for(world: GridMap, guess: Pose2, searched: bool) -> None:
    """The alignment is right; only the guess is off."""
    aligner = ToldAligner(lambda _: np.eye(4))
    located = locate(scene_in(world, aligner), guess, expecting(), IDENTITY)
    assert (located.searched, located.wide_searched) == (searched, False)
    np.testing.assert_allclose(located.fit.pose, np.eye(4), atol=0.0 if searched else 0.02)
    if not searched:
        assert aligner.kernels_m == pytest.approx([0.025])


@pytest.mark.parametrize(
    ("away", "measured", "wide"),
    [
        (Pose2(0.2, 0.1, 0.1), True, False),
        (Pose2(-0.1, 0.2, -0.3), True, False),
        (Pose2(0.8, -0.7, 0.5), False, True),
        (Pose2(-0.5, 0.9, -1.4), False, True),
    ],
)
def test_a_low_score_is_searched_for_near_by_and_a_poor_one_widely(
    world: GridMap, away: Pose2, measured: bool, wide: bool
) -> None:
    aligner = ToldAligner()
    located = locate(scene_in(world, aligner), away, expecting(measured=measured), IDENTITY)
    assert located.searched
    assert located.wide_searched or not wide
    assert located.fit.score > 0.75 or wide
    assert located.fit.planar.distance < (0.15 if wide else 0.08)
    assert abs(located.fit.planar.theta) < (0.05 if wide else 0.03)
    if wide:
        assert aligner.kernels_m[-5:] == pytest.approx([0.4, 0.2, 0.1, 0.05, 0.025])


def test_the_guess_is_odometry_s_unless_the_walls_object(world: GridMap) -> None:
    """A robot that turned before and now drives on: a carried turn would lead the scan astray."""
    scene, before = scene_in(world, ToldAligner()), np.eye(4)
    slightly, wildly = Pose2(0.01, 0.0, 0.002), Pose2(0.0, 0.0, 0.34)
    beyond = Pose2(0.0, 0.0, 0.36)  # a turn that odometry may miss
    for odometry, taken in ((slightly, slightly), (wildly, IDENTITY), (beyond, beyond)):
        guess = best_guess(scene, before, expecting(odometry, IDENTITY))
        assert np.allclose(guess, taken.matrix()), odometry
    # what is no better is not taken, nor anything at all against no odometry
    assert np.allclose(best_guess(scene, before, expecting(wildly, wildly)), wildly.matrix())
    unmeasured = expecting(wildly, IDENTITY, measured=False)
    assert np.allclose(best_guess(scene, before, unmeasured), wildly.matrix())


def test_in_a_hole_walls_choose_between_odometry_and_the_motion_before(world: GridMap) -> None:
    """The truth is the identity; what is not right may be off by a little more than is searched."""
    scene, before = scene_in(world, ToldAligner()), np.eye(4)
    right, wrong = Pose2(0.1, 0.0, 0.0), Pose2(-1.3, 0.0, 0.02)
    for odometry, carried in ((wrong, right), (right, wrong), (right, right)):
        expected = replace(expecting(odometry, carried), hole=True)
        guess = Pose2.from_matrix(best_guess(scene, before, expected))
        if odometry is right:
            assert guess == right, "odometry is the guess unless walls object"
        else:
            assert guess.distance < 0.06


@pytest.mark.parametrize("backwards", [1.0, 0.5])
def test_a_step_back_told_as_one_forwards_is_found(world: GridMap, backwards: float) -> None:
    """The truth is the identity; odometry leads 2 m on, or as far as half of it was backwards."""
    step = Pose2(1.0, 0.0, 0.0)
    guess = Pose2(2.0 * backwards * step.x, 0.0, 0.0)
    located = locate(scene_in(world, ToldAligner(), max_shift_m=0.8), guess, expecting(step), guess)
    assert located.fit.planar.distance < 0.1
    assert located.fit.score > 0.85


@pytest.mark.parametrize("measured", [True, False])
def test_a_turn_walls_deny_gives_way_to_the_motion_before(world: GridMap, measured: bool) -> None:
    """The truth is the identity; odometry turns by half a turn, farther than a search does."""
    scene = scene_in(world, ToldAligner())
    turn = Pose2(0.0, 0.0, 3.0)
    located = locate(scene, turn, expecting(turn, measured=measured), turn)
    assert (located.fit.score > 0.9) == measured


def test_odometry_denies_by_what_it_is_worth_of_way_and_of_turn() -> None:
    """Wheels whose turns are bad: they still know that the robot did not come half a metre on."""
    step = Pose2(0.5, 0.0, 0.0)
    ahead = Fit(pose=turned(0.5, 0.0, 0.0), score=0.9)
    askew = Fit(pose=turned(0.0, 1.5, 0.0), score=0.9)
    denied = {
        (name, where): guess_of(IDENTITY, expecting(step), reliance).denies(fit)
        for name, reliance in (("all", UNKNOWN), ("way", BAD_TURNS), ("none", WORTHLESS))
        for where, fit in (("ahead", ahead), ("askew", askew))
    }
    found = [key for key, value in denied.items() if value]
    assert found == [("all", "ahead"), ("all", "askew"), ("way", "ahead")]
    assert not guess_of(IDENTITY, expecting(step, measured=False)).denies(ahead)


@pytest.mark.parametrize(
    ("here", "there", "reliance", "kept"),
    [
        (34, 46, BAD_TURNS, True),
        (34, 46, WORTHLESS, False),
        (18, 34, BAD_TURNS, False),  # walls that could be seen say that the robot is not here
    ],
)
def test_a_wide_search_finds_no_place_that_wheels_alone_deny(
    here: int, there: int, reliance: Reliance, kept: bool
) -> None:
    """Few returns, of furniture: so many of 60 fit at the way driven, and so many beside it."""
    posts = np.random.default_rng(4).uniform(-4.0, 4.0, (60, 2))
    known = np.concatenate([posts[:here], posts[:there] + (0.1, 0.6)])
    scene = scene_of(posts, known, ToldAligner(), looked_m=9.0)
    step = expecting(Pose2(0.1, 0.0, 0.0))
    located = locate(scene, IDENTITY, step, IDENTITY, reliance)
    assert located.wide_searched
    assert located.agrees == kept
    assert (located.fit.planar.distance < 0.1) == kept


def line(x: FloatArray | float, y: FloatArray | float) -> FloatArray:
    """Points (N, 2), of which one coordinate may be the same."""
    return np.column_stack(np.broadcast_arrays(x, y))


def box(turn: float) -> FloatArray:
    """The walls of a room of 6 by 4 m, turned."""
    x, y = np.arange(-3.0, 3.0, 0.05), np.arange(-2.0, 2.0, 0.05)
    walls = [line(x, side) for side in (-2.0, 2.0)] + [line(side, y) for side in (-3.0, 3.0)]
    return Pose2(0.0, 0.0, turn).apply(np.concatenate(walls))


def test_nothing_new_in_sight_gives_up_a_place_that_agrees_for_one_that_fits_much_better() -> None:
    """Odometry missed 0.08 rad of a turn; at its place the walls of the room fit in part."""
    scene = scene_of(box(-0.08), box(0.0), ToldAligner(), looked_m=9.0)
    assert FAIR_SCORE < scene.score(IDENTITY) < GOOD_SCORE
    located = locate(scene, IDENTITY, expecting(Pose2(0.5, 0.0, 0.0)), IDENTITY)
    assert located.support.share > 0.9
    assert located.fit.planar.theta == pytest.approx(0.08, abs=0.02)
    assert located.fit.score > 0.85


@pytest.mark.parametrize(("turn", "found"), [(0.6, True), (1.0, False)])
def test_against_trusted_odometry_turns_are_searched_to_a_bound(turn: float, found: bool) -> None:
    scene = scene_of(box(-turn), box(0.0), ToldAligner(), looked_m=9.0)
    located = locate(scene, IDENTITY, expecting(Pose2(0.5, 0.0, 0.0)), IDENTITY)
    assert located.wide_searched
    assert (abs(located.fit.planar.theta - turn) < 0.05) == found
    assert abs(located.fit.planar.theta) <= 0.8


@pytest.mark.parametrize(
    ("every", "narrow", "found"), [(20, True, False), (20, False, True), (2, True, True)]
)
def test_of_a_narrow_sweep_points_count_and_not_their_share(
    every: int, narrow: bool, found: bool
) -> None:
    """All points fit the room turned by 0.3 rad; odometry says that the robot did not turn."""
    scene = scene_of(box(-0.3)[::every], box(0.0), ToldAligner(), looked_m=9.0)
    with constants("registration.local_map", _NARROW_RAD=7.0 if narrow else 0.0):
        located = locate(scene, IDENTITY, expecting(Pose2(0.5, 0.0, 0.0)), IDENTITY)
    assert located.overrules == found
    assert located.fit.planar.theta == pytest.approx(0.3 if found else 0.0, abs=0.06)


@pytest.mark.parametrize(
    ("view_rad", "share", "narrow"),
    [(1.2, 1.0, True), (np.pi, 1.0, False), (6.2, 0.1, False), (6.2, 0.05, True), (6.2, 0.0, True)],
)
def test_a_laser_whose_beams_hardly_return_is_as_narrow_as_a_camera(
    view_rad: float, share: float, narrow: bool
) -> None:
    bearings = np.linspace(-view_rad / 2, view_rad / 2, 400)
    ranges = np.where(np.arange(400) < share * 400, 2.0, np.inf)
    scene = scene_of(box(0.0), box(0.0), ToldAligner())
    view = replace(scene.view, planar=PlanarScan(0, bearings, ranges, 6.0, False))
    assert replace(scene, view=view).is_narrow == narrow


def corridor(length_m: float, end_m: float | None = None) -> FloatArray:
    """Two bare walls 2 m apart; a wall across one end, if any, in which half of the points lie."""
    x = np.arange(-length_m / 2, length_m / 2, 0.05)
    walls = [line(x, y) for y in (-1.0, 1.0)]
    if end_m is not None:
        walls.append(line(end_m, np.linspace(-1.0, 1.0, 2 * len(x))))
    return np.concatenate(walls)


def scene_in_corridor(end_m: float | None = None) -> Scene:
    """A corridor, which the map knows farther than the sweep sees."""
    return scene_of(corridor(20.0, end_m), corridor(30.0, end_m), ToldAligner())


def test_of_a_narrow_sweep_odometry_counts_since_the_last_keyframe() -> None:
    """From sweep to sweep the robot fell back a little, along a bare corridor by half a metre."""
    guess = guess_of(Pose2(-0.5, 0.0, 0.0), expecting(Pose2(0.02, 0.0, 0.0)))
    guess = replace(guess, since=Pose2(2.0, 0.0, 0.0))
    with constants("registration.local_map", _NARROW_RAD=7.0):
        located = located_by(scene_in_corridor(), guess)
    assert located.fit.planar.distance < 0.01
    assert located.agrees
    assert not guess.agrees(located.fit), "half a metre is too much for a step of two centimetres"


def test_nothing_new_in_sight_overrules_odometry_at_whose_place_most_walls_fit() -> None:
    """Stamps of wheels and laser are apart: the robot is still where wheels say that it left."""
    walls = np.concatenate([corridor(10.0), line(5.0, np.linspace(-1.0, 1.0, 180))])
    scene = scene_of(walls + (0.2, 0.0), walls, ToldAligner(), looked_m=9.0)
    assert SURE_SCORE < scene.score(IDENTITY) < GOOD_SCORE
    located = locate(scene, IDENTITY, expecting(), IDENTITY)
    assert located.overrules
    assert located.fit.planar.x == pytest.approx(-0.2, abs=0.05)
    assert located.fit.score > 0.95


@pytest.mark.parametrize(("points", "taken"), [(30, False), (200, True)])
def test_of_places_much_alike_a_search_takes_that_near_the_guess(points: int, taken: bool) -> None:
    """A post fits farther on: a small one better, but not by enough for a quarter metre."""
    post = line(2.0, np.linspace(-0.3, 0.3, points))
    seen = np.concatenate([corridor(20.0), post])
    known = np.concatenate([corridor(30.0), post + (0.25, 0.0)])
    scene = scene_of(seen, known, ToldAligner(), good_score=1.0)
    assert scene.score(Pose2(0.25, 0.0, 0.0)) > scene.score(IDENTITY) + 0.02
    located = locate(scene, IDENTITY, expecting(measured=False), IDENTITY)
    assert located.searched
    assert (located.fit.planar.x > 0.05) == taken
    # trusted odometry, which the walls do not contradict, is not given up for a larger post
    trusting = locate(scene, IDENTITY, expecting(), IDENTITY)
    assert trusting.fit.planar == IDENTITY
    assert trusting.agrees


@pytest.mark.parametrize(
    ("posts", "trusted", "kept"),
    [
        (0, True, True),  # a look-alike half a metre on explains a little more
        (0, False, False),
        (260, True, False),  # a wall that stands half a metre on: wheels slipped
    ],
)
def test_trusted_odometry_gives_way_to_much_better(posts: int, trusted: bool, kept: bool) -> None:
    """The registration method runs 0.5 m ahead, along a corridor with few marks."""
    ahead = Pose2(0.5, 0.0, 0.0)
    marks = np.tile(line(2.0, np.linspace(1.0, 1.4, 9)), (12, 1))  # of a recess, 0.4 m deep
    post = line(3.0, np.linspace(-0.8, 0.8, posts))
    seen = np.concatenate([corridor(10.0), marks, post])
    known = np.concatenate([corridor(30.0), marks + (0.5, 0.0), post + (0.5, 0.0)])
    scene = scene_of(seen, known, ToldAligner(lambda _: ahead.matrix()))
    assert scene.score(ahead) > scene.score(IDENTITY) + 0.05
    reliance = UNKNOWN if trusted else WORTHLESS
    located = locate(scene, IDENTITY, expecting(Pose2(0.1, 0.0, 0.0)), IDENTITY, reliance)
    assert (located.fit.planar == IDENTITY) == kept
    assert (located.fit.planar == ahead) == (not kept)
    assert located.unaligned == kept


@pytest.fixture(scope="module")
def bare() -> Scene:
    return scene_in_corridor()


@given(st.floats(-0.5, 0.5), st.floats(-0.03, 0.03), st.floats(-0.01, 0.01))
def test_along_a_bare_corridor_the_way_is_odometry_s(
    bare: Scene, ahead_m: float, offset_m: float, turn: float
) -> None:
    """Registration stays behind at the guess; heading and offset are as it found them."""
    found = locate(bare, IDENTITY, expecting(), Pose2(ahead_m, offset_m, turn)).fit.planar
    assert found.x == pytest.approx(ahead_m if abs(ahead_m) >= 0.08 else 0.0, abs=1e-9)
    assert (found.y, found.theta) == pytest.approx((0.0, 0.0), abs=1e-3)


def with_beams(scene: Scene) -> Scene:
    """The scene, its scan made of the points in order of bearing."""
    points = scene.view.walls
    x, y = points[np.argsort(np.arctan2(points[:, 1], points[:, 0]), kind="stable")].T
    planar = replace(
        scene.view.planar, bearings=np.arctan2(y, x), ranges=np.hypot(x, y), range_max=30.0
    )
    return replace(scene, view=replace(scene.view, planar=planar))


@pytest.mark.parametrize(("every", "way_m"), [(1000, 0.0), (10, 0.03)])
def test_where_beams_do_not_return_odometry_tells_the_least_bit_of_way(
    every: int, way_m: float
) -> None:
    scene = with_beams(scene_in_corridor())
    ranges = scene.view.planar.ranges.copy()
    ranges[::every] = np.inf
    planar = replace(scene.view.planar, ranges=ranges)
    scene = replace(scene, view=replace(scene.view, planar=planar))
    found = locate(scene, IDENTITY, expecting(), Pose2(0.03, 0.0, 0.0)).fit.planar
    assert found.x == pytest.approx(way_m, abs=1e-9)


@pytest.mark.parametrize("turn", [0.0, 0.4, -2.0])
@pytest.mark.parametrize(("end_m", "carried"), [(None, True), (4.0, False)])
def test_without_odometry_the_motion_goes_on_along_a_bare_corridor_and_only_there(
    end_m: float | None, carried: bool, turn: float
) -> None:
    """Heading and place across the corridor are those of the registration."""
    way, ahead = Pose2(0.0, 0.0, turn), Pose2(0.3, 0.2, 0.1)
    seen, known = (way.apply(corridor(length, end_m)) for length in (20.0, 30.0))
    scene = with_beams(scene_of(seen, known, ToldAligner()))
    found = locate(scene, IDENTITY, expecting(measured=False), way @ ahead).fit.planar
    along, across, heading = way.inverse() @ found @ way
    assert along == pytest.approx(ahead.x if carried else 0.0, abs=1e-3)
    assert (across, heading) == pytest.approx((0.0, 0.0), abs=1e-3)


def test_odometry_is_followed_to_an_end_in_sight_only_as_far_as_the_score_allows() -> None:
    """It is 0.3 m ahead; the end wall objects to that, but may not to a part of it."""
    scene = scene_in_corridor(end_m=4.0)
    located = locate(scene, IDENTITY, expecting(), Pose2(0.3, 0.0, 0.0))
    np.testing.assert_allclose(located.fit.planar, IDENTITY, atol=0.02)
    guess, ahead = Pose2(-0.1, 0.0, 0.0), Pose2(0.2, 0.0, 0.0)  # the truth is in between
    fit = locate(scene, guess, expecting(), ahead).fit
    assert guess.x < fit.planar.x < ahead.x
    assert scene.score(ahead) < scene.score(guess) <= fit.score == scene.score(fit.planar)


CONTRADICTED = Reliance(along=(3.0,) * 60)  # three slacks off along the way, time and again


@pytest.mark.parametrize(
    ("measured", "reliance", "free"),
    [(True, UNKNOWN, False), (True, CONTRADICTED, True), (False, UNKNOWN, True)],
)
def test_no_result_turns_far_against_trusted_odometry(
    world: GridMap, measured: bool, reliance: Reliance, free: bool
) -> None:
    """The truth is turned by 1.2 rad: a search may go there only where odometry may err so."""
    scene = scene_in(world, ToldAligner())
    guess = Pose2(0.3, 0.2, -1.2)
    located = locate(scene, guess, expecting(measured=measured), IDENTITY, reliance)
    turned_rad = abs((guess.inverse() @ located.fit.planar).theta)
    assert located.wide_searched
    assert (turned_rad > 1.1) == free
    assert free or turned_rad <= 0.8


def new_room(x: float) -> FloatArray:
    """Walls of a room that begins at x, with a niche."""
    y = np.arange(-3.0, 3.0, 0.05)
    walls = (line(x + 4.0, y), line(x + 0.7 * (y + 3.0), 3.0), line(x + 4.0 + 0.2 * y, -3.4))
    return np.concatenate(walls)


def test_new_space_is_no_evidence_against_the_place_that_odometry_tells() -> None:
    """Half of the walls are where the map has never looked; the others fit."""
    hall = corridor(6.0, end_m=-3.0)
    scene = scene_of(np.concatenate([hall, new_room(6.0)]), hall, ToldAligner(), looked_m=4.0)
    located = locate(scene, IDENTITY, expecting(), IDENTITY)
    assert scene.score(IDENTITY) < 0.75
    assert located.fit.planar == IDENTITY
    assert not located.searched
    assert located.agrees
    assert located.support.score > 0.95
    assert located.support.share < 0.9


@pytest.mark.parametrize(("turn", "rooms", "lost"), [(0.3, 1, False), (0.6, 2, True)])
def test_most_walls_overrule_odometry(turn: float, rooms: int, lost: bool) -> None:
    """A turn was missed on the way into new rooms, whose walls are half of those seen, or more."""
    seen = np.concatenate([box(0.0), *(new_room(6.0 * (k + 1)) for k in range(rooms))])
    scene = scene_of(Pose2(0.0, 0.0, -turn).apply(seen), box(0.0), ToldAligner(), looked_m=4.0)
    step = expecting(Pose2(0.5, 0.0, 0.0))
    located = locate(scene, IDENTITY, step, IDENTITY)
    assert located.fit.score < POOR_SCORE + 0.05
    assert judge(located, guess_of(IDENTITY, step), scene.config).lost == lost


def test_where_nothing_could_be_seen_trusted_odometry_stands() -> None:
    """The aligner drags the new walls onto old ones, 0.9 m away."""
    drag = Pose2(0.9, 0.0, 0.0).matrix()
    aligner = ToldAligner(lambda guess: guess @ drag)
    scene = scene_of(new_room(12.0), corridor(6.0), aligner, looked_m=4.0)
    located = locate(scene, IDENTITY, expecting(Pose2(1.0, 0.0, 0.0)), IDENTITY)
    assert located.fit.planar == IDENTITY
    assert located.agrees
    assert located.unaligned
    assert located.support.count == 0


def test_walls_that_contradict_trusted_odometry_everywhere_do_not_agree() -> None:
    """Walls at random where the map has looked: the robot is somewhere else."""
    scene = scene_of(np.random.default_rng(2).uniform(-4, 4, (80, 2)), corridor(8.0), ToldAligner())
    located = locate(scene, IDENTITY, expecting(), IDENTITY)
    assert located.support.share > 0.9
    assert located.support.score < 0.5


def test_a_motion_is_not_carried_on_to_where_walls_object() -> None:
    """The map knows no walls that far: the robot has looked there, and seen none."""
    scene = with_beams(scene_of(corridor(6.0), corridor(6.0), ToldAligner()))
    far = Pose2(1.5, 0.0, 0.0)
    assert locate(scene, IDENTITY, expecting(measured=False), far).fit.planar == IDENTITY

"""Walls matched with walls in the ring: the right pose, its uncertainty, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import SPREAD_M, Match, Window, search
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.wall_matching import WallFit, match_walls, nearby_link, opened
from specmap_cli.layout.walls import Walls
from tests.layout.driving import between, scans_of
from tests.turning import turned

Perfect = tuple[KeyframeStore, Graph]


def pass_of(perfect: Perfect, row: int) -> tuple[FloatArray, FloatArray, Pose2]:
    """Walls of a node of the second lap, of the same place in the first, and the true pose."""
    store, graph = perfect
    away = np.hypot(*(graph.poses[:100, :2] - graph.poses[row, :2]).T)
    old, walls = int(np.argmin(away)), Walls(store, graph, MATCH_RANGE_M)
    source, target = walls.around(row, 3, graph.poses), walls.around(old, 8, graph.poses)
    return source, target, between(graph.poses, old, row)


def corridor(beams: int = 720) -> FloatArray:
    """What is seen in the middle of a bare corridor along x, 2 m wide and very long."""
    cells = np.full((60, 1000), OCCUPIED, dtype=np.uint8)
    cells[10:50] = FREE
    (scan,) = scans_of(GridMap(cells, 0.05), np.array([[25.0, 1.5, 0.0]]), beams)
    return scan.hits(6.0)


def deviations(fit: WallFit | None) -> FloatArray:
    """Standard deviations of x, y and heading in the frame of the source."""
    assert fit is not None
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(fit.information))))


@pytest.mark.parametrize("seed", range(12))
def test_a_pass_is_matched_to_centimetres(perfect: Perfect, seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, target, truth = pass_of(perfect, int(rng.integers(142, 205)))
    error = Pose2(*rng.uniform((-0.7, -0.7, -0.14), (0.7, 0.7, 0.14)).tolist())
    fit = match_walls(source, target, truth @ error, 1.0)
    assert fit is not None
    gap = truth.inverse() @ fit.target_from_source
    assert gap.distance < 0.05
    assert abs(gap.theta) < 0.02
    assert (np.linalg.eigvalsh(fit.information) > 0).all()
    assert np.allclose(fit.information, fit.information.T)


def test_another_place_does_not_fit(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    source, target = (walls.around(row, reach, graph.poses) for row, reach in ((10, 3), (45, 8)))
    here = Pose2(0.0, 0.0, 0.0)
    assert match_walls(source, target, here, 1.0) is None
    assert match_walls(source, target, here, 1.0, 0.0) is not None, "the score alone refuses it"


def counted_searches(monkeypatch: pytest.MonkeyPatch) -> list[Window]:
    """The windows that are searched from now on."""
    windows: list[Window] = []

    def counted(field: ScoreField, points: FloatArray, guess: Pose2, window: Window) -> Match:
        windows.append(window)
        return search(field, points, guess, window)

    monkeypatch.setattr("specmap_cli.layout.wall_matching.search", counted)
    return windows


@pytest.mark.parametrize(("off_m", "drift_m", "searches"), [(0.05, 0.4, 0), (0.3, 0.4, 2)])
def test_what_fits_where_it_is_said_to_be_is_not_searched(
    perfect: Perfect,
    monkeypatch: pytest.MonkeyPatch,
    off_m: float,
    drift_m: float,
    searches: int,
) -> None:
    source, target, truth = pass_of(perfect, 190)
    windows = counted_searches(monkeypatch)
    fit = match_walls(source, target, truth @ Pose2(off_m, 0.0, 0.0), drift_m)
    assert fit is not None
    assert (truth.inverse() @ fit.target_from_source).distance < 0.05
    assert len(windows) == searches


def test_where_much_may_have_drifted_a_good_fit_is_not_the_end_of_it(
    perfect: Perfect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Doors in a row look alike: the next one may fit better still."""
    source, target, truth = pass_of(perfect, 190)
    windows = counted_searches(monkeypatch)
    assert match_walls(source, target, truth, 0.6) is not None
    assert len(windows) == 2


def test_what_shows_other_walls_is_given_up_after_the_rough_search(
    perfect: Perfect, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, _, _ = pass_of(perfect, 190)
    windows = counted_searches(monkeypatch)
    target = np.column_stack([np.linspace(20.0, 25.0, 200), np.full(200, 20.0)])
    assert match_walls(source, target, Pose2(0.0, 0.0, 0.0), 0.4) is None
    assert len(windows) == 1


def test_what_lies_farther_off_than_the_drift_is_not_found(perfect: Perfect) -> None:
    source, target, truth = pass_of(perfect, 190)
    guess = truth @ Pose2(2.0, 0.0, 0.0)
    near = match_walls(source, target, guess, 0.5)
    far = match_walls(source, target, guess, 2.2)
    assert near is None or (truth.inverse() @ near.target_from_source).distance > 0.5
    assert far is not None
    assert (truth.inverse() @ far.target_from_source).distance < 0.05


@pytest.mark.parametrize(("count", "least", "found"), [(40, 20, True), (40, 60, False)])
def test_too_few_points_are_not_matched(count: int, least: int, found: bool) -> None:
    points = corridor()
    few = points[:: len(points) // count]
    here = Pose2(0.0, 0.0, 0.0)
    with turned("layout.wall_matching", MATCH_POINTS=least):
        assert (match_walls(few, points, here, 0.3, 0.1) is not None) is found
        assert match_walls(np.zeros((0, 2)), points, here, 0.3, 0.1) is None


@pytest.mark.parametrize(("turn", "open_axis"), [(0.0, 0), (np.pi / 2, 1)])
def test_along_a_corridor_a_match_is_loose_in_the_frame_of_the_source(
    turn: float, open_axis: int
) -> None:
    """One robot looks along the corridor and may be off ahead, one looks at a wall."""
    points = corridor()
    target_from_source = Pose2(0.0, 0.0, turn)
    source = target_from_source.inverse().apply(points)
    deviation = deviations(match_walls(source, points, target_from_source, 0.3))
    assert deviation[open_axis] > 0.1
    assert deviation[1 - open_axis] < 0.05


def spread_of(along_m: float, across_m: float, heading: float) -> FloatArray:
    """A covariance that is long at a heading."""
    turn = Pose2(0.0, 0.0, heading).rotation()
    spread = np.diag([0.0, 0.0, 0.01**2])
    spread[:2, :2] = turn @ np.diag([along_m**2, across_m**2]) @ turn.T
    return spread


@pytest.mark.parametrize("heading", [0.0, 0.7, np.pi / 2, 2.5])
def test_a_window_that_fits_all_over_says_nothing_of_the_way(heading: float) -> None:
    window_m = SPREAD_M / np.sqrt(3)
    axis, across = (
        np.array([np.cos(heading + turn), np.sin(heading + turn)]) for turn in (0.0, np.pi / 2)
    )
    bare = opened(spread_of(window_m, 0.02, heading))
    assert axis @ bare[:2, :2] @ axis == pytest.approx(4.0)
    assert across @ bare[:2, :2] @ across == pytest.approx(0.02**2)
    sharp = spread_of(0.02, 0.01, heading)
    assert np.allclose(opened(sharp), sharp, rtol=0.02, atol=1e-9)
    half = opened(spread_of(0.1, 0.02, heading))
    known = 1.0 / 0.1**2 - 1.0 / window_m**2
    assert axis @ half[:2, :2] @ axis == pytest.approx(1.0 / known)
    assert half[2, 2] == 0.01**2


def test_in_a_bare_corridor_the_nearest_of_equal_places_is_taken() -> None:
    short = corridor(500)
    short = short[np.abs(short[:, 0]) < 3.0]
    fit = match_walls(short, corridor(), Pose2(0.5, 0.0, 0.0), 2.0)
    assert fit is not None
    assert abs(fit.target_from_source.x - 0.5) < 0.35
    assert abs(fit.target_from_source.y) < 0.03
    assert deviations(fit)[0] > 0.5, "more than the window that was looked at"
    assert deviations(fit)[1] < 0.05


def test_a_link_names_the_keyframes_of_its_rows(perfect: Perfect) -> None:
    _, graph = perfect
    made = nearby_link(graph, 3, 200, WallFit(Pose2(1.0, 2.0, 0.5), np.eye(3)))
    assert (made.source, made.target) == (graph.nodes[3], graph.nodes[200])
    assert (made.kind, made.source_from_target) == ("nearby", (1.0, 2.0, 0.5))

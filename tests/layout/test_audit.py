"""Passes that contradict each other: found, brought together where they can be, and counted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2, compose
from specmap_cli.grids.gridmap import OCCUPIED
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import (
    _PASS_M,
    _WALL_M,
    Audit,
    Disagreement,
    audit,
    passes_of,
)
from specmap_cli.layout.contradictions import Agreement, Views
from specmap_cli.layout.path_graph import LOOP_PATH_M, Graph, graph_of
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import Layout
from tests.layout.driving import (
    CONFIG,
    SECOND_LAP,
    Drive,
    Laps,
    building,
    closures_alone,
    drifted,
    moved_from,
    scans_of,
    stored,
    worst,
)
from tests.turning import turned

Bent = tuple[KeyframeStore, Layout]


@pytest.fixture(scope="module")
def bent(drive: Drive) -> Iterator[Bent]:
    """The drive with a turn that goes on, and its layout without any nearby pass."""
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        with closures_alone():
            layout = relax(store, [], {}, CONFIG)
        yield store, layout


def test_a_right_layout_has_no_disagreement_and_noise_of_centimetres_makes_none(
    perfect: Laps,
) -> None:
    store, poses = perfect[0], perfect[0].poses
    found = audit(store, poses, [])
    assert found.compared >= 5
    assert found.disagreements == ()
    noisy = moved_from(SECOND_LAP, poses, (0.05, -0.05, 0.005))
    assert audit(store, noisy, []).disagreements == ()


@pytest.mark.parametrize(
    "motion",
    [(0.4, 0.0, 0.0), (0.0, -0.4, 0.0), (1.0, 0.7, 0.0), (-2.0, 0.3, 0.0), (0.5, 0.3, 0.04)],
)
def test_walls_drawn_twice_are_found_with_their_distance_and_the_way_back(
    perfect: Laps, motion: tuple[float, float, float]
) -> None:
    store, poses = perfect[0], perfect[0].poses
    bent = moved_from(SECOND_LAP, poses, motion)
    found = audit(store, bent, []).disagreements
    known = [(one, one.offset) for one in found if one.offset is not None]
    assert known
    for one, offset in known:
        assert one.earlier < SECOND_LAP <= one.later
        away = Pose2(*motion).inverse().apply(np.array([one.place]))[0] - one.place
        assert one.apart_m == pytest.approx(float(np.hypot(*away)), abs=0.12)
        back = compose(np.array(offset), bent[one.later])
        assert np.hypot(*(back - poses[one.later])[:2]) < 0.15


@pytest.mark.parametrize("size_m", [(0.5, 0.2), (3.0, 0.4)])
def test_what_came_between_two_visits_is_no_disagreement(
    drive: Drive, size_m: tuple[float, float]
) -> None:
    """A chair is shorter than a wall; of a cupboard no motion makes an older wall."""
    poses, scans = drive
    plan = building()
    cells = np.array(plan.cells)
    length, depth = (round(side / plan.resolution) for side in size_m)
    cells[58 : 58 + depth, 70 : 70 + length] = OCCUPIED  # in the lower corridor
    later = scans_of(replace(plan, cells=cells), poses[SECOND_LAP:])
    with (
        stored(poses, [*scans[:SECOND_LAP], *later]) as store,
        turned("layout.audit", _DISAGREEING_SHARE=0.02),
    ):
        assert audit(store, poses, []).disagreements == ()


def test_passes_cut_the_whole_path_and_end_at_breaks(perfect: Laps) -> None:
    store, poses = perfect[0], perfect[0].poses
    passes = passes_of(store, poses, [SECOND_LAP])
    assert [one.first for one in passes][1:] == [one.last + 1 for one in passes][:-1]
    assert passes[0].first == 0
    assert passes[-1].last == len(poses) - 1
    assert SECOND_LAP in [one.first for one in passes]
    ways = np.diff([one.way_m for one in passes])
    assert (ways <= _PASS_M + 0.2).all()


def test_distance_is_that_at_the_place_of_the_walls() -> None:
    one = Disagreement(
        earlier=0, later=9, place=(10.0, 0.0), walls_m=3.0, share=0.5, offset=Pose2(0.0, 0.0, 0.1)
    )
    assert one.apart_m == pytest.approx(2 * 10.0 * np.sin(0.05))
    assert replace(one, offset=None).apart_m is None


def test_a_layout_with_its_passes_has_no_disagreement_and_without_them_it_has(
    store: KeyframeStore, bent: Bent
) -> None:
    assert audit(store, relax(store, [], {}, CONFIG).poses, []).disagreements == ()
    assert audit(bent[0], bent[1].poses, []).disagreements


def test_another_building_is_not_bent_until_it_fits(drive: Drive) -> None:
    """The second lap drawn over the first, turned: no small motion mends that."""
    truth, scans = drive
    folded = moved_from(SECOND_LAP, truth, (9.0, -2.0, np.pi / 2))
    with stored(folded, scans) as store, closures_alone():
        layout = relax(store, [], {}, CONFIG)
        found = audit(store, layout.poses, [])
    assert found.disagreements
    assert all(one.walls_m >= _WALL_M for one in found.disagreements)
    for lap in (slice(None, SECOND_LAP), slice(SECOND_LAP, None)):
        assert worst(layout.poses[lap], truth[lap]) < 0.1, "each lap keeps its form"


@pytest.fixture(scope="module")
def seen(perfect: Laps) -> tuple[Graph, Views]:
    """The drive as it was, and what was seen."""
    store = perfect[0]
    graph = graph_of(store, [], {})
    return graph, Views.of(store, graph)


@pytest.mark.parametrize("motion", [(0.0, 1.0, 0.0), (1.5, 0.0, 0.0), (0.0, 0.0, 0.1)])
def test_a_pass_that_was_moved_contradicts(
    seen: tuple[Graph, Views], motion: tuple[float, float, float]
) -> None:
    graph, views = seen
    right = views.agreement(graph.poses)
    assert right.agree > 5000
    assert right.contradict < 0.01 * right.agree
    first = int(np.searchsorted(graph.nodes, SECOND_LAP))
    wrong = views.agreement(moved_from(first, graph.poses, motion))
    assert wrong.contradict > 0.01 * wrong.agree
    assert wrong.worst is not None
    assert wrong.agree < right.agree
    assert wrong.is_worse_than(right)
    assert not right.is_worse_than(wrong)
    assert wrong.is_doubtful
    assert not right.is_doubtful


def test_a_person_before_walls_that_both_passes_saw_contradicts_nothing(
    seen: tuple[Graph, Views],
) -> None:
    """Somebody stands a metre before the laser in one view of ten of the second pass, or in all."""
    graph, views = seen
    first = int(np.searchsorted(views.rows, np.searchsorted(graph.nodes, SECOND_LAP)))
    before = views.agreement(graph.poses).contradict
    found = []
    for chosen in (slice(first, None, 10), slice(first, None)):
        ranges = views.ranges.copy()
        ranges[chosen, 40:60] = np.minimum(ranges[chosen, 40:60], 1.0)
        found.append(replace(views, ranges=ranges).agreement(graph.poses))
    some, everywhere = found
    assert some.contradict <= before + 10
    assert not some.is_doubtful
    assert everywhere.agree < some.agree


def test_the_frame_of_the_map_does_not_matter_and_passes_apart_say_nothing(
    seen: tuple[Graph, Views],
) -> None:
    graph, views = seen
    moved = compose(np.array([20.0, -7.0, 1.0]), graph.poses)
    plain, other = (views.agreement(poses) for poses in (graph.poses, moved))
    assert other.agree == pytest.approx(plain.agree, rel=0.01)
    first = int(np.searchsorted(graph.nodes, SECOND_LAP))
    apart = views.agreement(moved_from(first, graph.poses, (500.0, 0.0, 0.0)))
    assert apart.agree < 0.1 * plain.agree


def test_partners_are_near_and_of_another_pass(seen: tuple[Graph, Views]) -> None:
    graph, views = seen
    lasers = compose(graph.poses[views.rows], views.mounts)
    older, newer = views.partners(lasers)
    assert len(older) > 20
    assert (views.way[newer] - views.way[older] > LOOP_PATH_M).all()
    assert (np.hypot(*(lasers[older] - lasers[newer])[:, :2].T) < 4.0).all()
    assert np.bincount(newer).max() <= 4


@pytest.mark.parametrize(
    ("now", "before", "worse"),
    [
        ((100, 60), (100, 0), True),
        ((100, 20), (100, 0), False),  # a door that closed
        ((10_000, 600), (100, 0), False),  # much more agrees
        ((10_000, 1200), (100, 0), True),
        ((100, 1000), (100, 1000), False),
        ((2389, 258), (4347, 312), True),  # less agrees, and a larger share contradicts
        ((2389, 30), (4347, 312), False),
        ((0, 0), (5000, 10), False),  # what is apart contradicts nothing
    ],
)
def test_what_is_worse(now: tuple[int, int], before: tuple[int, int], worse: bool) -> None:
    assert Agreement(*now).is_worse_than(Agreement(*before)) is worse


def test_nothing_is_said_of_no_keyframes_and_of_a_robot_that_came_nowhere_again(
    drive: Drive,
) -> None:
    with KeyframeStore() as none:
        assert audit(none, np.zeros((0, 3)), []) == Audit()
    truth, scans = drive
    with stored(drifted(truth)[:2], scans[:2]) as store:
        graph = graph_of(store, [], {})
        assert Views.of(store, graph).agreement(graph.poses) == Agreement(0, 0)

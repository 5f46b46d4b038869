"""Plans drawn at random, and scores of maps and divided plans: by hand and by scikit-learn."""

from itertools import groupby, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from sklearn.metrics import completeness_score, homogeneity_score
from sklearn.metrics.cluster import contingency_matrix

from benchmarks.making.buildings import BUILDINGS
from benchmarks.scores import (
    MapScores,
    homogeneity,
    map_scores,
    overlap_table,
    room_scores,
    visit_scores,
    visits_of,
)
from benchmarks.simulated.plans import joined_rooms, random_plan
from benchmarks.simulated.tours import robot
from specmap_cli.core.errors import InputError
from specmap_cli.simulation.worlds import RoomTruth
from tests.strategies import seeds


def scores(rooms: list[int], labels: list[int]) -> MapScores:
    """Keyframes in the given rooms, one cell of 1 m a room, with the given submaps."""
    truth = RoomTruth(np.arange(1, 7, dtype=np.int32)[None, :], 1.0)
    return map_scores(truth, np.array([[room - 0.5, 0.5] for room in rooms]), np.array(labels))


def test_a_submap_a_room_is_perfect_and_a_room_opened_again_on_the_second_lap_is_counted() -> None:
    found = scores([1, 1, 2, 2, 1, 1, 2, 2], [0, 0, 1, 1, 0, 0, 1, 1])
    assert (found.whole, found.recognised, found.purity) == (1.0, 1.0, 1.0)
    assert (found.doors, found.found, found.invented) == (1, 1, 0)
    found = scores([1, 1, 2, 2, 1, 1, 2, 2], [0, 0, 1, 1, 2, 2, 1, 1])
    assert found.reopened == (1,)
    assert found.recognised == 0.5
    assert found.pieces == {1: 2, 2: 1}
    assert scores([1, 1, 1, 1, 2, 2], [0, 0, 0, 0, 1, 1]).reopened == (), "first seen late"


tours = st.lists(st.tuples(st.integers(1, 6), st.integers(0, 4)), min_size=1, max_size=40)


@given(tours, st.permutations(range(5)))
def test_scores_are_those_counted_by_hand(tour: list[tuple[int, int]], numbers: list[int]) -> None:
    """The numbers of submaps do not matter."""
    rooms, labels = [room for room, _ in tour], [label for _, label in tour]
    found = scores(rooms, labels)
    assert scores(rooms, [numbers[label] for label in labels]) == found
    table = contingency_matrix(rooms, labels)
    assert found.purity == pytest.approx(table.max(axis=0).sum() / len(tour))
    assert dict(found.pieces) == {
        room: sum(
            tour.count((room, label)) >= 0.1 * rooms.count(room)
            for label in set(labels)
            if (room, label) in tour
        )
        for room in set(rooms)
    }
    pairs = {frozenset(pair) for pair in pairwise(rooms)} - {frozenset([room]) for room in rooms}
    assert found.doors == len(pairs)
    assert found.found <= found.doors
    assert set(found.reopened) <= set(rooms)
    assert 0.0 <= found.recognised <= 1.0


def test_a_glance_into_a_room_makes_no_piece_and_a_submap_that_leaps_invents_a_door() -> None:
    rooms = [1] * 30 + [2] * 30
    assert scores(rooms, [0] * 28 + [1] * 32).pieces == {1: 1, 2: 1}
    assert scores(rooms, [0] * 27 + [1] * 33).pieces == {1: 2, 2: 1}
    # room 2 lies between, but its keyframes went to the submaps of its neighbours
    found = scores([1, 1, 1, 2, 2, 3, 3, 3], [0, 0, 0, 0, 1, 1, 1, 1])
    assert (found.doors, found.found, found.invented) == (2, 0, 1)


@pytest.mark.parametrize("places", [np.zeros((0, 2)), np.full((3, 3), 50.0)])
def test_poses_of_another_frame_are_refused(places: np.ndarray[tuple[int, int]]) -> None:
    truth = RoomTruth(np.array([[1, 2]], dtype=np.int32), 1.0)
    with pytest.raises(InputError, match="no keyframe lies in a painted room: are the true poses"):
        map_scores(truth, places, np.zeros(len(places), dtype=np.int64))


@given(truth=st.lists(st.integers(0, 4), min_size=1, max_size=40), seed=st.integers(0, 1000))
def test_homogeneity_and_completeness_are_scikit_learn_s(truth: list[int], seed: int) -> None:
    rooms = np.array(truth)
    found = np.random.default_rng(seed).integers(0, 4, len(rooms))
    assert homogeneity(rooms, found) == pytest.approx(homogeneity_score(rooms, found), abs=1e-9)
    scores = visit_scores(rooms=rooms, visits=rooms, submaps=found, regions=found)
    assert scores.completeness == pytest.approx(completeness_score(rooms, found), abs=1e-9)


@given(seeds, st.integers(1, 4), st.integers(1, 6))
def test_room_scores_and_overlaps_are_those_of_loops_over_rooms_and_segments(
    seed: int, room_count: int, segment_count: int
) -> None:
    rng = np.random.default_rng(seed)  # -1 for none in some cells of each
    rooms, segments = (rng.integers(-1, most, (6, 7)) for most in (room_count, segment_count))
    cells = [{k: set(np.flatnonzero(grid == k)) for k in range(9)} for grid in (rooms, segments)]
    table = overlap_table(rooms, segments)
    for room, segment in np.ndindex(*table.shape):
        assert table[room, segment] == len(cells[0][room] & cells[1][segment])
    assert table.sum() == ((rooms >= 0) & (segments >= 0)).sum()
    painted = set(np.flatnonzero(rooms >= 0))
    here = {room: its for room, its in cells[0].items() if its}
    found = {k: its & painted for k, its in cells[1].items() if its & painted}
    scores = room_scores(rooms, segments)
    if not here or not found:
        assert (scores.recall, scores.precision, scores.iou) == (0.0, 0.0, 0.0)
        return
    recall = [max(len(room & its) for its in found.values()) / len(room) for room in here.values()]
    precision = [max(len(own & its) for own in here.values()) / len(its) for its in found.values()]
    iou = [max(len(own & its) / len(own | its) for its in found.values()) for own in here.values()]
    assert scores.recall == pytest.approx(np.mean(recall))
    assert scores.precision == pytest.approx(np.mean(precision))
    assert scores.iou == pytest.approx(np.mean(iou))
    assert scores.segments_per_room == pytest.approx(len(found) / len(here))


@given(st.lists(st.integers(0, 2), min_size=1, max_size=50), st.floats(0.05, 3.0))
def test_a_visit_begins_with_a_long_stay_in_another_room(rooms: list[int], least_m: float) -> None:
    """Against a walk from room to room, with keyframes 0.3 m apart."""
    steps = np.full(len(rooms), 0.3)
    way, here, expected = np.cumsum(steps), [rooms[0]], list[int]()  # `here` has a room a visit
    for room, group in groupby(rooms):
        first = len(expected)
        last = first + len(list(group)) - 1
        if room != here[-1] and way[last] - way[first] >= least_m:
            here.append(room)
        expected += [len(here) - 1] * (last + 1 - first)
    assert visits_of(np.array(rooms), steps, least_m).tolist() == expected


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_every_room_is_free_painted_and_within_reach(kind: str) -> None:
    for plan in (random_plan(kind, number, furnished=False) for number in range(12)):
        assert len(plan.rooms) > 2
        assert set(np.unique(plan.labels)) == {-1, *range(len(plan.rooms))}
        assert plan.free[plan.labels >= 0].all()
        assert ndimage.label(plan.free)[1] == 1


def test_rooms_that_share_a_region_are_counted_and_plans_and_robots_the_same_by_number() -> None:
    rooms = np.repeat(np.arange(4, dtype=np.int32), 5)[None]
    assert joined_rooms(rooms, rooms) == 0
    assert joined_rooms(rooms, np.repeat(np.array([0, 1, 1, 2], dtype=np.int32), 5)[None]) == 2
    one, again, other = (random_plan("flat", number, furnished=True) for number in (2, 2, 3))
    assert np.array_equal(one.free, again.free)
    assert one.free.shape != other.free.shape or not np.array_equal(one.free, other.free)
    robots, same, others = ([robot(k, n) for n in range(8)] for k in ("ring", "ring", "hall"))
    assert robots == same != others
    assert len({(o.field_of_view_deg, o.beams, o.range_max_m, o.noise_m) for o in robots}) > 5


def test_keyframes_outside_the_rooms_or_in_no_submap_are_left_out() -> None:
    truth = RoomTruth(np.array([[1, 2]], dtype=np.int32), 1.0)
    places = np.array([[0.5, 0.5], [9.0, 9.0], [1.5, 0.5], [1.5, 0.5], [-7.0, 0.5]])
    with_strays = map_scores(truth, places, np.array([0, 4, 1, -1, 5]))
    without = map_scores(truth, places[[0, 2]], np.array([0, 1]))
    assert with_strays == without
    assert without.purity == 1.0

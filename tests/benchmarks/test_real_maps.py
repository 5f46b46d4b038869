"""Maps laid on each other by their walls, and probabilities that keep their word or do not."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from benchmarks.localized import Localized, judged, nearest, scored
from benchmarks.real.laying import Seen, Walls, lay, passes, placed, search, spaced, thinned
from benchmarks.real.reliability import Told, line, reliability
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray
from specmap_cli.recognition.localization.localizer import Label

TRUE = Pose2(3.2, -1.4, 2.1)


def label(submap: int | None, filtered: int | None) -> Label:
    sure = {"margin": 1.0, "filtered_probability": 0.4, "probability": 0.8}
    return Label(stamp_ns=0, submap=submap, runner_up=None, filtered_submap=filtered, **sure)


def room() -> FloatArray:
    """Points on the walls of an L-shaped room with a pillar, 2 cm apart."""
    corners = [(0, 0), (6, 0), (6, 3), (2.5, 3), (2.5, 5), (0, 5), (0, 0)]
    sides = [*pairwise(corners), ((4, 1), (4.5, 1)), ((4, 1), (4, 1.6))]
    pieces = []
    for a, b in sides:
        count = int(math.dist(a, b) / 0.02)
        pieces.append(np.array(a) + np.linspace(0, 1, count)[:, None] * np.subtract(b, a))
    return np.concatenate(pieces)


def test_a_view_is_found_wherever_it_is_turned() -> None:
    rng = np.random.default_rng(4)
    walls = Walls(TRUE.apply(room()))
    view = thinned(room() + rng.normal(0.0, 0.01, (len(room()), 2)), 0.05)
    found = lay(view, walls, search(view, walls))
    off = TRUE.inverse() @ found.pose
    assert off.distance < 0.02
    assert abs(math.degrees(off.theta)) < 0.3
    assert found.share > 0.95


def test_a_search_finds_nothing_beyond_its_reach_and_a_view_of_another_room_does_not_fit() -> None:
    walls = Walls(room())
    near = search(room(), walls, Pose2(3.0, 0.0, 0.0), reach_m=1.0, turn_deg=10.0)
    assert abs(near.x - 3.0) <= 1.1
    here = search(room(), walls, Pose2(0.5, -0.5, 0.05), reach_m=1.0, turn_deg=10.0)
    assert math.hypot(here.x, here.y) < 0.2
    angles = np.linspace(0, 2 * np.pi, 400)
    circle = 2.2 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert lay(circle, walls, search(circle, walls)).share < 0.5
    assert lay(circle + 100.0, walls, Pose2(0, 0, 0)).share == 0.0


class Drive(Seen):
    """A drive along y = 1 past walls (N, 2), seen so far; the map has it `off_m` from there."""

    def __init__(self, x: FloatArray, walls: FloatArray, reach_m: float, off_m: Any = 0.0) -> None:
        self.poses = np.column_stack([x + off_m, np.ones(len(x)), np.zeros(len(x))])
        self.way_m = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
        seen = (walls - (at, 1.0) for at in x.tolist())
        self._hits = [near[np.hypot(*near.T) < reach_m] for near in seen]


def hallway(long_m: float) -> Seen:
    """A bare hallway between two rooms, driven along; the laser reaches 4 m."""
    far = room() * (-1.0, 1.0) * 0.8 + (long_m + 8.0, 0.0)  # no mirror image of the near one
    bare = np.arange(6.0, long_m + 3.2, 0.02)
    sides = [np.column_stack([bare, np.full(len(bare), y)]) for y in (0.0, 2.0)]
    return Drive(np.arange(3.0, long_m + 6.0, 0.25), np.concatenate([room(), far, *sides]), 4.0)


def test_a_map_is_laid_where_its_hallway_is_longer_and_nothing_is_said_within() -> None:
    there, here = hallway(18.0), hallway(16.4)
    truth = placed(there, here)
    x, found = here.poses[truth.rows, 0], truth.poses[:, 0]
    near, far, bare = x < 8.0, x > 19.5, (x > 12.0) & (x < 14.0)
    assert np.abs(found[near] - x[near]).max() < 0.1
    assert np.abs(found[far] - x[far] - 1.6).max() < 0.1
    assert np.isnan(found[bare]).all()


def test_labels_that_keep_their_word_have_no_error_others_one_weighted_by_labels_of_a_bin() -> None:
    probability = np.repeat([0.65, 0.95], [20, 20])
    right = np.concatenate([np.arange(20) < 13, np.arange(20) < 19])
    found = reliability(probability, right)
    assert found.error == pytest.approx(0.0, abs=1e-12)
    assert found.labels.tolist() == [0, 0, 0, 0, 0, 0, 20, 0, 0, 20]
    probability = np.array([1.0, 1.0, 1.0, 0.5])
    right = np.array([True, True, False, True])
    assert reliability(probability, right).error == pytest.approx((3 * (1 / 3) + 0.5) / 4)
    assert reliability(np.zeros(0), np.zeros(0, dtype=bool)).error == 0.0


def test_one_pass_along_a_facade_that_repeats_itself_is_no_second_pass() -> None:
    along = np.arange(-12.0, 72.0, 0.06)
    bays = np.where(along % 3.0 < 1.0, 3.5, 3.0)
    bays[along > 50.0] += 0.4 * (np.floor(along[along > 50.0]) % 4 == 0)
    facade, once = np.column_stack([along, bays]), np.arange(0.0, 60.0, 0.75)
    assert not list(passes(Drive(once, facade, 12.0)))
    there_and_back = np.concatenate([once, once[::-1]])
    off_m = np.where(np.arange(160) < 80, 0.0, 0.5)
    right = list(passes(Drive(there_and_back, facade, 12.0)))
    assert len(right) > 10
    assert not any(one.is_doubled for one in right)
    wrong = [one for one in passes(Drive(there_and_back, facade, 12.0, off_m)) if one.is_doubled]
    assert len(wrong) > 5
    assert np.median([one.off_m for one in wrong]) == pytest.approx(0.5, abs=0.05)


def test_poses_are_right_wrong_or_neither() -> None:
    said = np.zeros((5, 3))
    said[:, 0] = 0.09, 0.2, 0.0, 0.6, np.nan
    said[:, 2] = np.radians([0.9, 0.0, 371.0, 0.0, np.nan])
    right, wrong = judged(said, np.zeros((5, 3)))
    assert right.tolist() == [True, False, False, False, False]
    assert wrong.tolist() == [False, False, True, True, False]
    none = np.zeros(2, dtype=np.int64)
    untold = Localized(none, none, none, np.zeros((2, 3)))  # scans without a truth do not count
    assert scored(None, untold, np.full((2, 3), np.nan)).scans == 0  # type: ignore[arg-type]


def test_labels_without_a_truth_are_left_out() -> None:
    truth: IntArray = np.array([3, -1, 5, 5])
    told = Told.of([label(3, 3), label(1, 1), label(5, None), label(2, 5)], truth)
    assert told.single_right.tolist() == [True, True, False]
    assert told.filtered_right.tolist() == [True, False, True]
    assert "     3 |       0.667, 0.133 |         0.667, 0.267" in line("a recording", told)


def test_keyframes_are_looked_at_every_quarter_of_a_metre_or_radian() -> None:
    for axis in (0, 2):
        way = np.arange(0, 2, 0.1)[:, None] * np.eye(3)[axis]
        assert spaced(way).tolist() == [0, 3, 6, 9, 12, 15, 18]
    rows = nearest(np.array([0, 10, 20]), np.array([-5, 4, 6, 14, 16, 99]))  # of stamps
    assert rows.tolist() == [0, 0, 1, 1, 2, 2]

"""Readings that are no walls: codes for no return, the robot itself, scans repeated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.logs import open_log
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.planar import Ceiling, OwnBody, Repeats
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import sweeps_of

Tour = list[tuple[Sweep, Pose2]]
REACH_M, CODE_M, CLAIMED_M = 2.5, 2.8, 30.0


def room(number: int, noise: np.random.Generator) -> np.ndarray:
    """Readings (60,) from one of the places along a wall, none of them alike."""
    bearings = np.linspace(0.3, 2.8, 60)
    distances = (1.0 + 0.2 * number) / np.sin(bearings)
    return distances + noise.normal(0.0, 0.01, 60)


def cleared(scans: Sequence[np.ndarray]) -> list[int]:
    """How many readings of each scan become no return."""
    ceiling = Ceiling()
    counts = []
    for ranges in scans:
        ceiling.clear(ranges)
        counts.append(int(np.isinf(ranges).sum()))
    return counts


def test_the_longest_distance_of_all_read_from_four_places_is_no_return() -> None:
    noise = np.random.default_rng(0)
    scans = [np.minimum(room(number, noise), 2.0) for number in range(6)]
    alike = [int((ranges == 2.0).sum()) for ranges in scans]
    assert min(alike) >= 3
    assert cleared(scans) == [0, 0, 0, *alike[3:]]


def test_walls_that_share_their_longest_distance_by_chance_stay() -> None:
    """Nor does a robot that stands before one learn anything of it."""
    noise = np.random.default_rng(1)
    assert not any(cleared([np.round(room(number % 7, noise), 2) for number in range(200)]))
    assert not any(cleared([np.minimum(room(0, noise), 2.0) for _ in range(50)]))


def test_a_longer_distance_begins_the_count_anew_and_leaves_what_was_found() -> None:
    noise = np.random.default_rng(3)
    ceiling = Ceiling([2.0])
    longer = [np.minimum(room(number, noise), 2.2) for number in range(4)]
    for ranges in longer:
        ceiling.clear(ranges)
    assert ceiling.values_m == (2.0, 2.2)
    again = np.array([1.0, 2.0, 2.1, 2.2, 2.3])
    ceiling.clear(again)
    assert np.isinf(again).tolist() == [False, True, False, True, False]


def has_code(sweep: Sweep) -> bool:
    """Whether a scan has returns from where the laser does not reach."""
    ranges = sweep.planar.ranges
    return bool((np.isfinite(ranges) & (ranges > REACH_M)).any())


def write(path: Path, tour: Tour, scans: list[np.ndarray], range_max: float) -> None:
    """A log of other readings from the places of a tour."""
    with LogWriter(path) as log:
        for (sweep, _), ranges in zip(tour, scans, strict=True):
            first, second = map(float, sweep.planar.bearings[:2])
            step = second - first
            log.scan("/scan", "laser", sweep.stamp_ns, first, step, ranges, range_max=range_max)


@pytest.fixture(scope="module")
def coded_log(flat_tour: Tour, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flat seen by a laser of 2.5 m that says 2.8 m for no return and claims 30 m."""
    path = tmp_path_factory.mktemp("coded") / "log.mcap"
    seen = [sweep.planar.ranges for sweep, _ in flat_tour[:300]]
    coded = [np.where(ranges < REACH_M, ranges, CODE_M) for ranges in seen]
    write(path, flat_tour[:300], coded, CLAIMED_M)
    return path


def test_no_scan_of_a_log_has_a_return_there_and_a_warning_tells_the_distance(
    coded_log: Path,
) -> None:
    sweeps, stream = sweeps_of(coded_log)
    assert not any(has_code(sweep) for sweep in sweeps)
    assert any("readings of exactly 2.8 m" in warning for warning in stream.warnings)
    with open_log(coded_log) as log:
        assert any("2.8 m" in warning for warning in summarize(log).warnings)


def test_it_is_found_after_the_first_look_too(coded_log: Path) -> None:
    shown = [has_code(sweep) for sweep in sweeps_of(coded_log, look_scans=3)[0]]
    assert any(shown[:3])
    assert not any(shown[len(shown) // 2 :])


POST = slice(13, 19)  # beams that see a post of the robot
POST_M = 0.4


def scans(tour: Tour, seed: int, *, post: bool = True) -> list[np.ndarray]:
    """The readings of a tour, with the post before some beams."""
    noise = np.random.default_rng(seed)
    found = []
    for sweep, _ in tour:
        ranges = sweep.planar.ranges.copy()
        if post:
            ranges[POST] = POST_M + noise.normal(0.0, 0.01, POST.stop - POST.start)
        found.append(ranges)
    return found


def marked(given: list[np.ndarray]) -> np.ndarray:
    """(n, B) which readings are taken for the robot."""
    body = OwnBody()
    marks = []
    for ranges in given:
        before = np.isnan(ranges)
        body.clear(ranges)
        marks.append(np.isnan(ranges) & ~before)
    return np.array(marks)


def test_a_post_that_goes_along_is_left_out_once_the_robot_has_moved(flat_tour: Tour) -> None:
    marks = marked(scans(flat_tour, 0))
    late = marks[len(marks) // 2 :]
    assert late[:, POST].all()
    others = np.delete(late, np.arange(POST.start - 1, POST.stop + 1), axis=1)
    assert not others.any()
    assert not marks[0].any()
    assert not marked(scans(flat_tour, 1, post=False)).any(), "walls are not"


def test_nothing_is_learned_of_walls_near_a_robot_that_stands(flat_tour: Tour) -> None:
    noise = np.random.default_rng(2)
    first = np.minimum(flat_tour[0][0].planar.ranges, 3.0)
    first[POST] = POST_M
    assert not marked([first + noise.normal(0.0, 0.01, len(first)) for _ in range(200)]).any()


def test_lost_returns_and_beams_at_its_edge_that_flicker_change_nothing(flat_tour: Tour) -> None:
    noise = np.random.default_rng(3)
    given = scans(flat_tour, 3)
    edge = POST.stop
    for ranges in given:
        ranges[noise.random(len(ranges)) < 0.1] = np.inf
        if noise.random() < 0.5:
            ranges[edge] = POST_M
    expected = np.array(given)[:, POST] < 1.0
    flickers = np.array(given)[:, edge] == POST_M
    marks = marked(given)
    half = len(marks) // 2
    assert np.array_equal(marks[half:, POST], expected[half:])
    assert np.array_equal(marks[half:, edge], flickers[half:])


def test_a_beam_that_reads_farther_once_has_seen_a_wall(flat_tour: Tour) -> None:
    given = scans(flat_tour, 4)
    half = len(given) // 2
    for ranges in given[half:]:
        ranges[POST] = 1.5
    given += scans(flat_tour[:20], 5)
    marks = marked(given)
    assert marks[half - 1, POST].all()
    assert not marks[-20:].any()


def test_the_scans_of_a_log_are_without_it_and_a_warning_tells(flat_tour: Tour, path: Path) -> None:
    write(path, flat_tour, scans(flat_tour, 6), range_max=12.0)
    sweeps, stream = sweeps_of(path)
    (told,) = [warning for warning in stream.warnings if "the robot itself: 6" in warning]
    assert np.isnan(sweeps[-1].planar.ranges[POST]).all()
    assert float(told.split()[5]) == pytest.approx(POST_M, abs=0.05)


SEEN = np.array([1.0, np.nan, 2.0, np.inf, 3.0])


def sweep(ranges: np.ndarray, pose: Pose2 | None) -> Sweep:
    bearings = np.linspace(-1.0, 1.0, len(ranges))
    planar = PlanarScan(0, bearings, ranges, 8.0, False)
    return Sweep(index=0, stamp_ns=0, planar=planar, base_from_laser=IDENTITY, odom_from_base=pose)


AT, BLANK = IDENTITY, np.full(5, np.inf)
STEPS = [Pose2(0.008 * number, 0.0, 0.0) for number in range(5)]


@pytest.mark.parametrize(
    ("scans", "poses", "stale"),
    [
        ([SEEN, SEEN], [AT, Pose2(0.1, 0.0, 0.0)], [False, True]),
        ([SEEN, SEEN], [AT, Pose2(0.0, 0.0, 0.1)], [False, True]),
        ([SEEN, SEEN], [AT, Pose2(0.005, 0.0, 0.001)], [False, False]),  # it stands still
        ([SEEN, SEEN], [AT, None], [False, False]),
        ([SEEN, SEEN + 0.001], [AT, Pose2(0.1, 0.0, 0.0)], [False, False]),
        ([SEEN, SEEN[:-1]], [AT, Pose2(0.1, 0.0, 0.0)], [False, False]),
        ([BLANK, BLANK], [AT, Pose2(1.0, 0.0, 0.0)], [False, False]),
        ([SEEN] * 5, STEPS, [False] * 3 + [True] * 2),  # motion counts from the first of them
    ],
)
def test_only_a_scan_that_repeats_another_while_the_robot_moves_is_stale(
    scans: list[np.ndarray], poses: list[Pose2 | None], stale: list[bool]
) -> None:
    repeats = Repeats()
    found = [repeats.stale(sweep(each.copy(), at)) for each, at in zip(scans, poses, strict=True)]
    assert found == stale

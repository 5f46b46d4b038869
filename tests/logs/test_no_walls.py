"""Readings that are no walls: codes for no return, the robot itself, scans repeated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.planar import Ceiling, OwnBody, Repeats
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from tests.turning import configured

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


def test_a_robot_that_stands_before_a_wall_learns_nothing_of_it() -> None:
    noise = np.random.default_rng(1)
    scans = [np.minimum(room(0, noise), 2.0) for _ in range(50)]
    assert not any(cleared(scans))


def test_walls_that_share_their_longest_distance_by_chance_stay() -> None:
    noise = np.random.default_rng(2)
    scans = [np.round(room(number % 7, noise), 2) for number in range(200)]
    assert not any(cleared(scans))


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


@pytest.fixture(scope="module")
def coded_log(
    flat_tour: list[tuple[Sweep, Pose2]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The flat seen by a laser of 2.5 m that says 2.8 m for no return and claims 30 m."""
    path = tmp_path_factory.mktemp("coded") / "log.mcap"
    with LogWriter(path) as log:
        for sweep, _ in flat_tour[:300]:
            scan = sweep.planar
            step = float(scan.bearings[1] - scan.bearings[0])
            ranges = np.where(scan.ranges < REACH_M, scan.ranges, CODE_M)
            first = float(scan.bearings[0])
            log.scan("/scan", "laser", sweep.stamp_ns, first, step, ranges, range_max=CLAIMED_M)
    return path


def test_no_scan_of_a_log_has_a_return_there_and_a_warning_tells_the_distance(
    coded_log: Path,
) -> None:
    with open_log([coded_log]) as log:
        stream = SweepStream(log, LogConfig())
        assert not any(has_code(sweep) for sweep in stream)
        assert any("readings of exactly 2.8 m" in warning for warning in stream.warnings)


def test_it_is_found_after_the_first_look_too(coded_log: Path) -> None:
    with open_log([coded_log]) as log:
        stream = SweepStream(log, configured(LogConfig, "logs", {"look_scans": 3}))
        shown = [has_code(sweep) for sweep in stream]
    assert any(shown[:3])
    assert not any(shown[len(shown) // 2 :])


def test_info_tells_it(coded_log: Path) -> None:
    with open_log([coded_log]) as log:
        summary = summarize(log)
    assert any("2.8 m" in warning for warning in summary.warnings)


POST = slice(13, 19)  # beams that see a post of the robot
POST_M = 0.4


def scans(tour: list[tuple[Sweep, Pose2]], seed: int, *, post: bool = True) -> list[np.ndarray]:
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


def test_a_post_that_goes_along_is_left_out_once_the_robot_has_moved(
    flat_tour: list[tuple[Sweep, Pose2]],
) -> None:
    marks = marked(scans(flat_tour, 0))
    late = marks[len(marks) // 2 :]
    assert late[:, POST].all()
    others = np.delete(late, np.arange(POST.start - 1, POST.stop + 1), axis=1)
    assert not others.any()
    assert not marks[0].any()


def test_walls_are_not(flat_tour: list[tuple[Sweep, Pose2]]) -> None:
    assert not marked(scans(flat_tour, 1, post=False)).any()


def test_nothing_is_learned_of_walls_near_a_robot_that_stands(
    flat_tour: list[tuple[Sweep, Pose2]],
) -> None:
    noise = np.random.default_rng(2)
    first = np.minimum(flat_tour[0][0].planar.ranges, 3.0)
    first[POST] = POST_M
    assert not marked([first + noise.normal(0.0, 0.01, len(first)) for _ in range(200)]).any()


def test_lost_returns_and_beams_at_its_edge_that_flicker_change_nothing(
    flat_tour: list[tuple[Sweep, Pose2]],
) -> None:
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


def test_a_beam_that_reads_farther_once_has_seen_a_wall(
    flat_tour: list[tuple[Sweep, Pose2]],
) -> None:
    given = scans(flat_tour, 4)
    half = len(given) // 2
    for ranges in given[half:]:
        ranges[POST] = 1.5
    given += scans(flat_tour[:20], 5)
    marks = marked(given)
    assert marks[half - 1, POST].all()
    assert not marks[-20:].any()


def test_the_scans_of_a_log_are_without_it_and_a_warning_tells(
    flat_tour: list[tuple[Sweep, Pose2]], path: Path
) -> None:
    with LogWriter(path) as log:
        for (sweep, _), ranges in zip(flat_tour, scans(flat_tour, 6), strict=True):
            bearings = sweep.planar.bearings
            step = float(bearings[1] - bearings[0])
            log.scan(
                "/scan", "laser", sweep.stamp_ns, float(bearings[0]), step, ranges, range_max=12.0
            )
    with open_log([path]) as recording:
        stream = SweepStream(recording, LogConfig())
        sweeps = list(stream)
        told = [warning for warning in stream.warnings if "the robot itself: 6" in warning]
    assert np.isnan(sweeps[-1].planar.ranges[POST]).all()
    assert len(told) == 1
    assert float(told[0].split()[5]) == pytest.approx(POST_M, abs=0.05)


SEEN = np.array([1.0, np.nan, 2.0, np.inf, 3.0])


def sweep(ranges: np.ndarray, pose: Pose2 | None) -> Sweep:
    bearings = np.linspace(-1.0, 1.0, len(ranges))
    planar = PlanarScan(0, bearings, ranges, 8.0, False)
    return Sweep(index=0, stamp_ns=0, planar=planar, base_from_laser=IDENTITY, odom_from_base=pose)


@pytest.mark.parametrize(
    ("ranges", "pose", "stale"),
    [
        (SEEN, Pose2(0.1, 0.0, 0.0), True),
        (SEEN, Pose2(0.0, 0.0, 0.1), True),
        (SEEN, Pose2(0.005, 0.0, 0.001), False),  # it stands still
        (SEEN, None, False),
        (SEEN + 0.001, Pose2(0.1, 0.0, 0.0), False),
        (SEEN[:-1], Pose2(0.1, 0.0, 0.0), False),
    ],
)
def test_only_a_scan_that_repeats_another_while_the_robot_moves_is_stale(
    ranges: np.ndarray, pose: Pose2 | None, stale: bool
) -> None:
    repeats = Repeats()
    assert not repeats.stale(sweep(SEEN, IDENTITY))
    assert repeats.stale(sweep(ranges.copy(), pose)) is stale


def test_motion_counts_from_the_first_of_the_scans_alike() -> None:
    repeats = Repeats()
    poses = [Pose2(0.008 * number, 0.0, 0.0) for number in range(5)]
    assert [repeats.stale(sweep(SEEN, pose)) for pose in poses] == [False] * 3 + [True] * 2


def test_blank_scans_are_no_repeats() -> None:
    repeats, blank = Repeats(), np.full(5, np.inf)
    assert not repeats.stale(sweep(blank, IDENTITY))
    assert not repeats.stale(sweep(blank, Pose2(1.0, 0.0, 0.0)))

"""A distance below the maximum range that a driver gives where a beam met nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.planar import Ceiling
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
    assert any("2.8 m" in warning for warning in summary.outlook.warnings)

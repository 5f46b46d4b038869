"""Beams that see the robot itself, wherever it goes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.planar import OwnBody
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter

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


def cleared(given: list[np.ndarray]) -> np.ndarray:
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
    marks = cleared(scans(flat_tour, 0))
    late = marks[len(marks) // 2 :]
    assert late[:, POST].all()
    others = np.delete(late, np.arange(POST.start - 1, POST.stop + 1), axis=1)
    assert not others.any()
    assert not marks[0].any()


def test_walls_are_not(flat_tour: list[tuple[Sweep, Pose2]]) -> None:
    assert not cleared(scans(flat_tour, 1, post=False)).any()


def test_nothing_is_learned_of_walls_near_a_robot_that_stands(
    flat_tour: list[tuple[Sweep, Pose2]],
) -> None:
    noise = np.random.default_rng(2)
    first = np.minimum(flat_tour[0][0].planar.ranges, 3.0)
    first[POST] = POST_M
    assert not cleared([first + noise.normal(0.0, 0.01, len(first)) for _ in range(200)]).any()


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
    marks = cleared(given)
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
    marks = cleared(given)
    assert marks[half - 1, POST].all()
    assert not marks[-20:].any()


def test_the_scans_of_a_log_are_without_it_and_a_warning_tells(
    flat_tour: list[tuple[Sweep, Pose2]], tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
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

"""Clouds of a planar laser, as drivers and converters publish them: all points at one height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import sweeps_of

SWEEP_S = 0.08


def write(
    path: Path,
    tour: list[tuple[Sweep, Pose2]],
    *,
    mounted: bool = True,
    timed: bool = False,
    height_m: float = 0.0,
) -> Path:
    """The returns of a tour as clouds, in a laser frame on the floor or in that of the base."""
    with LogWriter(path) as log:
        if mounted:
            log.static_transform("base_link", "laser", (0.0, 0.0, 0.0))
        for sweep, _ in tour:
            scan = sweep.planar
            hit = np.isfinite(scan.ranges)
            r, b = scan.ranges[hit], scan.bearings[hit]
            points = np.column_stack([r * np.cos(b), r * np.sin(b), np.full(len(r), height_m)])
            times = np.linspace(0.0, SWEEP_S, len(hit))[hit] if timed else None
            log.cloud("/points", "laser" if mounted else "base_link", sweep.stamp_ns, points, times)
    return path


@pytest.mark.parametrize(("mounted", "height_m"), [(True, 0.0), (False, 0.1), (False, 2.0)])
def test_their_points_count_at_any_height_and_become_a_planar_scan(
    flat_tour: list[tuple[Sweep, Pose2]], tmp_path: Path, mounted: bool, height_m: float
) -> None:
    tour = flat_tour[:20]
    path = write(tmp_path / "log.mcap", tour, mounted=mounted, height_m=height_m)
    sweeps, stream = sweeps_of(path)
    assert len(sweeps) == len(tour)
    assert "height band" not in stream.selection.note
    for found, (true, _) in zip(sweeps, tour, strict=True):
        assert found.cloud is None
        assert len(found.planar.hits()) == pytest.approx(len(true.planar.hits()), rel=0.02)


def test_the_times_of_their_points_become_those_of_the_beams(
    flat_tour: list[tuple[Sweep, Pose2]], tmp_path: Path
) -> None:
    sweeps, _ = sweeps_of(write(tmp_path / "log.mcap", flat_tour[:5], timed=True))
    for found, (true, _) in zip(sweeps, flat_tour[:5], strict=True):
        times = found.planar.beam_times_s
        assert times is not None
        hit = np.isfinite(found.planar.ranges)
        hit[[0, -1]] = False  # straight behind, where the first beam is the last as well
        of_beams = np.linspace(0.0, SWEEP_S, len(true.planar.bearings))
        expected = np.interp(found.planar.bearings[hit], true.planar.bearings, of_beams)
        assert times[hit] == pytest.approx(expected, abs=2e-3)


def test_one_cloud_with_height_makes_it_a_lidar_in_space(
    flat_tour: list[tuple[Sweep, Pose2]], path: Path
) -> None:
    with LogWriter(path) as log:
        for number, (sweep, _) in enumerate(flat_tour[:5]):
            points = np.column_stack([sweep.planar.hits(), np.full(len(sweep.planar.hits()), 0.5)])
            points[0, 2] += 0.1 if number == 3 else 0.0
            log.cloud("/points", "base_link", sweep.stamp_ns, points)
    sweeps, stream = sweeps_of(path)
    assert "height band 0.15 to 1.5 m" in stream.selection.note
    assert all(sweep.cloud is not None for sweep in sweeps)

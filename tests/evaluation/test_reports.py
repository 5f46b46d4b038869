"""Evaluations from files: another log against a map, and truths that do not belong to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.core.config import Config, load_config
from specmap_cli.core.errors import LogError
from specmap_cli.core.progress import Silent
from specmap_cli.evaluation.reports import revisit_lines, revisit_logs
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.simulate import SimulationOptions, SimulationResult, simulate


@pytest.fixture(scope="module")
def config() -> Config:
    """Little training: it would take most of the time."""
    return load_config(
        overrides={"recognition": {"rounds": 30}, "localization": {"augmentation": 60}}
    )


@pytest.fixture(scope="module")
def flat_map(
    flat_log: SimulationResult, config: Config, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The map of `flat_log`."""
    out = tmp_path_factory.mktemp("revisit") / "map"
    build_map([flat_log.log], out, config)
    return out


@pytest.fixture(scope="module")
def again(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> SimulationResult:
    """Another tour of the flat."""
    options = flat_options.model_copy(update={"seed": 9, "laps": 1})
    return simulate(flat, options, tmp_path_factory.mktemp("again") / "again.mcap")


def test_another_tour_is_labelled_right(
    flat_map: Path, flat_log: SimulationResult, again: SimulationResult, config: Config
) -> None:
    progress = Silent()
    truths = (flat_log.truth, again.truth)
    found = revisit_logs(flat_map, again.log, truths, config, progress)
    assert found.filtered.accuracy > 0.8
    assert found.raw.scans > 0.9 * again.scans
    assert progress.warnings == []
    assert [line.split()[0] for line in revisit_lines(found)] == ["scans", "raw,", "filtered"]


def test_a_truth_of_another_tour_is_doubted(
    flat_map: Path, again: SimulationResult, config: Config
) -> None:
    progress = Silent()
    revisit_logs(flat_map, again.log, (again.truth, again.truth), config, progress)
    assert any("off the map on average" in warning for warning in progress.warnings)


def test_a_truth_without_common_stamps_is_refused(
    flat_map: Path, again: SimulationResult, config: Config, tmp_path: Path
) -> None:
    late = tmp_path / "late.tum"
    late.write_text("9000000000 0 0 0 0 0 0 1\n")
    with pytest.raises(LogError, match="another log"):
        revisit_logs(flat_map, again.log, (late, again.truth), config, Silent())

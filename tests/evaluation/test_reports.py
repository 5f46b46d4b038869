"""Evaluations from files: another log against a map, and truths that do not belong to it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.errors import LogError
from specmap_cli.core.progress import Silent
from specmap_cli.core.settings import Config
from specmap_cli.evaluation import protocols, trajectories
from specmap_cli.evaluation.protocols import revisit_logs
from specmap_cli.evaluation.semantic import SemanticResult, semantic_lines
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import StoredMap
from specmap_cli.pipelines.simulate import SimulationResult, simulate
from specmap_cli.simulation.simulator import SimulationOptions
from tests.flats import TRAINED


@pytest.fixture(scope="module")
def again(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> SimulationResult:
    """A part of another tour of the flat."""
    options = flat_options.model_copy(update={"seed": 9, "max_duration_s": 45.0})
    return simulate(flat, options, tmp_path_factory.mktemp("again") / "again.mcap")


def test_another_tour_is_labelled_right_and_a_truth_that_is_not_its_own_doubted(
    flat_map: StoredMap, flat_log: SimulationResult, again: SimulationResult
) -> None:
    progress = Silent()
    truths = (flat_log.truth, again.truth)
    found = revisit_logs(flat_map.path, again.log, truths, TRAINED, progress)
    assert found.filtered.accuracy > 0.8
    assert found.raw.scans > 0.9 * again.scans
    assert progress.warnings == []
    lines = protocols.revisit_lines(found)
    assert [line.split()[0] for line in lines] == ["scans", "raw,", "filtered"]
    revisit_logs(flat_map.path, again.log, (again.truth, again.truth), TRAINED, progress)
    assert any("off the map on average" in warning for warning in progress.warnings)


def counted_scores(*pairs: tuple[int, int, int]) -> protocols.ClassificationScores:
    """So many scans each of a true and a predicted class; classes 0 and 1, -1 unknown."""
    truth, said, counts = zip(*pairs, strict=True)
    rooms, guesses = np.repeat(truth, counts), np.repeat(said, counts)
    return protocols.classification_scores(rooms, guesses, [0, 1])


def test_the_table_of_a_hold_out() -> None:
    result = protocols.HoldOutResult(
        train=counted_scores((0, 0, 3000), (1, 1, 1000)),
        test=counted_scores((0, 0, 700), (0, 1, 300), (1, 1, 500)),
        filtered=counted_scores((0, 0, 1000), (1, 1, 500)),
    )
    assert protocols.hold_out_lines(result) == [
        "                         scans  recall  precision",
        "training scans           4,000  1.0000     1.0000",
        "held-out scans           1,500  0.8500     0.8125",
        "held-out, filtered       1,500  1.0000     1.0000",
        "",
        "held-out scans by submap",
        *protocols.score_lines(result.test),
    ]


def test_the_table_of_a_revisit() -> None:
    result = protocols.RevisitResult(
        raw=counted_scores((0, 0, 50), (0, -1, 30), (1, 0, 20)),
        filtered=counted_scores((0, 0, 80), (1, 1, 20)),
        truth=np.zeros(0, dtype=np.int64),
    )
    assert protocols.revisit_lines(result) == [
        "                         scans  recall  precision  accuracy",
        "raw, single scans          100  0.3125     0.3571    0.5000",
        "filtered                   100  1.0000     1.0000    1.0000",
    ]


@pytest.mark.parametrize(
    ("scores", "rooms", "hallways", "accuracy"),
    [
        (counted_scores((0, 0, 9), (0, 1, 1), (1, 1, 10)), "0.900", "1.000", "0.950"),
        (counted_scores((0, 0, 4)), "1.000", "0.000", "1.000"),
    ],
)
def test_the_lines_of_the_baseline(
    scores: protocols.ClassificationScores, rooms: str, hallways: str, accuracy: str
) -> None:
    first, second = semantic_lines(SemanticResult(scores=scores, borders_seen=0.375, borders=8))
    assert first == (
        f"{scores.scans} scans: rooms recognised {rooms}, hallways {hallways}, all {accuracy}"
    )
    assert second == (
        "8 borders between submaps, 38 % between a room and a hallway: no other can be seen"
    )


SPREAD = trajectories.Spread(mean=0.1, std=0.02, median=0.09, p95=0.2, max=1.25)
ERRORS = trajectories.RelativeErrors(
    translation_m=SPREAD, rotation_deg=SPREAD, matched=1200, total=2000
)
SPREAD_TEXT = "mean 0.1000  std 0.0200  median 0.0900  p95 0.2000  max 1.2500"


@pytest.mark.parametrize("lengths", [(), (1.0,), (1.0, 20.0)])
def test_the_lines_of_relations_and_of_a_reference(lengths: tuple[float, ...]) -> None:
    errors = trajectories.ReferenceErrors(
        relative=dict.fromkeys(lengths, ERRORS),
        ate_m=0.03435,
        end_m=2.5,
        end_deg=0.1234,
        matched=12,
        total=4000,
    )
    assert trajectories.relation_lines(ERRORS) == [
        "1,200 of 2,000 relations matched",
        f"  translation m  {SPREAD_TEXT}",
        f"  rotation deg   {SPREAD_TEXT}",
    ]
    lines = trajectories.reference_lines(errors)
    assert lines[0] == "12 of 4,000 poses matched"
    assert lines[1:-2:3] == [f"relative errors over {length:g} m of path" for length in lengths]
    assert lines[-2:] == [
        "absolute error (rmse, aligned)  0.0343 m",
        "from first to last pose         2.5000 m, 0.123 deg",
    ]


def test_a_map_of_the_first_log_is_built_for_the_purpose_and_removed(
    flat_map: StoredMap,
    again: SimulationResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A log in place of a map, the paths as text; here the map is copied, not built."""
    built: list[tuple[list[Path], Path]] = []

    def build(logs: list[Path], out: Path, *_: Config, **__: Silent) -> None:
        built.append((logs, out))
        shutil.copytree(flat_map.path, out)

    monkeypatch.setattr(protocols, "build_map", build)
    (tmp_path / "late.tum").write_text("9000000000 0 0 0 0 0 0 1\n")
    truths = (str(tmp_path / "late.tum"), str(again.truth))
    said = r"late\.tum: no pose at the stamps of the map's keyframes: another log\?"
    with pytest.raises(LogError, match=said):
        revisit_logs("first.mcap", str(again.log), truths, TRAINED, Silent())
    ((logs, out),) = built
    assert logs == [Path("first.mcap")]
    assert not out.parent.exists()

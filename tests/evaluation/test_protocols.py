"""Table II's scores against scikit-learn, hold-outs and revisits, the baseline of Figure 5c."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score, confusion_matrix, precision_recall_fscore_support

from specmap_cli.core.errors import InputError, LogError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.evaluation import protocols, semantic, trajectories
from specmap_cli.evaluation.protocols import HoldOut, classification_scores, revisit_logs
from specmap_cli.evaluation.semantic import HALLWAY, ROOM, Labelled, SemanticResult, room_hallway
from specmap_cli.maps.store import Map
from specmap_cli.pipelines.simulate import SimulationResult
from specmap_cli.recognition.localization.localizer import Label
from specmap_cli.simulation.worlds import RoomTruth
from tests.flats import QUICK, TRAINED, Mapped

guesses = st.lists(st.tuples(st.integers(0, 4), st.integers(-1, 6)), min_size=1, max_size=60)


@given(guesses, st.integers(0, 1000))
def test_scores_equal_scikit_learn_s(pairs: list[tuple[int, int]], seed: int) -> None:
    """Of all and of every class; what is none of them, or None, is called unknown."""
    names = np.append(np.sort(np.random.default_rng(seed).permutation(100)[:7]), -1)
    names, ids = names + 10, (names[:5] + 10).tolist()
    truth, said = (names[np.array(column)] for column in zip(*pairs, strict=True))
    guesses = [None if name == names[-1] else int(name) for name in said]
    ours = classification_scores(truth, guesses, ids[::-1])
    assert ours.ids == tuple(ids)
    precision, recall, _, support = precision_recall_fscore_support(
        truth, said, labels=ids, zero_division=0
    )
    visited = [name for name, scans in zip(ids, support, strict=True) if scans]
    of = {name: k for k, name in enumerate(ids)}
    assert ours.recall_of == {name: pytest.approx(recall[of[name]]) for name in visited}
    assert ours.precision_of == {name: pytest.approx(precision[of[name]]) for name in visited}
    precision, recall, _, _ = precision_recall_fscore_support(
        truth, said, labels=visited, average="macro", zero_division=0
    )
    assert (ours.recall, ours.precision) == pytest.approx((recall, precision))
    assert ours.accuracy == pytest.approx(accuracy_score(truth, said))
    assert ours.scans == len(pairs)
    unknown = np.where(np.isin(said, ids), said, -1)
    theirs = confusion_matrix(truth, unknown, labels=[*ids, -1])
    np.testing.assert_array_equal(ours.confusion, theirs[:5])


def test_a_fifth_is_held_out_one_by_one_or_blocks_whole_by_number_and_seed_alone() -> None:
    def chosen_of(options: HoldOut, count: int) -> np.ndarray[Any, Any]:
        return np.array([options.holds(k) for k in range(count)])

    for seed in range(3):
        chosen = chosen_of(HoldOut(seed=seed), 3000)
        assert 0.17 < chosen.mean() < 0.23
        assert not chosen[0]
    blocks = chosen_of(HoldOut("blocks", share=0.5, block=10), 1000).reshape(-1, 10)
    assert (blocks.all(axis=1) | ~blocks.any(axis=1)).all()
    assert 0.3 < blocks.mean() < 0.7
    assert not blocks[0].any()
    backwards = [HoldOut(seed=4).holds(k) for k in reversed(range(200))]
    assert backwards[::-1] == chosen_of(HoldOut(seed=4), 200).tolist()
    assert backwards[::-1] != chosen_of(HoldOut(seed=5), 200).tolist()


def test_a_revisit_is_scored_by_given_poses_in_any_frame() -> None:
    keyframes = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]), np.array([0, 1])
    map_from_reference = Pose2(1.0, 2.0, 0.5)
    inside = np.array([[0.1, 0.0], [10.1, 0.0], [9.8, 0.0], [5.0, 0.0]])
    given_places = map_from_reference.inverse().apply(inside)
    stamps = np.arange(4, dtype=np.int64) * 10**9
    reference = Trajectory(stamps, np.column_stack([given_places, np.zeros(4)]))
    sure = {"margin": 1.0, "probability": 1.0, "filtered_probability": 1.0}
    labels = [
        Label(stamp_ns=stamp, submap=k % 2, runner_up=None, filtered_submap=k % 2, **sure)
        for k, stamp in enumerate(stamps.tolist())
    ]
    result = protocols.revisit(labels, reference, keyframes, map_from_reference)
    assert result.truth.tolist() == [0, 1, 1, -1]
    assert result.raw.accuracy == pytest.approx(2 / 3)
    assert result.as_dict()["filtered"]["scans"] == 3
    with pytest.raises(LogError, match="50 ms"):  # no stamp in common
        protocols.revisit(labels, Trajectory(stamps + 10**15, reference.poses), keyframes)


def test_a_whole_hold_out_run(first_tour: Mapped) -> None:
    result = protocols.hold_out([first_tour.log.log], TRAINED, HoldOut(seed=1))
    data = json.loads(json.dumps(result.as_dict()))
    assert {"train", "test", "submaps"} <= set(data)
    assert {"recall", "precision", "scans"} <= set(data["test"])
    assert 0.1 < data["test"]["scans"] / (data["test"]["scans"] + data["train"]["scans"]) < 0.3
    assert data["train"]["recall"] > 0.9
    assert data["test"]["recall"] > 0.7
    assert [row["id"] for row in data["submaps"]] == sorted(row["id"] for row in data["submaps"])


@pytest.mark.parametrize("ids", [[], [0, 1]])
def test_nothing_scored_scores_nought_and_figures_have_six_decimals(ids: list[int]) -> None:
    found = classification_scores([], [], ids)
    assert found.confusion.shape == (len(ids), len(ids) + 1)
    assert found.as_dict() == {"recall": 0.0, "precision": 0.0, "accuracy": 0.0, "scans": 0}
    assert len(protocols.score_lines(found)) == 2
    figures = json.loads(json.dumps(classification_scores([0, 0, 0], [0, 1, 1], [0, 1]).as_dict()))
    assert figures == {"recall": 0.333333, "precision": 1.0, "accuracy": 0.333333, "scans": 3}


def test_another_tour_is_labelled_right_and_a_truth_that_is_not_its_own_doubted(
    flat_map: Map, flat_log: SimulationResult, second_tour: Mapped
) -> None:
    again, progress = second_tour.log, Silent()
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


def test_the_tables_of_a_hold_out_and_of_a_revisit() -> None:
    found = protocols.HoldOutResult(
        train=counted_scores((0, 0, 3000), (1, 1, 1000)),
        test=counted_scores((0, 0, 700), (0, 1, 300), (1, 1, 500)),
        filtered=counted_scores((0, 0, 1000), (1, 1, 500)),
    )
    assert protocols.hold_out_lines(found) == [
        "                         scans  recall  precision",
        "training scans           4,000  1.0000     1.0000",
        "held-out scans           1,500  0.8500     0.8125",
        "held-out, filtered       1,500  1.0000     1.0000",
        "",
        "held-out scans by submap",
        "  submap   scans  recall  precision",
        "       0   1,000   0.700      1.000",
        "       1     500   1.000      0.625",
        "    mean   1,500   0.850      0.812",
    ]
    raw = counted_scores((0, 0, 50), (0, -1, 30), (1, 0, 20))
    filtered = counted_scores((0, 0, 80), (1, 1, 20))
    revisited = protocols.RevisitResult(raw, filtered, np.zeros(0, dtype=np.int64))
    assert protocols.revisit_lines(revisited) == [
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
    found = SemanticResult(scores=scores, borders_seen=0.375, borders=8)
    first, second = semantic.semantic_lines(found)
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
    flat_map: Map, second_tour: Mapped, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log in place of a map, the paths as text; here the map is copied, not built."""
    built: list[tuple[list[Path], Path]] = []

    def build(logs: list[Path], out: Path, *_: Config, **__: Silent) -> None:
        built.append((logs, out))
        shutil.copytree(flat_map.path, out)

    monkeypatch.setattr(protocols, "build_map", build)
    (tmp_path / "late.tum").write_text("9000000000 0 0 0 0 0 0 1\n")
    truths = (str(tmp_path / "late.tum"), str(second_tour.log.truth))
    said = r"late\.tum: no pose at the stamps of the map's keyframes: another log\?"
    with pytest.raises(LogError, match=said):
        revisit_logs("first.mcap", str(second_tour.log.log), truths, TRAINED, Silent())
    ((logs, out),) = built
    assert logs == [Path("first.mcap")]
    assert not out.parent.exists()


def test_a_border_between_two_rooms_is_not_seen() -> None:
    submaps = np.array([0, 0, 1, 1, 2, 2])
    predicted = np.array([HALLWAY, HALLWAY, ROOM, ROOM, ROOM, ROOM])
    truth = np.array([HALLWAY, -1, ROOM, ROOM, ROOM, HALLWAY])
    result = semantic.semantic_scores(predicted, truth, submaps, [(0, 1), (1, 2), (2, 7)])
    assert result.borders_seen == pytest.approx(0.5)
    assert result.borders == 2
    assert result.scores.scans == 5
    assert result.as_dict()["room_hallway"]["accuracy"] == pytest.approx(0.8)


def test_rooms_and_hallways_from_file_to_figures(
    first_tour: Mapped, second_tour: Mapped, flat_rooms: RoomTruth
) -> None:
    assert semantic.hallways(flat_rooms) == {4}
    logs = first_tour.log, second_tour.log
    learned, asked = (Labelled(log.log, log.truth, flat_rooms) for log in logs)
    found = room_hallway(learned, asked, QUICK, Silent())
    assert found.scores.accuracy > 0.9
    assert found.borders >= 3
    assert any("hallways" in line for line in semantic.semantic_lines(found))


def test_a_building_without_both_kinds_is_refused(
    first_tour: Mapped, flat_rooms: RoomTruth
) -> None:
    rooms = RoomTruth(np.where(flat_rooms.labels == 4, 0, flat_rooms.labels), 0.05)
    labelled = Labelled(first_tour.log.log, first_tour.log.truth, rooms)
    with pytest.raises(InputError, match="not of both rooms and hallways"):
        room_hallway(labelled, labelled, QUICK, Silent())

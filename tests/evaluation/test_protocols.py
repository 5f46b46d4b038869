"""Table II's scores against scikit-learn; which scans are held out; a whole hold-out run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score, confusion_matrix, precision_recall_fscore_support

from specmap_cli.core.errors import LogError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation import protocols
from specmap_cli.evaluation.protocols import HoldOut, classification_scores
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.localization.localizer import Label
from tests.flats import TRAINED, record_tour

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


def test_a_whole_hold_out_run(flat: GridMap, tmp_path: Path) -> None:
    options = {"field_of_view_deg": 360, "beams": 120, "rate_hz": 3, "seed": 3}
    log = record_tour(flat, tmp_path / "flat.mcap", **options, max_duration_s=70)
    result = protocols.hold_out([log], TRAINED, HoldOut(seed=1))
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


def test_the_table_is_aligned() -> None:
    truth = np.repeat([3, 12], [1200, 2])
    assert protocols.score_lines(classification_scores(truth, [3] * 1201 + [12], [3, 12])) == [
        "  submap   scans  recall  precision",
        "       3   1,200   1.000      0.999",
        "      12       2   0.500      1.000",
        "    mean   1,202   0.750      1.000",
    ]

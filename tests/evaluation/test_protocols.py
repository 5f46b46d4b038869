"""Table II's scores against scikit-learn, hold-outs, revisits, Figure 5c; known trajectories."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sklearn.metrics import accuracy_score, confusion_matrix, precision_recall_fscore_support

from specmap_cli.core.errors import InputError, LogError
from specmap_cli.core.geometry import Pose2, compose, nearest_motion
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.evaluation import protocols, semantic, trajectories
from specmap_cli.evaluation.protocols import HoldOut, classification_scores, revisit_logs
from specmap_cli.evaluation.semantic import HALLWAY, ROOM, Labelled, SemanticResult, room_hallway
from specmap_cli.evaluation.trajectories import Relations, read_relations
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.simulate import SimulationResult
from specmap_cli.recognition.localization.localizer import Label
from specmap_cli.simulation.worlds import RoomTruth
from tests.flats import QUICK, TRAINED, Mapped
from tests.strategies import poses, seeds

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
    scores = precision_recall_fscore_support(truth, said, labels=ids, zero_division=0)
    precision, recall, _, support = scores
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
    theirs = confusion_matrix(truth, np.where(np.isin(said, ids), said, -1), labels=[*ids, -1])
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
    places = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    keyframes = Labels(stamps_ns=np.arange(2), poses=places, submaps=np.array([0, 1]))
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
    assert len(protocols.hold_out_lines(protocols.HoldOutResult(found, found, found))) == 8
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
    assert semantic.semantic_lines(found) == [
        f"{scores.scans} scans: rooms recognised {rooms}, hallways {hallways}, all {accuracy}",
        "8 borders between submaps, 38 % between a room and a hallway: no other can be seen",
    ]


def test_the_lines_of_relations_and_of_a_reference() -> None:
    spread = trajectories.Spread(mean=0.1, std=0.02, median=0.09, p95=0.2, max=1.25)
    both = {"translation_m": spread, "rotation_deg": spread}
    relative = trajectories.RelativeErrors(**both, matched=1200, total=2000)
    text = "mean 0.1000  std 0.0200  median 0.0900  p95 0.2000  max 1.2500"
    spreads = [f"  translation m  {text}", f"  rotation deg   {text}"]
    assert trajectories.relation_lines(relative) == ["1,200 of 2,000 relations matched", *spreads]
    by_length = {1.0: relative, 20.0: relative}
    absolute = {"ate_m": 0.03435, "end_m": 2.5, "end_deg": 0.1234}
    whole = [
        "absolute error (rmse, aligned)  0.0343 m",
        "from first to last pose         2.5000 m, 0.123 deg",
    ]
    errors = trajectories.ReferenceErrors(relative=by_length, **absolute, matched=12, total=4000)
    assert trajectories.reference_lines(errors) == [
        "the truth knows 12 of 4,000 poses",
        "relative errors over 1 m of path",
        *spreads,
        "relative errors over 20 m of path",
        *spreads,
        *whole,
    ]
    errors = trajectories.ReferenceErrors(relative={}, **absolute, matched=12, total=4000)
    assert trajectories.reference_lines(errors) == ["the truth knows 12 of 4,000 poses", *whole]


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


def test_a_building_of_one_kind_is_refused(first_tour: Mapped, flat_rooms: RoomTruth) -> None:
    rooms = RoomTruth(np.where(flat_rooms.labels == 4, 0, flat_rooms.labels), 0.05)
    labelled = Labelled(first_tour.log.log, first_tour.log.truth, rooms)
    with pytest.raises(InputError, match="not of both rooms and hallways"):
        room_hallway(labelled, labelled, QUICK, Silent())


def walk(count: int = 400) -> Trajectory:
    """A path of 40 m that winds."""
    steps = np.tile([0.1, 0.0, 0.0], (count, 1))
    steps[:, 2] = 0.05 * np.sin(np.arange(count) / 10)
    path = [np.zeros(3)]
    for step in steps[1:]:
        path.append(compose(path[-1], step))
    return Trajectory(np.arange(count, dtype=np.int64) * 10**8, np.array(path))


STAMPS = {
    **{"5": 5_000_000_000, "5.": 5_000_000_000, ".5": 500_000_000, "-2.25": -2_250_000_000},
    **{"1700000000.123456789": 1_700_000_000_123_456_789, "0.1234567891": 123_456_789},
    **{"1.5e3": 1_500_000_000_000, "+3": 3_000_000_000},
}


def test_comments_commas_stamps_in_any_notation_and_tilted_bodies_are_read(tmp_path: Path) -> None:
    file = tmp_path / "a.tum"
    tilted = 3.0 * Rotation.from_euler("ZYX", [0.8, 0.2, -0.1]).as_quat()  # of any length
    lines = [f"{stamp},3,4,5,{','.join(map(str, tilted))}  # too" for stamp in STAMPS]
    file.write_text("\n".join(["# timestamp x y z qx qy qz qw", "", "9 1 2 0 0 0 0 1", *lines]))
    found = read_tum(file)
    assert found.stamps_ns.tolist() == [9 * 10**9, *STAMPS.values()]
    assert np.allclose(found.poses, [[1.0, 2.0, 0.0], *[[3.0, 4.0, 0.8]] * len(STAMPS)])
    file.write_text("1216.630413 1217.5 0.4 -0.01 0 0 0 -0.07\n")
    relations = read_relations(file)
    assert relations.earlier_ns.tolist() == [1216630413000]
    assert relations.later_ns.tolist() == [1217500000000]
    assert np.allclose(relations.poses, [[0.4, -0.01, -0.07]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"\xff\xfe\x00\x80", "not UTF-8 text"),
        (b"", "holds no"),
        (b"# nothing\n", "holds no"),
        (b"1 2 3\n", ":1: 3 columns"),
        (b"\n1 2 0 0 0 0 x 1\n", ":2: .* not all numbers"),
        (b"1 2 nan 0 0 0 0 1\n", "not all finite"),
        (b"x 2 0 0 0 0 0 1\n", "not all numbers"),
        (b"1e300 2 0 0 0 0 0 1\n", "no time in seconds"),
        (b"99999999999999999999 2 0 0 0 0 0 1\n", "no time in seconds"),
        (b"1e10 2 0 0 0 0 0 1\n", ":1: '1e10' is no time in seconds; mend or remove the line"),
        (b"-1e10 2 0 0 0 0 0 1\n", "no time in seconds"),
        (b"9200000000 2 0 0 0 0 0 1\n", "no time in seconds"),
    ],
)
def test_malformed_files_are_one_clear_line(tmp_path: Path, text: bytes, says: str) -> None:
    file = tmp_path / "bad.txt"
    file.write_bytes(text)
    for read in (read_tum, read_relations):
        with pytest.raises(InputError, match=says) as caught:
            read(file)
        assert "\n" not in str(caught.value)
        with pytest.raises(InputError, match=r"none\.tum: cannot be read: No such file"):
            read(tmp_path / "none.tum")


@given(st.lists(st.integers(0, 300), max_size=30), st.lists(st.integers(0, 300), max_size=30))
def test_association_is_the_nearest_within_tolerance(have: list[int], want: list[int]) -> None:
    stamps, wanted = np.array(have, dtype=np.int64), np.array(want, dtype=np.int64)
    rows, found = trajectories.associate(stamps, wanted, 5)
    expected = [k for k, w in enumerate(want) if any(abs(s - w) <= 5 for s in have)]
    assert rows.tolist() == expected
    for row, k in zip(rows.tolist(), found.tolist(), strict=True):
        assert abs(have[k] - want[row]) == min(abs(s - want[row]) for s in have)
        assert k == have.index(have[k])


def test_a_scale_error_grows_with_the_length_of_path_as_far_as_it_reaches() -> None:
    truth = walk()
    straight = Trajectory(truth.stamps_ns, truth.poses * (1, 0, 0))
    longer = Trajectory(truth.stamps_ns, straight.poses * (1.02, 1, 1))
    found = trajectories.reference_errors(longer, straight)
    for length, errors in found.relative.items():
        assert errors.translation_m.mean == pytest.approx(0.02 * length, rel=0.1)
        assert errors.rotation_deg.max == 0.0
    assert found.end_m == pytest.approx(0.02 * float(straight.poses[-1, 0] - straight.poses[0, 0]))
    assert found.as_dict()["relative"]["5"]["matched"] == found.relative[5.0].matched
    for count, lengths in ((5, []), (30, [1.0]), (120, [1.0, 5.0]), (400, [1.0, 5.0, 20.0])):
        short = walk(count)
        assert list(trajectories.reference_errors(short, short).relative) == lengths


@given(seeds)
def test_relation_errors_are_those_of_homogeneous_matrices(seed: int) -> None:
    """Each relation by itself: inverse(wanted) times measured, as in Burgard et al."""
    driven, rng = walk(30), np.random.default_rng(seed)
    i, j = rng.integers(0, 30, (2, 9))
    wanted = rng.normal(0, 1, (10, 3))
    # the last has no pose
    earlier, later = (np.append(driven.stamps_ns[k], 10**15) for k in (i, j))
    found = trajectories.relation_errors(driven, Relations(earlier, later, wanted))
    assert (found.matched, found.total) == (9, 10)
    lengths, angles = [], []
    for first, second, pose in zip(i, j, wanted[:9], strict=True):
        a, b = (Pose2(*driven.poses[k].tolist()).matrix() for k in (first, second))
        error = np.linalg.inv(Pose2(*pose.tolist()).matrix()) @ np.linalg.inv(a) @ b
        lengths.append(np.linalg.norm(error[:2, 3]))
        angles.append(abs(np.degrees(np.arctan2(error[1, 0], error[0, 0]))))
    for spread, values in ((found.translation_m, lengths), (found.rotation_deg, angles)):
        assert spread.mean == pytest.approx(np.mean(values))
        assert spread.std == pytest.approx(np.std(values))
        assert spread.median == pytest.approx(np.median(values))
        assert spread.p95 == pytest.approx(np.percentile(values, 95))
        assert spread.max == pytest.approx(np.max(values))


def test_the_absolute_error_is_after_the_best_motion_and_the_end_error_before_any() -> None:
    """A truth of another rate is interpolated where it is dense."""
    truth = walk(100)
    bent = Trajectory(truth.stamps_ns, truth.poses + (0.0, 0.0, np.radians(3.0)))
    found = trajectories.reference_errors(bent, truth)
    assert found.ate_m == pytest.approx(0.0, abs=1e-9)
    assert found.end_deg == pytest.approx(0.0, abs=1e-9)
    way = truth.poses[-1, :2] - truth.poses[0, :2]
    assert found.end_m == pytest.approx(2 * np.sin(np.radians(1.5)) * np.hypot(*way))
    rare, rarer = (Trajectory(truth.stamps_ns[::k] + 10**7, truth.poses[::k]) for k in (2, 3))
    found = trajectories.reference_errors(truth, rare)
    assert (found.matched, found.total, found.ate_m < 0.02) == (98, 100, True)
    with pytest.raises(InputError, match="no stamps in common"):
        trajectories.reference_errors(truth, rarer)


@pytest.mark.parametrize(("common", "words"), [(0, "no stamps"), (1, "one stamp")])
def test_one_common_pose_is_too_few(common: int, words: str) -> None:
    truth = walk(20)
    stamps = truth.stamps_ns + 10**15
    stamps[:common] = truth.stamps_ns[:common]
    foreign = Trajectory(stamps, truth.poses)
    with pytest.raises(InputError, match=rf"have {words} in common \(20 in the truth\)"):
        trajectories.reference_errors(foreign, truth)
    relations = Relations(truth.stamps_ns[1:], truth.stamps_ns[1:], truth.poses[1:])
    with pytest.raises(InputError, match="no stamps in common"):
        trajectories.relation_errors(foreign, relations)


@given(seeds, poses)
def test_the_best_motion_is_that_of_singular_value_decomposition(seed: int, motion: Pose2) -> None:
    """Arun et al. (PAMI 1987), by numpy, on points that do not fit exactly."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5, 5, (12, 2))
    targets = motion.apply(points) + rng.normal(0.0, 0.3, (12, 2))
    found = nearest_motion(points, targets)
    p, t = points - points.mean(axis=0), targets - targets.mean(axis=0)
    u, _, vt = np.linalg.svd(p.T @ t)
    rotation = vt.T @ np.diag([1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    np.testing.assert_allclose(found.rotation(), rotation, atol=1e-9)
    np.testing.assert_allclose(found.apply(points).mean(axis=0), targets.mean(axis=0), atol=1e-9)

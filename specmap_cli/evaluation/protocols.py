"""Table II and Figure 6 of the paper: held-out scans, and another log against the map."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import neighbours
from specmap_cli.core.errors import LogError, NoResultError
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, nearest_motion
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import IntArray, Labels, PosedScan, Trajectory
from specmap_cli.core.settings import Config, KeyframeConfig, LimitsConfig
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.filenames import TOPOLOGY
from specmap_cli.maps.store import read_map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.build import Accepts, build_map, map_log
from specmap_cli.pipelines.localize import localize_log
from specmap_cli.pipelines.map_in_making import FinishedMap
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.localization.localizer import Label, Localizer
from specmap_cli.recognition.localization.walls import MapWalls, along_way, placed

Split = Literal["random", "blocks"]

STAMP_REACH_NS = 50_000_000  # given poses need not be at the stamps of the scans
_TRUTH_REACH_M = 1.0
# Mean distance between the true poses and those of the map from which they hardly belong together;
# a tenth of it is usual.
_FITTING_M = 0.5


@dataclass(frozen=True, slots=True)
class ClassificationScores:
    """Predictions against truth over the classes `ids`.

    `confusion` (m, m + 1) counts scans by true class (row) and predicted one (column), the last
    column those called unknown, or given a label that is no class.
    """

    ids: tuple[int, ...]
    confusion: NDArray[np.int64]

    @property
    def scans(self) -> int:
        """How many scans were scored."""
        return int(self.confusion.sum())

    @property
    def recall_of(self) -> dict[int, float]:
        """Share of each class's scans that were labelled so; classes with scans only."""
        rows = self.confusion.sum(axis=1)
        return {
            i: float(self.confusion[k, k] / rows[k]) for k, i in enumerate(self.ids) if rows[k] > 0
        }

    @property
    def precision_of(self) -> dict[int, float]:
        """Share of the scans labelled so that are of the class; nought when it was never called.

        Of the classes with scans only: another cannot be right.
        """
        called = self.confusion.sum(axis=0)
        return {
            i: float(self.confusion[k, k] / called[k]) if called[k] else 0.0
            for k, i in enumerate(self.ids)
            if self.confusion[k].any()
        }

    @property
    def recall(self) -> float:
        """Macro average: every class counts alike, as in the paper's Table II."""
        of_each = self.recall_of.values()
        return sum(of_each) / max(1, len(of_each))

    @property
    def precision(self) -> float:
        """Macro average: every class counts alike, as in the paper's Table II."""
        of_each = self.precision_of.values()
        return sum(of_each) / max(1, len(of_each))

    @property
    def accuracy(self) -> float:
        """Share of all scans that were labelled right."""
        return float(np.trace(self.confusion)) / self.scans if self.scans else 0.0

    def as_dict(self) -> dict[str, Any]:
        """The macro averages and the count of scans."""
        return {
            "recall": round(self.recall, 6),
            "precision": round(self.precision, 6),
            "accuracy": round(self.accuracy, 6),
            "scans": self.scans,
        }


def classification_scores(
    truth: Sequence[int] | NDArray[Any],
    predicted: Sequence[int | None] | NDArray[Any],
    ids: Iterable[int],
) -> ClassificationScores:
    """Score `predicted` (n,) against `truth` (n,); scans whose truth is no class are left out.

    A prediction of None, or of anything that is no class, counts as unknown: wrong, but no other
    class's fault.
    """
    classes = tuple(sorted(ids))
    number = {submap: k for k, submap in enumerate(classes)}
    confusion = np.zeros((len(classes), len(classes) + 1), dtype=np.int64)
    for true, guess in zip(truth, predicted, strict=True):
        row = number.get(int(true))
        if row is not None:
            column = len(classes) if guess is None else number.get(int(guess), len(classes))
            confusion[row, column] += 1
    return ClassificationScores(classes, confusion)


@dataclass(frozen=True, slots=True)
class HoldOut:
    """Which keyframes are held out: a `share` of them, one by one or in blocks of `block`.

    The choice depends on a keyframe's number and `seed` only, so that it can be made as they come.
    """

    split: Split = "random"
    share: float = 0.2
    block: int = 100
    seed: int = 0

    def holds(self, number: int) -> bool:
        """Whether a keyframe, by its number, is held out; the first never is."""
        group = number // (self.block if self.split == "blocks" else 1)
        draw = np.random.default_rng([self.seed, group]).random()
        return group > 0 and bool(draw < self.share)


@dataclass(frozen=True, slots=True)
class HoldOutResult:
    """Raw single-scan scores on the scans of the map and on those held out, and filtered ones."""

    train: ClassificationScores
    test: ClassificationScores
    filtered: ClassificationScores

    def as_dict(self) -> dict[str, Any]:
        """Table II as JSON: macro averages, and recall and precision of every submap."""
        figures = {
            "recall": self.test.recall_of,
            "precision": self.test.precision_of,
            "train_recall": self.train.recall_of,
        }
        submaps = []
        for submap, scans in zip(self.test.ids, self.test.confusion.sum(axis=1), strict=True):
            own = {
                name: round(of[submap], 6) if submap in of else None for name, of in figures.items()
            }
            submaps.append({"id": submap, **own, "scans": int(scans)})
        parts = {"train": self.train, "test": self.test, "filtered": self.filtered}
        return {**{name: one.as_dict() for name, one in parts.items()}, "submaps": submaps}


@one_blas_thread()
def hold_out(
    logs: Sequence[Path], config: Config, options: HoldOut, progress: Progress | None = None
) -> HoldOutResult:
    """Build a map without a share of the keyframes, then label these (Table II of the paper).

    Held-out scans are registered, since the robot drove on, but enter neither map nor classifiers.
    The truth of one is the submap of the nearest keyframe of the map, at most a metre away.
    Raises LogError and NoResultError as `build` does, NoResultError when nothing was held out.
    """
    progress = progress or Silent()
    with open_log(logs, config.log) as log, KeyframeStore() as store, KeyframeStore() as held_out:
        accepts = holding_out(config.keyframes, options, held_out)
        session = Session(config, store, progress)
        finished = map_log(session, SweepStream(log, config.log), accepts=accepts)
        if not len(held_out):
            raise NoResultError("no keyframe was held out: the log is too short for this share")
        return score_hold_out(finished, store, held_out, config)


def holding_out(config: KeyframeConfig, options: HoldOut, held_out: KeyframeStore) -> Accepts:
    """What selects keyframes and lays some of them aside in a store: for evaluation only."""
    selector, numbers = KeyframeSelector(config), count()

    def accepts(scan: PosedScan) -> bool:
        if not selector.accepts(scan):
            return False
        if not options.holds(next(numbers)):
            return True
        held_out.append(scan)
        return False

    return accepts


def score_hold_out(
    finished: FinishedMap, store: KeyframeStore, held_out: KeyframeStore, config: Config
) -> HoldOutResult:
    """Label the keyframes of a finished map and those held out."""
    classifiers = finished.classifiers
    ids = classifiers.ids
    labels = finished.laid.labels
    truth = nearest_labels(poses_at(finished, held_out.stamps_ns), labels)
    train = raw_labels(classifiers, store)
    test = raw_labels(classifiers, held_out)
    filtered = [label.filtered_submap for label in labels_of(finished, store, held_out, config)]
    return HoldOutResult(
        classification_scores(labels.submaps, train, ids),
        classification_scores(truth, test, ids),
        classification_scores(truth, filtered, ids),
    )


def labels_of(
    finished: FinishedMap, store: KeyframeStore, held_out: KeyframeStore, config: Config
) -> list[Label]:
    """The labels of held-out scans in turn, by the map of `store`; the filter starts afresh after
    a gap.
    """
    localizer = localizer_over(finished, store, config)
    poses = poses_at(finished, held_out.stamps_ns)
    labels: list[Label] = []
    for k in range(len(held_out)):
        place = Pose2(*poses[k].tolist())
        gap = k > 0 and float(np.hypot(*(poses[k, :2] - poses[k - 1, :2]))) > 1.0
        scan = replace(held_out.posed(k), map_from_base=place, restarted=gap)
        labels.append(localizer.add(scan).label)
    return labels


def localizer_over(finished: FinishedMap, store: KeyframeStore, config: Config) -> Localizer:
    """A localizer over a map just finished, whose scans are those of `store`."""
    classifiers, divided = finished.classifiers, finished.laid.regions
    numbers = along_way(finished.laid.labels.poses)
    own = partial(placed, store, numbers.tolist(), finished.laid.labels.poses[numbers])
    walls = MapWalls(divided.grid, divided.owner, classifiers.misfit, config.localization, own)
    adjacency = neighbours(classifiers.ids, finished.topology.joined)
    return Localizer(classifiers, adjacency, walls, config.localization)


def raw_labels(classifiers: ClassifierSet, store: KeyframeStore) -> IntArray:
    """(n,) submap that the most votes go to, of every keyframe by its single scan."""
    scans = (store.scan(k) for k in range(len(store)))
    margins = classifiers.raw.margins(scans_features(scans, classifiers.raw.feature_set))
    winners: IntArray = np.array(classifiers.ids, dtype=np.int64)[margins.argmax(axis=1)]
    return winners


def nearest_labels(places: FloatArray, known: Labels) -> IntArray:
    """(n,) submap of the keyframe nearest to each place (n, 2 or 3), -1 where none is in reach."""
    distance, nearest = cKDTree(known.poses[:, :2]).query(places[:, :2])
    return np.where(distance <= _TRUTH_REACH_M, known.submaps[nearest], -1).astype(np.int64)


def poses_at(finished: FinishedMap, stamps_ns: IntArray) -> FloatArray:
    """(n, 3) poses in the finished map at stamps (n,) of registered scans."""
    way = finished.laid.trajectory
    _, rows = associate(way.stamps_ns, stamps_ns, 0)
    return way.poses[rows]


@dataclass(frozen=True, slots=True)
class RevisitResult:
    """Scores of another log against a map: raw and filtered labels, and the truth of each scan."""

    raw: ClassificationScores
    filtered: ClassificationScores
    truth: IntArray

    def as_dict(self) -> dict[str, Any]:
        """Both macro averages, and how many scans had a truth."""
        return {"raw": self.raw.as_dict(), "filtered": self.filtered.as_dict()}


def revisit(
    labels: Sequence[Label],
    reference: Trajectory,
    keyframes: Labels,
    map_from_reference: Pose2 = IDENTITY,
) -> RevisitResult:
    """Score the labels of another log by given poses (Figure 6 of the paper).

    `reference` holds poses of the robot on the second log, which `map_from_reference` takes to the
    map; `keyframes` are those of the map. Scans more than a metre from all of them are left out.
    Raises LogError when no scan has a pose.
    """
    stamps = np.array([label.stamp_ns for label in labels], dtype=np.int64)
    joined, rows = associate(reference.stamps_ns, stamps, STAMP_REACH_NS)
    if not len(joined):
        raise LogError("no scan of the log has a given pose: the stamps do not meet within 50 ms")
    places = map_from_reference.apply(reference.poses[rows, :2])
    truth = np.full(len(labels), -1, dtype=np.int64)
    truth[joined] = nearest_labels(places, keyframes)
    ids = np.unique(keyframes.submaps[keyframes.submaps >= 0]).tolist()
    return RevisitResult(
        classification_scores(truth, [label.submap for label in labels], ids),
        classification_scores(truth, [label.filtered_submap for label in labels], ids),
        truth,
    )


def revisit_logs(
    first: str | Path,
    second: str | Path,
    references: tuple[str | Path, str | Path],
    config: Config,
    progress: Progress,
) -> RevisitResult:
    """Localise a second log in the map of a first and score it by given poses (Figure 6).

    `first` is a log, of which a map is built for the purpose, or a map directory. `references` are
    TUM files of both logs in one frame: the motion that fits best takes them to the map. Raises
    what `build_map` and `localize_log` raise.
    """
    first, limits = Path(first), config.limits
    with ExitStack() as until_scored:
        if not (first / TOPOLOGY).is_file():
            folder = tempfile.TemporaryDirectory(prefix="specmap-")
            built, limits = Path(until_scored.enter_context(folder)) / "map", LimitsConfig()
            build_map([first], built, config, progress=progress)
            first = built
        stored = read_map(first, limits)
        given = read_tum(references[0])
        joined, rows = associate(given.stamps_ns, stored.labels.stamps_ns, STAMP_REACH_NS)
        if len(joined) < 2:
            raise LogError(
                "no pose at the stamps of the map's keyframes: another log?", where=references[0]
            )
        places, known = given.poses[rows, :2], stored.labels.poses[joined, :2]
        map_from_reference = nearest_motion(places, known)
        away = np.hypot(*(map_from_reference.apply(places) - known).T).mean()
        if away > _FITTING_M:
            progress.warn(
                f"{references[0]}: its poses are {away:.1f} m off the map on average: of another "
                "log, or is the map bent? the scores mean little"
            )
        reference = read_tum(references[1])
        report = localize_log([Path(second)], stored, config, progress=progress)
        labels = [scan.label for scan in report.scans]
        return revisit(labels, reference, stored.labels, map_from_reference)


def hold_out_lines(result: HoldOutResult) -> list[str]:
    """Table II: macro averages, the filtered labels beside them, and every submap."""
    lines = [f"{'':22} {'scans':>7} {'recall':>7} {'precision':>10}"]
    for name, scores in (
        ("training scans", result.train),
        ("held-out scans", result.test),
        ("held-out, filtered", result.filtered),
    ):
        lines.append(f"{name:22} {scores.scans:7,} {scores.recall:7.4f} {scores.precision:10.4f}")
    lines += ["", "held-out scans by submap"]
    lines.append(f"{'submap':>8} {'scans':>7} {'recall':>7} {'precision':>10}")
    test, precision = result.test, result.test.precision_of
    counts = dict(zip(test.ids, test.confusion.sum(axis=1).tolist(), strict=True))
    for submap, recall in test.recall_of.items():
        lines.append(f"{submap:>8} {counts[submap]:7,} {recall:7.3f} {precision[submap]:10.3f}")
    lines.append(f"{'mean':>8} {test.scans:7,} {test.recall:7.3f} {test.precision:10.3f}")
    return lines


def revisit_lines(result: RevisitResult) -> list[str]:
    """Recall, precision and accuracy of raw and filtered labels."""
    lines = [f"{'':22} {'scans':>7} {'recall':>7} {'precision':>10} {'accuracy':>9}"]
    for name, scores in (("raw, single scans", result.raw), ("filtered", result.filtered)):
        lines.append(
            f"{name:22} {scores.scans:7,} {scores.recall:7.4f} {scores.precision:10.4f} "
            f"{scores.accuracy:9.4f}"
        )
    return lines

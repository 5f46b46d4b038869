"""The baseline of the paper's Figure 5c: are scans of a room or of a hallway?

Boosted stumps on Table I, trained on labelled rooms and hallways of one building, asked in
another. It names kinds of places, not places; how many of the map's borders it can see at all says
how far such a classifier is from a segmentation. `room_hallway` runs it from file to figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import InputError
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import IntArray, PlanarScan
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.protocols import (
    STAMP_REACH_NS,
    ClassificationScores,
    classification_scores,
)
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.build import map_log
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.features.sets import FeatureArray, feature_names, scans_features
from specmap_cli.recognition.learning.boosting import StumpBoost
from specmap_cli.simulation.worlds import RoomTruth

ROOM, HALLWAY = 0, 1
_FEATURES, _ROUNDS = "table1", 100
_LONG = 10.0  # area over the squared half width: 4 for a square, 10 for 2.5 to 1


@dataclass(frozen=True, slots=True)
class SemanticResult:
    """Scores of the two kinds, and the share of the map's borders between different kinds."""

    scores: ClassificationScores
    borders_seen: float
    borders: int

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "room_hallway": self.scores.as_dict(),
            "borders_seen": round(self.borders_seen, 6),
            "borders": self.borders,
        }


def room_hallway_model(X: FeatureArray, kinds: IntArray) -> StumpBoost:
    """What features (n, F) of Table I of scans of known kind (n,) teach: hallways are claimed."""
    model = StumpBoost(feature_names(_FEATURES), _ROUNDS)
    return model.fit(X, np.where(kinds == HALLWAY, 1.0, -1.0))


def kinds_by(model: StumpBoost, scans: Iterable[PlanarScan]) -> IntArray:
    """(n,) kind of every scan, ROOM or HALLWAY."""
    return (model.margins(scans_features(scans, _FEATURES)) > 0.0).astype(np.int64)


def hallways(rooms: RoomTruth) -> set[int]:
    """The rooms of a plan that are hallways: far longer than wide."""
    found = set()
    for room in range(1, rooms.count + 1):
        inside = np.pad((rooms.labels == room).astype(np.uint8), 1)
        half_width = float(cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_5).max())
        if half_width > 0.0 and inside.sum() / half_width**2 > _LONG:
            found.add(room)
    return found


def kinds_of(labels: NDArray[Any], corridors: set[int]) -> IntArray:
    """(n,) ROOM or HALLWAY for room numbers (n,); -1 for those in no room."""
    kinds = np.where(np.isin(labels, sorted(corridors)), HALLWAY, ROOM)
    return np.where(np.asarray(labels) > 0, kinds, -1).astype(np.int64)


def semantic_scores(
    predicted: IntArray, truth: IntArray, submaps: NDArray[Any], borders: Iterable[tuple[int, int]]
) -> SemanticResult:
    """Score predicted kinds (n,) against true ones (n,), -1 where not known.

    `submaps` (n,) is where each scan was taken and `borders` the pairs of neighbouring submaps: a
    border is seen when most scans on its two sides are of different kinds.
    """
    kind = {int(i): round(float(predicted[submaps == i].mean())) for i in np.unique(submaps)}
    pairs = [(a, b) for a, b in borders if a in kind and b in kind]
    seen = sum(kind[a] != kind[b] for a, b in pairs)
    return SemanticResult(
        classification_scores(truth, predicted, (ROOM, HALLWAY)),
        seen / len(pairs) if pairs else 0.0,
        len(pairs),
    )


@dataclass(frozen=True, slots=True)
class Labelled:
    """A recording, the true poses of its robot (TUM) and the rooms of the building around them."""

    log: Path
    reference: Path
    rooms: RoomTruth

    def kinds(self, stamps_ns: IntArray) -> IntArray:
        """(n,) ROOM or HALLWAY at stamps (n,); -1 without a true pose, or in no room."""
        reference = read_tum(self.reference)
        known, found = associate(reference.stamps_ns, stamps_ns, STAMP_REACH_NS)
        kinds = np.full(len(stamps_ns), -1, dtype=np.int64)
        places = reference.poses[found]
        kinds[known] = kinds_of(self.rooms.at(places), hallways(self.rooms))
        return kinds


@one_blas_thread()
def room_hallway(
    learned: Labelled, asked: Labelled, config: Config, progress: Progress
) -> SemanticResult:
    """Learn rooms and hallways from one recording and name those of another (Figure 5c).

    The borders are those between the submaps of a map built of the second. Raises InputError when
    the first shows not both kinds, and what `build` raises.
    """
    stamps: list[int] = []
    features = scans_features(_scans_of(learned.log, config, progress, stamps), _FEATURES)
    kinds = learned.kinds(np.array(stamps, dtype=np.int64))
    if set(np.unique(kinds[kinds >= 0]).tolist()) != {ROOM, HALLWAY}:
        raise InputError(
            f"its scans with a pose in {learned.reference} are not of both rooms and "
            "hallways: is the picture that of its building, in the frame of the poses?",
            where=learned.log,
        )
    model = room_hallway_model(features[kinds >= 0], kinds[kinds >= 0])
    with open_log(asked.log, config.log) as log, KeyframeStore() as store:
        finished = map_log(Session(config, store, progress), SweepStream(log, config.log))
        predicted = kinds_by(model, (store.scan(k) for k in range(len(store))))
        truth = asked.kinds(store.stamps_ns)
    return semantic_scores(predicted, truth, finished.laid.labels.submaps, finished.topology.joined)


def _scans_of(
    path: Path, config: Config, progress: Progress, stamps: list[int]
) -> Iterator[PlanarScan]:
    """The scans of a recording in turn; `stamps` gets theirs."""
    with open_log([path], config.log) as log:
        stream = SweepStream(log, config.log)
        progress.start("learning", stream.selection.topic.count)
        for sweep in stream:
            progress.advance()
            stamps.append(sweep.stamp_ns)
            yield sweep.planar


def semantic_lines(result: SemanticResult) -> list[str]:
    """Rooms and hallways by the baseline, and which borders of the map it can see."""
    recall = result.scores.recall_of
    return [
        f"{result.scores.scans:,} scans: rooms recognised {recall.get(ROOM, 0.0):.3f}, "
        f"hallways {recall.get(HALLWAY, 0.0):.3f}, all {result.scores.accuracy:.3f}",
        f"{result.borders} borders between submaps, {100 * result.borders_seen:.0f} % between "
        "a room and a hallway: no other can be seen",
    ]

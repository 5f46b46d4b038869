"""The baseline of the paper's Figure 5c: are scans of a room or of a hallway?

Boosted stumps on Table I, trained on labelled rooms and hallways of one building, asked in
another. It names kinds of places, not places; how many of the map's borders it can see at all says
how far such a classifier is from a segmentation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.evaluation.classification import ClassificationScores, classification_scores
from specmap_cli.evaluation.worlds import RoomTruth
from specmap_cli.recognition.boosting import StumpBoost
from specmap_cli.recognition.features import FEATURE_SETS, scans_features
from specmap_cli.records import IntArray, PlanarScan

ROOM, HALLWAY = 0, 1
_FEATURES = "table1"
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


class RoomHallway:
    """AdaBoost on stumps over Table I: positive margins are hallways."""

    def __init__(self, rounds: int = 100) -> None:
        self.booster_ = StumpBoost(FEATURE_SETS[_FEATURES], rounds)

    def fit(self, scans: Iterable[PlanarScan], kinds: IntArray) -> RoomHallway:
        """Learn from scans of known kind (n,), ROOM or HALLWAY; returns self."""
        X = scans_features(scans, _FEATURES)
        self.booster_.fit(X, np.where(kinds == HALLWAY, 1.0, -1.0))
        return self

    def predict(self, scans: Iterable[PlanarScan]) -> IntArray:
        """(n,) kind of every scan."""
        margins = self.booster_.margins(scans_features(scans, _FEATURES))
        return (margins > 0.0).astype(np.int64)


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
    predicted: IntArray,
    truth: IntArray,
    submaps: NDArray[Any],
    borders: Iterable[tuple[int, int]],
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

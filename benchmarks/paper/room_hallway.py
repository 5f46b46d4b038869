"""Figure 5c: a classifier of rooms and hallways does not divide a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from benchmarks.making.tours import tour_of
from benchmarks.paper import pictures
from benchmarks.paper.blocks import Block, Found, Gallery, Picture, Row, Table, Words, figure
from benchmarks.paper.cases import FREIBURG, STATA, Case, Drawing
from benchmarks.paper.workshop import OURS, Built, Workshop
from benchmarks.real.closure_truth import true_poses
from specmap_cli.core.records import IntArray
from specmap_cli.evaluation.semantic import (
    HALLWAY,
    ROOM,
    SemanticResult,
    hallways,
    kinds_by,
    kinds_of,
    room_hallway_model,
    semantic_scores,
)
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.learning.classifiers import Sensor

_RATE_HZ = 2.0  # of the scans to learn from: enough of every place


def make(workshop: Workshop) -> list[Block]:
    """Learn the kinds in a building like Freiburg, name the scans of those like Stata."""
    drawn = workshop.drawn(FREIBURG)
    if not drawn:
        return [Words("No building in the manner of Freiburg has rooms drawn by hand.", True)]
    (learned, drawing), shown, told = drawn[0], [], {}
    for case in workshop.of_manner(STATA):
        built = workshop.built(case, OURS)
        predicted = _predicted(drawing, built)
        told[case.name] = _scores(case, built, predicted), len(predicted)
        labels = replace(built.finished.laid.labels, submaps=predicted)
        shown.append(
            Picture(
                pictures.kinds(built.finished.laid.regions.grid, labels),
                f"{case.name}: where most scans are taken for a room (green) or a hallway (pink)",
            )
        )
    head = ("recording", "scans", "rooms named right", "hallways named right", "borders", "seen")
    caption = (
        f"Boosted stumps on Table I, learned from {learned.name.partition(',')[0]} with rooms and "
        "hallways known. A border between two submaps can be seen only where a room meets a "
        "hallway. Where nobody drew the rooms, the first figures are missing."
    )
    rows = [_row(name, *each) for name, each in told.items()]
    return [_found(told), Gallery(shown), Table(head, rows, caption)]


def _predicted(drawing: Drawing, built: Built) -> IntArray:
    """(n,) the kind of every keyframe, by a classifier that learned with the same laser."""
    sensor = Sensor.of(built.store.scan(0))
    view = min(360.0, float(np.degrees(sensor.field_of_view)))
    tour = tour_of(drawing.plan, view, 0, beams=sensor.beams, rate_hz=_RATE_HZ)
    kinds = kinds_of(
        drawing.rooms.at(np.array([scan.map_from_base for scan in tour])), hallways(drawing.rooms)
    )
    known = [scan.planar for scan, kind in zip(tour, kinds, strict=True) if kind >= 0]
    model = room_hallway_model(scans_features(known, "table1"), kinds[kinds >= 0])
    return kinds_by(model, (built.store.scan(k) for k in range(len(built.store))))


def _scores(case: Case, built: Built, predicted: IntArray) -> SemanticResult:
    truth = np.full(len(predicted), -1, dtype=np.int64)
    if case.drawing is not None:
        rooms = case.drawing.rooms
        places = true_poses(case.truth, built.store, of_laser=False)
        truth = kinds_of(rooms.at(places), hallways(rooms))
    submaps, joined = built.finished.laid.labels.submaps, built.finished.topology.joined
    return semantic_scores(predicted, truth, submaps, joined)


def _row(name: str, found: SemanticResult, scans: int) -> Row:
    recall = found.scores.recall_of
    right = [figure(recall.get(kind, float("nan"))) for kind in (ROOM, HALLWAY)]
    seen = f"{100.0 * found.borders_seen:.0f} %"
    return Row((name, f"{scans:,}", *right, str(found.borders), seen))


def _found(told: Mapping[str, tuple[SemanticResult, int]]) -> Found:
    seen = ", ".join(
        f"{100.0 * found.borders_seen:.0f}\N{NO-BREAK SPACE}% ({name})"
        for name, (found, _) in told.items()
    )
    return Found(
        f"Of the borders between specmap's submaps such a classifier sees {seen}.",
        "It can part only a room from a hallway. Two rooms side by side are one to it, and spaces "
        "that are neither, of which Stata has many, change their kind from scan to scan.",
    )

"""Figure 2: a finished map, segmented by spectral clustering."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.data import plan, rooms_of
from benchmarks.paper import pictures
from benchmarks.paper.blocks import Block, Found, Picture, Row, Table, figure, gallery
from benchmarks.paper.cases import STATA, Case
from benchmarks.paper.workshop import OURS, PRESETS, WORDS, Workshop, beside
from benchmarks.scores import RoomScores, room_scores
from specmap_cli.core.config import load_config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.segmentation.division import segment
from specmap_cli.simulation.worlds import RoomTruth

_HEAD = ("map", "choices", "regions", "recall", "precision", "IoU", "regions per room")


@dataclass(frozen=True, slots=True)
class Told:
    """How a map was divided; without `scores` where nobody drew its rooms."""

    name: str
    preset: str
    regions: float
    scores: RoomScores | None


def make(workshop: Workshop) -> list[Block]:
    """Every building in the manner of Stata divided twice, and the plans drawn by hand."""
    told, galleries = [], []
    for case in workshop.of_manner(STATA):
        shown = []
        for preset in PRESETS:
            grid, rooms = _finished(case, workshop)
            labels = segment(grid, load_config(preset=preset).segmentation).labels
            scores = None if rooms is None else room_scores(rooms.labels - 1, labels)
            told.append(Told(case.name, preset, len(np.unique(labels[labels >= 0])), scores))
            shown.append(Picture(pictures.divided(grid, labels), f"{case.name}: {WORDS[preset]}"))
        galleries.append(gallery(shown))
    told += _of_plans(workshop.cases.plans)
    caption = (
        "Recall: of a room, the share that its best region covers; precision: of a region, the "
        "share inside its best room; IoU: their intersection over their union; rooms drawn by hand."
    )
    return [_found(told), *galleries, Table(_HEAD, [_row(each) for each in told], caption)]


def _found(told: Sequence[Told]) -> Found:
    """Of the last map whose rooms are known: the mean of the plans, if they are here."""
    last = {each.preset: each for each in told if each.scores is not None}
    figures = {
        preset: f"IoU {each.scores.iou:.3f}, {each.scores.segments_per_room:.2f} regions a room"
        for preset, each in last.items()
        if each.scores is not None
    }
    return Found(
        f"Regions against rooms drawn by hand ({last[OURS].name}). {beside(figures)}",
        "specmap lets the labels flood from the nodes, so that borders lie in doors, joins regions "
        "with a wide border, so that a corridor stays whole, and takes small obstacles that stand "
        "alone for free space.",
    )


def _finished(case: Case, workshop: Workshop) -> tuple[GridMap, RoomTruth | None]:
    """The drawing of a building, else the map that the robot made of it."""
    if case.drawing is not None:
        return case.drawing.plan, case.drawing.rooms
    return workshop.built(case, OURS).finished.laid.regions.grid, None


def _row(told: Told) -> Row:
    figures, scores = ["–"] * 4, told.scores
    if scores is not None:
        figures = [figure(scores.recall), figure(scores.precision), figure(scores.iou)]
        figures.append(figure(scores.segments_per_room, 2))
    return Row((told.name, WORDS[told.preset], f"{told.regions:.0f}", *figures))


def _of_plans(names: tuple[str, ...]) -> Iterator[Told]:
    """The means over the plans of Bormann et al., 2016, as far as they are here."""
    for preset in PRESETS if names else ():
        config = load_config(preset=preset).segmentation
        found = [segment(plan(name), config).labels for name in names]
        scores = [
            room_scores(rooms_of(name).labels - 1, labels)
            for name, labels in zip(names, found, strict=True)
        ]
        mean = RoomScores(
            recall=float(np.mean([each.recall for each in scores])),
            precision=float(np.mean([each.precision for each in scores])),
            iou=float(np.mean([each.iou for each in scores])),
            segments_per_room=float(np.mean([each.segments_per_room for each in scores])),
        )
        count = float(np.mean([len(np.unique(labels[labels >= 0])) for labels in found]))
        yield Told(f"mean of {len(names)} plans", preset, count, mean)

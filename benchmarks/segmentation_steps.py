"""What each step of the division of a finished map is worth.

`python -m benchmarks.segmentation_steps` leaves out one step at a time, and divides the real floors
of data/cold, the ten drawn plans, plain and furnished, and 24 furnished random plans. The last
column is the share of the regions of the plans that are found again when the plan is turned by 20
degrees: two regions are the same when they share more than half of what they cover together.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.data import data_folder, plan, plans, rooms_of
from benchmarks.making.buildings import BUILDINGS
from benchmarks.real.cold import FLOORS, corners, painted
from benchmarks.real.stability import SAME
from benchmarks.scores import Labels, overlap_table, room_scores
from benchmarks.simulated.plans import random_plan
from specmap_cli.core.settings import Config, SegmentationConfig
from specmap_cli.grids.gridmap import UNKNOWN, GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.segmentation import division, working_grid

# a step, the settings without it, and constants and functions of modules
STEPS: tuple[tuple[str, dict[str, Any], dict[tuple[Any, str], Any]], ...] = (
    ("all steps", {}, {}),
    ("not turned along the walls", {}, {(working_grid, "_SLIGHT_DEGREES"): 90.0}),
    ("small obstacles stay", {"obstacle_m": 0.0, "furniture_m": 0.0}, {}),
    ("solid furniture stays", {"furniture_m": 0.0}, {}),
    ("wide doors stay wide", {"wide_door_m": 0.0}, {}),
    ("clusters are not halved", {"halve": False}, {}),
    ("the label of the nearest node", {"labels": "nearest"}, {}),
    ("wide borders stay", {"merge": False}, {}),
    ("one placement", {"placements": 1}, {}),
    ("alcoves stay", {}, {(division, "_ALCOVE_M2"): 0.0}),
    ("rings stay whole", {}, {(division, "without_rings"): np.copy}),
    ("what was only seen stays", {"rooms_only": False}, {}),
    ("furniture gets no label", {"fill": False}, {}),
)
_TURN_DEGREES = 20.0
_PIECE_M2 = 0.25  # of a room: smaller ones count nowhere


def maps() -> Iterator[tuple[str, GridMap, Labels]]:
    """The kind of each map, the map and its drawn rooms (H, W), -1 where there is none."""
    for name in FLOORS:
        source = data_folder() / "cold" / name
        floor = read_grid(source / "map.yaml").cropped()
        rooms = json.loads((source / "labels.json").read_text(encoding="utf-8"))["rooms"]
        truth = painted(floor, {key: corners(room["outline"]) for key, room in rooms.items()})
        yield "real", floor, truth
    for name in plans():
        truth = rooms_of(name).labels.astype(np.int32) - 1
        yield "plain", plan(name), truth
        yield "furnished", plan(name + "_furnitures"), truth
    for building in BUILDINGS:
        for number in range(6):
            drawing = random_plan(building, number, True)
            yield "random", drawing.grid(), np.asarray(drawing.labels)


def divided(grid: GridMap, config: SegmentationConfig) -> Labels:
    """(H, W) the regions of a map."""
    return division.segment_floorplan(grid, config).labels


def found_again(grid: GridMap, labels: Labels, config: SegmentationConfig) -> float:
    """The share of the regions `labels` (H, W) that the map has, too, when it is turned."""
    height, width = grid.cells.shape
    side = int(np.hypot(height, width)) + 2
    turn: Any = cv2.getRotationMatrix2D((width / 2, height / 2), _TURN_DEGREES, 1.0)
    turn[:, 2] += side / 2 - np.array([width, height]) / 2
    size, near = (side, side), cv2.INTER_NEAREST
    cells = cv2.warpAffine(grid.cells, turn, size, flags=near, borderValue=(UNKNOWN,))
    before = cv2.warpAffine((labels + 1).astype(np.float32), turn, size, flags=near)
    turned = GridMap(np.asarray(cells, dtype=np.uint8), grid.resolution)
    table = overlap_table(np.asarray(before).astype(np.int32) - 1, divided(turned, config))
    union = table.sum(axis=1, keepdims=True) + table.sum(axis=0) - table
    return float((table > SAME * union).any(axis=1).mean())


def measured(number: int) -> str:
    """The row of one of the `STEPS`."""
    name, settings, constants = STEPS[number]
    config = SegmentationConfig(**(Config().segmentation.model_dump() | settings))
    figures: dict[str, list[float]] = {}
    pieces = regions = 0
    with ExitStack() as stack:
        for (module, constant), value in constants.items():
            stack.enter_context(patch.object(module, constant, value))
        for kind, grid, truth in maps():
            labels = divided(grid, config)
            # of a real floor nobody drew what lies below the furniture
            shown = np.where(grid.free, labels, -1) if kind == "real" else labels
            scores = room_scores(truth, shown)
            figures.setdefault(kind, []).append(scores.iou)
            if kind == "real":
                inside = overlap_table(truth, labels).sum(axis=0) * grid.resolution**2
                pieces += int((inside >= _PIECE_M2).sum())
                regions += len(np.unique(labels[labels >= 0]))
            if kind == "plain":
                figures.setdefault("again", []).append(found_again(grid, labels, config))
    means = {kind: float(np.mean(values)) for kind, values in figures.items()}
    return (
        f"| {name} | {means['real']:.3f} | {pieces} | {regions} | {means['plain']:.3f} "
        f"| {means['furnished']:.3f} | {means['random']:.3f} | {means['again']:.2f} |"
    )


if __name__ == "__main__":
    print("| without | real floors | pieces | regions | plans | furnished | random | turned |")
    print("|---|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(2) as pool:
        for row in pool.map(measured, range(len(STEPS))):
            print(row, flush=True)

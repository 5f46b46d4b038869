"""Rooms of maps that robots made, against those that people drew: seven floors of COLD.

Each floor goes through `specmap segment` as it is, at 0.02 m. Recall, precision and IoU are those
of Bormann et al. (ICRA 2016) on free cells that somebody labelled, means over the floors. Pieces
are the regions of at least 0.25 m2 inside labelled rooms. A doorway is found when a door is
reported within 0.6 m of the middle of the drawn passage; a door is false when both of its sides lie
in one drawn room, and it is at no passage.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.cost.processes import SPECMAP
from benchmarks.cost.processes import measure as measured
from benchmarks.data import data_folder
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from benchmarks.scores import overlap_table
from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.maps.store import read_map

FLOORS = (
    *("freiburg_seq1", "freiburg_seq2", "freiburg_seq3"),
    *("saarbrucken_seq1", "saarbrucken_seq2", "saarbrucken_seq3", "saarbrucken_seq4"),
)
# IoU of the best of distance transform, morphology and Voronoi (Bormann et al. 2016) on each floor,
# at 0.05 m with their published parameters
OLD = (0.99, 0.84, 1.0, 0.63, 0.79, 0.73, 0.82)
DOORWAY = "DW"
_PIECE_M2, _NEAR_M, _ASIDE_M = 0.25, 0.6, 0.5
_WORSE = 0.85  # IoU of rooms that are named in a picture

ROWS = (
    Row("recall", "recall, 40 rooms of seven floors", 0.91, 0.95),
    Row("precision", "precision"),
    Row("iou", "IoU", 0.88, 0.92, others="best of three old methods on each floor .83"),
    Row("pieces", "pieces of the 40 rooms", 48, 42, "less", ".0f"),
    Row("regions", "regions in all", 60, 48, "less", ".0f"),
    Row("doorways", "doorways found, of 43", 41, 43, form=".0f"),
    Row("false_doors", "doors within rooms", 2, 0, "less", ".0f"),
    *(
        Row(name, f"IoU of {name.replace('_', ' ')}", old, others="the best old method")
        for name, old in zip(FLOORS, OLD, strict=True)
    ),
)


@dataclass(frozen=True, slots=True)
class Floor:
    """What became of a floor: (R,) recall and IoU of its rooms, (S,) precision of its pieces."""

    recall: FloatArray
    precision: FloatArray
    iou: FloatArray
    pieces: int
    regions: int
    doorways: int
    found: int
    false_doors: int


def measure(bench: Bench) -> Figures:
    """Divide every floor and hold it against the drawn rooms."""
    floors = {}
    print(f"{'floor':20} recall  prec.    IoU  rooms  pieces  regions  doorways  false")
    with bench.scratch("cold") as folder:
        for name in FLOORS:
            source = data_folder() / "cold" / name
            command = [SPECMAP, "segment", str(source / "map.yaml"), "-o", name, "-q"]
            measured(command, folder)
            floors[name] = one = scored(source, folder / name)
            print(
                f"{name:20} {one.recall.mean():6.3f} {one.precision.mean():6.3f} "
                f"{one.iou.mean():6.3f} {len(one.recall):6} {one.pieces:7} {one.regions:8} "
                f"{one.found:6}/{one.doorways:<2} {one.false_doors:6}",
                flush=True,
            )
    every = floors.values()
    return {
        "recall": float(np.mean([one.recall.mean() for one in every])),
        "precision": float(np.mean([one.precision.mean() for one in every])),
        "iou": float(np.mean([one.iou.mean() for one in every])),
        "pieces": sum(one.pieces for one in every),
        "regions": sum(one.regions for one in every),
        "doorways": sum(one.found for one in every),
        "false_doors": sum(one.false_doors for one in every),
        **{name: float(one.iou.mean()) for name, one in floors.items()},
    }


def scored(source: Path, divided: Path) -> Floor:
    """Hold a divided floor against its labels."""
    floor, truth, polygons = labelled(source)
    stored = read_map(divided)
    table = overlap_table(truth, stored.regions.owner).astype(np.float64)
    cell_m2 = floor.resolution**2
    rooms = np.bincount(truth[truth >= 0], minlength=len(table)).astype(np.float64)
    table, rooms = table[rooms > 0], rooms[rooms > 0]
    inside = table.sum(axis=0)
    table = table[:, inside * cell_m2 >= _PIECE_M2]
    inside = table.sum(axis=0)
    union = rooms[:, None] + inside - table
    middles = np.array([polygons[n].mean(axis=0) for n in polygons if DOORWAY in n.split("-")])
    doors = stored.record.graph.doors
    places = np.array([(door.x, door.y) for door in doors]).reshape(-1, 2)
    apart = np.linalg.norm(middles[:, None] - places, axis=2)
    turns = np.array([door.theta for door in doors])
    aside = _ASIDE_M * np.column_stack([np.cos(turns), np.sin(turns)])
    sides = np.array([truth[tuple(floor.cells_of(places + s * aside).T)] for s in (-1.0, 1.0)])
    one_room = (sides[0] >= 0) & (sides[0] == sides[1])
    return Floor(
        recall=table.max(axis=1) / rooms,
        precision=table.max(axis=0) / inside,
        iou=(table / union).max(axis=1),
        pieces=table.shape[1],
        regions=len(stored.ids),
        doorways=len(middles),
        found=int((apart <= _NEAR_M).any(axis=1).sum()),
        false_doors=int((one_room & (apart > _NEAR_M).all(axis=0)).sum()),
    )


def labelled(source: Path) -> tuple[GridMap, np.ndarray, dict[str, FloatArray]]:
    """A floor, (H, W) the room of each of its cells, and the corners (n, 2) of what was drawn."""
    floor = read_grid(source / "map.yaml")
    labels = json.loads((source / "labels.json").read_text(encoding="utf-8"))["rooms"]
    polygons = {name: corners(room["outline"]) for name, room in labels.items()}
    return floor, painted(floor, polygons), polygons


def corners(outline: list[list[list[float]]]) -> FloatArray:
    """(n, 2) corners of an outline of segments."""
    return np.array([start[:2] for start, _ in outline])


def painted(floor: GridMap, polygons: dict[str, FloatArray]) -> np.ndarray:
    """(H, W) the room of each free cell: 0, 1, ..., -1 in doorways and where nobody said."""
    label = np.full(floor.cells.shape, -1, dtype=np.int32)
    rooms = [name for name in polygons if DOORWAY not in name.split("-")]
    doorways = [name for name in polygons if DOORWAY in name.split("-")]
    for value, name in (*enumerate(rooms), *((-1, name) for name in doorways)):
        cells = floor.cells_of(polygons[name])[:, ::-1].round().astype(np.int32)
        cv2.fillPoly(label, [cells], value)
    return np.where(floor.free, label, -1)


def draw(floor: GridMap, truth: np.ndarray, owner: np.ndarray, iou: FloatArray) -> np.ndarray:
    """A picture of a floor: regions in colours, drawn rooms as lines, the IoU of the worse ones."""
    rows, columns = np.nonzero(truth >= 0)
    window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    hues = (np.arange(max(1, 1 + int(owner.max()))) * 0.381966 * 180 % 180).astype(np.uint8)
    fills = cv2.cvtColor(
        np.stack([hues, np.full_like(hues, 110), np.full_like(hues, 240)], axis=1)[None],
        cv2.COLOR_HSV2BGR,
    )[0]
    image = np.where(owner[..., None] >= 0, fills[owner], np.where(floor.free, 225, 160)[..., None])
    image = np.ascontiguousarray(np.where(floor.occupied[..., None], 0, image).astype(np.uint8))
    named = []
    for room, share in zip(np.unique(truth[truth >= 0]).tolist(), iou.tolist(), strict=True):
        mask = (truth == room).astype(np.uint8)
        lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, lines, -1, (200, 0, 200), 2)
        if share < _WORSE:
            named.append((share, np.argwhere(mask).mean(axis=0)))
    image, (height, _) = np.ascontiguousarray(image[window][::-1]), truth[window].shape
    for share, (row, column) in named:
        x, y = round(column - columns.min()) - 30, height - round(row - rows.min())
        for colour, width in (((255, 255, 255), 6), ((0, 0, 0), 2)):
            cv2.putText(image, f"{share:.2f}", (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.8, colour, width)
    return image


def main() -> None:
    """Draw every floor into a folder: `python -m benchmarks.real.cold FOLDER`."""
    (folder,) = map(Path, sys.argv[1:])
    for name in FLOORS:
        source = data_folder() / "cold" / name
        command = [SPECMAP, "segment", str(source / "map.yaml"), "-o", name, "-q", "--overwrite"]
        measured(command, folder)
        floor, truth, stored = *labelled(source)[:2], read_map(folder / name)
        picture = draw(floor, truth, stored.regions.owner, scored(source, folder / name).iou)
        cv2.imwrite(str(folder / f"{name}.png"), picture)


if __name__ == "__main__":
    main()

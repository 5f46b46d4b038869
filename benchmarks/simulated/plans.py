"""Drawn floor plans divided into rooms: the maps of Bormann et al. (ICRA 2016), and random ones.

Ten plans with rooms drawn by hand, as they are and furnished: recall, precision and IoU as in
benchmarks/scores.py, and their doors (doors.py). Random plans are drawn by
making/buildings.py: offices along a corridor, corridors around a core, halls with side rooms, and
flats, which no setting was chosen on; a room is joined that shares its region with another one.
"""

from __future__ import annotations

import numpy as np

from benchmarks.data import plan, plans, rooms_of
from benchmarks.making.buildings import BUILDINGS
from benchmarks.making.drawing import Drawing
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from benchmarks.scores import RoomScores, room_scores
from benchmarks.simulated.door_truth import true_doors
from benchmarks.simulated.doors import DoorScores, Truth, against, checked
from specmap_cli.core.geometry import IDENTITY
from specmap_cli.core.settings import Config, WaysConfig
from specmap_cli.segmentation.division import segment, segment_floorplan
from specmap_cli.segmentation.visibility import LabelArray
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import Submap, TopologicalMap

NUMBERS = {False: range(2), True: range(6)}  # random plans of each kind, as furnished

_OTHERS = "MAORIS .926, Voronoi .89"
ROWS = (
    Row("plain", "ten plans: IoU", 0.95, None, others=_OTHERS),
    Row("plain_recall", "recall", 0.983),
    Row("plain_precision", "precision", 0.970),
    Row("plain_segments", "segments a room", better="none", form=".2f"),
    Row("furnished", "furnished: IoU", 0.915),
    Row("furnished_recall", "recall", 0.945),
    Row("furnished_precision", "precision", 0.965),
    Row("furnished_segments", "segments a room", better="none", form=".2f"),
    Row("doors", "doors of these found", 0.95),
    Row("false_doors", "doors where the plan has none", 0, 0, "less", ".0f"),
    Row("ways_wrong", "ways that touch what is not free", 0, 0, "less", ".0f"),
    Row("random", "8 random plans: recall", 0.99),
    Row("random_furnished", "24 random plans, furnished: recall", 0.96),
    Row("random_joined", "rooms that share a region", better="less", form=".0f"),
)


def measure(_: Bench) -> Figures:
    """Divide all plans."""
    figures: dict[str, Figure | float] = {}
    doors = DoorScores()
    for kind in ("plain", "furnished"):
        rows = []
        for bare in plans():
            name = bare + "_furnitures" if kind == "furnished" else bare
            scores, of_doors = drawn(name, bare)
            doors += of_doors
            rows.append(scores)
            print(f"{name:30} {told(scores)}  {of_doors}", flush=True)
        figures |= means(kind, rows)
    figures |= {
        "doors": doors.found / doors.true,
        "false_doors": doors.false,
        "ways_wrong": doors.wrong,
    }
    joined = 0
    for kind, furnished in (("random", False), ("random_furnished", True)):
        rows = []
        for building in BUILDINGS:
            for number in NUMBERS[furnished]:
                drawing = random_plan(building, number, furnished)
                labels = segment(drawing.grid(), Config().segmentation).labels
                rows.append(room_scores(drawing.labels, labels))
                joined += joined_rooms(drawing.labels, labels)
                print(f"{kind + ' ' + building + f' {number}':30} {told(rows[-1])}", flush=True)
        figures[kind] = means(kind, rows)[f"{kind}_recall"]
    return figures | {"random_joined": joined}


def told(scores: RoomScores) -> str:
    """Scores of a plan for reading."""
    return (
        f"recall {scores.recall:.3f} precision {scores.precision:.3f} IoU {scores.iou:.3f} "
        f"segments a room {scores.segments_per_room:.2f}"
    )


def means(kind: str, rows: list[RoomScores]) -> dict[str, Figure | float]:
    """The mean scores of some plans by the keys of their rows."""
    return {
        kind: float(np.mean([row.iou for row in rows])),
        f"{kind}_recall": float(np.mean([row.recall for row in rows])),
        f"{kind}_precision": float(np.mean([row.precision for row in rows])),
        f"{kind}_segments": float(np.mean([row.segments_per_room for row in rows])),
    }


def drawn(name: str, bare: str) -> tuple[RoomScores, DoorScores]:
    """Rooms and doors of a plan; `bare` is its name without furniture."""
    grid, config = plan(name), Config()
    labels = segment_floorplan(grid, config.segmentation).labels
    regions = Regions.of(grid, labels.astype(np.int64))
    topology = with_ways(without_edges(regions), regions, WaysConfig(), kind="doorway")
    truth = Truth(true_doors(plan(bare), rooms_of(bare)), grid, plan(bare), IDENTITY)
    scores = room_scores(rooms_of(bare).labels - 1, labels)
    return scores, against(topology, regions, truth) + checked(topology, grid)


def without_edges(regions: Regions) -> TopologicalMap:
    """The submaps of some regions."""
    return TopologicalMap(
        submaps={
            id_: Submap(id=id_, map_from_submap=IDENTITY, grid=regions.grid)
            for id_ in regions.outlines
        }
    )


def random_plan(kind: str, number: int, furnished: bool) -> Drawing:
    """The plan of a kind with that number; the same rooms when it is furnished."""
    drawing = BUILDINGS[kind](np.random.default_rng([number, 0]))
    if furnished:
        drawing.furnish(np.random.default_rng([number, 1]))
    return drawing


def joined_rooms(rooms: LabelArray, labels: LabelArray) -> int:
    """How many rooms lie mostly in a region that another room lies mostly in."""
    regions = [
        np.bincount(labels[(rooms == room) & (labels >= 0)], minlength=1).argmax()
        for room in range(int(rooms.max()) + 1)
    ]
    _, counts = np.unique(regions, return_counts=True)
    return int(counts[counts > 1].sum())

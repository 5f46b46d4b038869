"""Floor plans drawn at random, which no setting was chosen on, divided into their rooms.

    OMP_NUM_THREADS=1 python -m benchmarks.random_plans [--plans 20] [--only KIND ...] [--first 0]
    OMP_NUM_THREADS=1 python -m benchmarks.random_plans --builds [--plans 3] [--first 1000]

Offices along a corridor, corridors around a core, halls with side rooms, and flats: sizes, walls,
doors and furniture are drawn at random, the same for the same number of the plan. Scores are those
of benchmarks.rooms; `joined` counts the rooms that share their region with another room, `of` all.
`--builds` has whole maps instead, of tours through the furnished plans with many kinds of lasers.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass

import cv2
import numpy as np

from benchmarks.random_plans import builds
from benchmarks.random_plans.buildings import BUILDINGS
from benchmarks.random_plans.drawing import Drawing
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.scores import RoomScores, room_scores
from specmap_cli.segmentation.division import segment
from specmap_cli.segmentation.kmeans import LabelArray


@dataclass(frozen=True, slots=True)
class Row:
    """Scores of one plan, and how many of its rooms share a region with another one."""

    scores: RoomScores
    joined: int
    rooms: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--plans", type=int, default=20, help="of each kind")
    parser.add_argument("--only", nargs="+", choices=BUILDINGS, default=tuple(BUILDINGS))
    parser.add_argument("--first", type=int, default=0, help="number of the first plan")
    parser.add_argument("--builds", action="store_true", help="whole maps of simulated tours")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    numbers = range(arguments.first, arguments.first + arguments.plans)
    if arguments.builds:
        print(builds.HEADER)
        for kind in arguments.only:
            builds.table(kind, zip(numbers, plans(kind, numbers, True), strict=True))
        return
    print("kind    furniture  recall  prec.    IoU  segm./room  joined    of  lowest IoU")
    for kind in arguments.only:
        for furnished in (False, True):
            rows = [measured(plan) for plan in plans(kind, numbers, furnished)]
            print(line(kind, furnished, rows), flush=True)


def plans(kind: str, numbers: Iterable[int], furnished: bool) -> Iterator[Drawing]:
    """Plans of a kind by their numbers, with the same rooms when they are furnished."""
    for number in numbers:
        plan = BUILDINGS[kind](np.random.default_rng([number, 0]))
        if furnished:
            plan.furnish(np.random.default_rng([number, 1]))
        yield plan


def measured(plan: Drawing) -> Row:
    """Divide a plan and compare it with its rooms."""
    labels = segment(plan.grid(), Config().segmentation).labels
    scores = room_scores(plan.labels, labels)
    return Row(scores, joined_rooms(plan.labels, labels), len(plan.rooms))


def joined_rooms(rooms: LabelArray, labels: LabelArray) -> int:
    """How many rooms lie mostly in a region that another room lies mostly in."""
    regions = [
        np.bincount(labels[(rooms == room) & (labels >= 0)], minlength=1).argmax()
        for room in range(int(rooms.max()) + 1)
    ]
    _, counts = np.unique(regions, return_counts=True)
    return int(counts[counts > 1].sum())


def line(kind: str, furnished: bool, rows: list[Row]) -> str:
    """Means and sums over the plans of a kind."""
    table = np.array([astuple(row.scores) for row in rows])
    recall, precision, iou, segments = table.mean(axis=0).tolist()
    joined, of = sum(row.joined for row in rows), sum(row.rooms for row in rows)
    return (
        f"{kind:7} {'yes' if furnished else 'no':9} {recall:7.3f} {precision:6.3f} {iou:6.3f}"
        f" {segments:11.2f} {joined:7} {of:5} {table[:, 2].min():11.3f}"
    )


if __name__ == "__main__":
    main()

"""Finished maps against rooms drawn by hand: the maps of Bormann et al. (ICRA 2016).

    OMP_NUM_THREADS=1 python -m benchmarks.rooms [--preset paper] [--json FILE]

Every map of $SPECMAP_DATA/rooms, as it is and furnished, with one configuration. Recall, precision
and IoU are explained in specmap_cli/evaluation/scores.py. Beside the seconds (processor time, the
best of three runs) stands their ratio to OpenCV's connectedComponents and distanceTransform on the
same map in the same run, which does not depend on the machine.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data import TRUTH, data_folder, plan, rooms_of
from specmap_cli.core.config import load_config
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.evaluation.scores import room_scores
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.segmentation.division import segment

REPEATS = 3


@dataclass(frozen=True, slots=True)
class Row:
    kind: str
    name: str
    recall: float
    precision: float
    iou: float
    segments_per_room: float
    seconds: float
    ratio: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    config = load_config(preset=arguments.preset).segmentation
    rows = [
        measure(truth.name.removesuffix(TRUTH), kind, config)
        for kind in ("plain", "furnished")
        for truth in sorted((data_folder() / "rooms").glob("*" + TRUTH))
    ]
    rows += [mean_of(rows, kind) for kind in ("plain", "furnished")]
    print(table(rows))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


def measure(name: str, kind: str, config: SegmentationConfig) -> Row:
    """Divide one map and compare it with its hand-drawn rooms."""
    grid = plan(name + "_furnitures" if kind == "furnished" else name)
    scores = room_scores(rooms_of(name).labels - 1, segment(grid, config).labels)
    seconds = fastest(lambda: segment(grid, config))
    return Row(
        kind=kind,
        name=name,
        recall=scores.recall,
        precision=scores.precision,
        iou=scores.iou,
        segments_per_room=scores.segments_per_room,
        seconds=seconds,
        ratio=seconds / fastest(lambda: two_opencv_passes(grid)),
    )


def fastest(work: Callable[[], object]) -> float:
    """Processor seconds of the quickest of a few runs."""
    best = float("inf")
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return best


def two_opencv_passes(grid: GridMap) -> None:
    """What any segmentation of a map has to do at the least."""
    free = grid.free.astype(np.uint8)
    cv2.connectedComponents(free)
    cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def mean_of(rows: list[Row], kind: str) -> Row:
    """The mean of every figure over the maps of one kind."""
    numbers = np.array([list(asdict(row).values())[2:] for row in rows if row.kind == kind])
    return Row(kind, "mean", *numbers.mean(axis=0).tolist())


def table(rows: list[Row]) -> str:
    """The rows for reading."""
    lines = [f"{'':9} {'map':22} recall  prec.    IoU  segm./room  seconds  x OpenCV"]
    for row in rows:
        lines.append(
            f"{row.kind:9} {row.name:22} {row.recall:6.3f} {row.precision:6.3f} {row.iou:6.3f}"
            f" {row.segments_per_room:11.2f} {row.seconds:8.3f} {row.ratio:9.0f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()

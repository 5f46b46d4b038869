"""What `specmap localize` says of the scans of a log, held against where they were truly taken."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import cv2
import numpy as np

from benchmarks.cost.processes import SPECMAP
from benchmarks.cost.processes import measure as measured
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray
from specmap_cli.maps.store import Map

UNKNOWN = -1
RIGHT_M, RIGHT_RAD = 0.1, math.radians(1.0)
WRONG_M, WRONG_RAD = 0.5, math.radians(10.0)
_LABEL_M = 0.3  # from a place to the submap that it is said to be in
_REFUSED = "sees less than that of the map"


@dataclass(frozen=True, slots=True)
class Localized:
    """Per scan (n,): its stamp, raw and filtered submap, and its pose (n, 3) in the map, or NaN."""

    stamps_ns: IntArray
    raw: IntArray
    filtered: IntArray
    poses: FloatArray


def localized(map_: Map, log: Path, folder: Path, *options: str) -> Localized | None:
    """Localise a log in a map as a user would; None where the map refuses its laser."""
    out = folder / "labels.csv"
    command = [SPECMAP, "localize", str(log.resolve()), "--map", str(map_.path), "-o", str(out)]
    try:
        measured([*command, "--overwrite", "-q", *options], folder)
    except RuntimeError as error:
        if _REFUSED in str(error):
            return None
        raise
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    frames = {node.id: Pose2(node.x, node.y, node.theta) for node in map_.record.nodes}
    poses = np.full((len(rows), 3), np.nan)
    for k, row in enumerate(rows):
        if row.get("x"):
            pose = Pose2(float(row["x"]), float(row["y"]), float(row["theta"]))
            poses[k] = frames[int(row["filtered_submap"])] @ pose
    return Localized(
        np.array([int(Decimal(row["stamp"]) * 10**9) for row in rows], dtype=np.int64),
        np.array([int(row["submap"] or UNKNOWN) for row in rows]),
        np.array([int(row["filtered_submap"] or UNKNOWN) for row in rows]),
        poses,
    )


@dataclass(frozen=True, slots=True)
class Found:
    """Shares of the scans that have a truth.

    A label is right when the true place lies in the submap or within 0.3 m of it; a pose within 0.1
    m and 1 degree of the true one; it is wrong beyond 0.5 m or 10 degrees.
    """

    scans: int
    right: float
    raw: float
    unknown: float
    poses: float
    wrong: float

    def __str__(self) -> str:
        return (
            f"{self.scans:5} {self.right:6.3f} {self.raw:6.3f} {self.unknown:6.3f} "
            f"{self.poses:6.3f} {self.wrong:6.3f}"
        )


HEADER = "scans  right    raw  unkn.  poses  wrong"
NOTHING = Found(0, 0.0, 0.0, 1.0, 0.0, 0.0)


def scored(map_: Map, said: Localized, true: FloatArray) -> Found:
    """Hold what was said of scans against true poses (n, 3) in the map, NaN where unknown."""
    has = np.isfinite(true[:, 0])
    if not has.any():
        return NOTHING
    right, wrong = judged(said.poses[has], true[has])
    return Found(
        scans=int(has.sum()),
        right=float(lies_in(map_, true[has], said.filtered[has]).mean()),
        raw=float(lies_in(map_, true[has], said.raw[has]).mean()),
        unknown=float((said.filtered[has] == UNKNOWN).mean()),
        poses=float(right.mean()),
        wrong=float(wrong.mean()),
    )


def judged(poses: FloatArray, true: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) whether each pose (n, 3) is right, and whether it is wrong; NaN is neither."""
    away = np.hypot(*(poses[:, :2] - true[:, :2]).T)
    turned = np.abs((poses[:, 2] - true[:, 2] + math.pi) % (2 * math.pi) - math.pi)
    return (away <= RIGHT_M) & (turned <= RIGHT_RAD), (away > WRONG_M) | (turned > WRONG_RAD)


def lies_in(map_: Map, places: FloatArray, submaps: IntArray) -> np.ndarray:
    """(n,) whether each place (n, 3) lies in the submap (n,) or beside it."""
    regions = map_.regions
    cells = regions.grid.cells_of(places[:, :2])
    inside = regions.grid.inside(cells)
    found = np.zeros(len(places), dtype=np.bool_)
    for id_ in np.unique(submaps[submaps != UNKNOWN]).tolist():
        away = cv2.distanceTransform((regions.owner != id_).astype(np.uint8), cv2.DIST_L2, 5)
        asked = (submaps == id_) & inside
        found[asked] = away[tuple(cells[asked].T)] * regions.grid.resolution <= _LABEL_M
    return found


def nearest(sorted_ns: IntArray, stamps_ns: IntArray) -> IntArray:
    """(n,) the row of ascending stamps that each of the stamps (n,) is nearest to."""
    after = np.searchsorted(sorted_ns, stamps_ns).clip(1, len(sorted_ns) - 1)
    earlier = stamps_ns - sorted_ns[after - 1] < sorted_ns[after] - stamps_ns
    return np.where(earlier, after - 1, after)

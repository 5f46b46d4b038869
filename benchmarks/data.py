"""Where the real logs and plans are that the benchmarks use; README.md says how to lay them out."""

from __future__ import annotations

import os
from pathlib import Path

from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.simulation.room_truth import RoomTruth, read_rooms

RESOLUTION_M = 0.05  # of every plan
TRUTH = "_gt_segmentation.png"


def data_folder() -> Path:
    """The folder named by SPECMAP_DATA, by default ../shared/data; ends the program without it."""
    folder = Path(os.environ.get("SPECMAP_DATA", "../shared/data"))
    if not (folder / "logs").is_dir():
        raise SystemExit(
            f"no real logs in {folder}: set SPECMAP_DATA to a folder laid out as "
            "benchmarks/README.md says"
        )
    return folder


def log_file(name: str) -> Path:
    """A recording, such as `fr079`."""
    return data_folder() / "logs" / f"{name}.mcap"


def truth_file(name: str) -> Path:
    """Ground truth, such as `fr079.relations`."""
    return data_folder() / "truth" / name


def plan(name: str) -> GridMap:
    """A floor plan, such as `lab_c_scan` or `lab_c_scan_furnitures`."""
    return read_grid(data_folder() / "rooms" / f"{name}.png", RESOLUTION_M)


def rooms_of(name: str) -> RoomTruth:
    """The hand-drawn rooms of a plan, which are those of its furnished copy, too."""
    bare = name.removesuffix("_furnitures")
    return read_rooms(data_folder() / "rooms" / f"{bare}{TRUTH}", RESOLUTION_M)

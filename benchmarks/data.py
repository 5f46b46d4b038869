"""Where the real recordings and plans are that the benchmarks use; README.md says how they lie."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.simulation.worlds import RoomTruth, read_rooms

RESOLUTION_M = 0.05  # of every plan
TRUTH = "_gt_segmentation.png"
SAMPLES = Path(__file__).parent.parent.resolve() / "sample_logs"


def data_folder() -> Path:
    """The folder named by SPECMAP_DATA, by default ../shared/data; ends the program without it."""
    folder = _folder()
    if not (folder / "logs").is_dir():
        raise SystemExit(
            f"no real logs in {folder}: set SPECMAP_DATA to a folder laid out as "
            "benchmarks/README.md says"
        )
    return folder


def missing(names: Sequence[str]) -> str:
    """Which folders of the data are not there; nothing when all are."""
    return ", ".join(name for name in names if not (_folder() / name).is_dir())


def _folder() -> Path:
    return Path(os.environ.get("SPECMAP_DATA", "../shared/data")).resolve()


def recording(name: str) -> Path:
    """A real recording, such as `fr079` or `hallway_1`, whatever its format."""
    folder = data_folder()
    for path in (*folder.glob("logs/*"), *folder.glob("sessions/*")):
        if path.name.partition(".")[0] == name:
            return path
    raise SystemExit(f"no recording {name} in {folder}")


def truth_file(name: str) -> Path:
    """Ground truth, such as `fr079.relations`."""
    return data_folder() / "truth" / name


def plans() -> list[str]:
    """The names of all plans."""
    return sorted(p.name.removesuffix(TRUTH) for p in (data_folder() / "rooms").glob("*" + TRUTH))


def plan(name: str) -> GridMap:
    """A floor plan, such as `lab_c_scan` or `lab_c_scan_furnitures`; `office` is the sample's."""
    if name == "office":
        return read_grid(SAMPLES / "office.yaml")
    return read_grid(data_folder() / "rooms" / f"{name}.png", RESOLUTION_M)


def rooms_of(name: str) -> RoomTruth:
    """The hand-drawn rooms of a plan, which are those of its furnished copy, too."""
    if name == "office":
        return read_rooms(SAMPLES / "office_rooms.png", RESOLUTION_M)
    bare = name.removesuffix("_furnitures")
    return read_rooms(data_folder() / "rooms" / f"{bare}{TRUTH}", RESOLUTION_M)

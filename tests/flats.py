"""What tests know of maps of the small flat: how they are built, and what is kept of a build."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

from specmap_cli.core.config import load_config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.filenames import TOPOLOGY
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.reports import BuildReport
from specmap_cli.pipelines.simulate import SimulationResult, simulate
from specmap_cli.simulation.simulator import SimulationOptions

# For maps whose classifiers nobody asks: training would take most of the time.
QUICK = load_config(overrides={"recognition": {"rounds": 4}, "localization": {"augmentation": 20}})
# For maps in which something is found again.
TRAINED = load_config(
    overrides={"recognition": {"rounds": 30}, "localization": {"augmentation": 60}}
)


@dataclass(frozen=True)
class Explained:
    """What a build told, and its pictures of every test that may split a submap."""

    report: BuildReport
    pictures: Path


def forget_digests(map_: Path) -> None:
    """Make a map one that tells no digests, as of an earlier version: its files may be changed."""
    document = json.loads((map_ / TOPOLOGY).read_text(encoding="utf-8"))
    document["graph"]["files"] = {}
    (map_ / TOPOLOGY).write_text(json.dumps(document), encoding="utf-8")


@dataclass(frozen=True)
class Mapped:
    """A recording and its map."""

    log: SimulationResult
    map: Path

    @property
    def stored(self) -> Map:
        """The map, read anew."""
        return read_map(self.map)


def mapped(plan: GridMap, options: SimulationOptions, folder: Path) -> Mapped:
    """A recording and its map, which are called like the folder that they are put into."""
    log = simulate(plan, options, folder / f"{folder.name}.mcap")
    build_map(log.log, folder / folder.name, QUICK)
    return Mapped(log, folder / folder.name)


def record_tour(plan: GridMap, path: Path, **options: float) -> Path:
    """A short tour."""
    settings = {"field_of_view_deg": 270, "beams": 91, "range_max_m": 12, "rate_hz": 5}
    return simulate(plan, SimulationOptions.model_validate({**settings, **options}), path).log


def rows(path: Path) -> list[dict[str, str]]:
    """The lines of a CSV."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))

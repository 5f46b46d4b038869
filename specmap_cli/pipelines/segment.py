"""An existing occupancy grid into submaps: from a map file to a directory, without a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from specmap_cli.core.errors import UsageError, instance_of, path_of
from specmap_cli.core.geometry import IDENTITY
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted, legible
from specmap_cli.drawing.overview import render_segmentation
from specmap_cli.drawing.split_tests import draw_segmentation
from specmap_cli.grids.map_server import read_grid, write_png
from specmap_cli.maps.directory import OutputDirectory, refuse_inside
from specmap_cli.maps.writing import write_segmentation
from specmap_cli.segmentation.division import region_grid, segment_floorplan
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import LogInfo, Submap, TopologicalMap

_COARSEST_M = 0.5  # a door of 0.8 m is then one cell or two: walls and doors look the same


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentReport:
    """What `segment` did."""

    out: Path
    topology: TopologicalMap
    area_m2: float
    seen_m2: float

    def as_dict(self) -> dict[str, Any]:
        """Counts and areas."""
        return {
            "out": str(self.out),
            "submaps": len(self.topology.submaps),
            "edges": len(self.topology.edges),
            "doors": len(self.topology.doors),
            "area_m2": round(self.area_m2, 3),
            "seen_m2": round(self.seen_m2, 3),
        }

    def lines(self) -> list[str]:
        """A summary in two lines."""
        counts = self.as_dict()
        seen = f", and {self.seen_m2:.0f} m2 only seen" if self.seen_m2 else ""
        return [
            f"{self.out}: {counted(counts['submaps'], 'submap')}, "
            f"{counted(counts['edges'], 'edge')}, {counted(counts['doors'], 'door')}, "
            f"{self.area_m2:.0f} m2{seen}",
            f"look at {self.out / 'overview.png'}",
        ]


@one_blas_thread()
def segment_map(
    grid: Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    resolution: float | None = None,
    overwrite: bool = False,
    explain: Path | str | None = None,
    progress: Progress | None = None,
) -> SegmentReport:
    """Divide the grid in a map file into submaps and write them to the directory `out`.

    `resolution` (metres a pixel) is needed for a bare picture. `explain` is a PNG to write of what
    was looked at: nodes, sight lines, eigenvalues. `progress` hears of the stage, and of what in
    the file is read otherwise than its thresholds say. Raises MapError for a file that is no map,
    NoResultError when it has no room for a node, UsageError for an output in the way.
    """
    path, target = path_of(grid, "grid"), path_of(out, "out")
    config = instance_of(Config() if config is None else config, Config, "config")
    picture = None if explain is None else path_of(explain, "explain")
    refuse_inside(picture, target)
    progress = progress or Silent()
    full = read_grid(path, resolution, config.limits, progress)
    whole = full.cropped()
    if whole.resolution > _COARSEST_M:
        height, width = (side * whole.resolution for side in full.cells.shape)
        raise UsageError(
            f"{whole.resolution:g} m a pixel make it {width:.0f} m x {height:.0f} m, "
            "too coarse to see a door",
            "check the resolution; 0.05 m is usual",
            where=path,
        )
    progress.start("segmentation", None)
    found = segment_floorplan(whole, config.segmentation)
    regions = Regions.of(whole, found.labels)
    with OutputDirectory(target, overwrite) as partial:
        grids = {k: region_grid(whole, found.labels == k) for k in range(found.count)}
        submaps = {k: Submap(id=k, map_from_submap=IDENTITY, grid=own) for k, own in grids.items()}
        plain = TopologicalMap(submaps=submaps)
        topology = with_ways(plain, regions, config.ways, kind="doorway")
        info = LogInfo(name=legible(path.name))
        overview = render_segmentation(topology, regions, info)
        write_segmentation(partial, topology, regions, info, overview, full)
        if picture is not None:
            least = config.segmentation.eigenvalue_min
            write_png(picture, draw_segmentation(whole, found, least))
    return SegmentReport(
        out=target, topology=topology, area_m2=regions.area_m2, seen_m2=regions.seen_m2
    )

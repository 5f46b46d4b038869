"""`specmap build` and `kiss_icp_pipeline` on the same scans, whole processes, in turn.

KISS-ICP gets the returns of the planar log as PointCloud2, with our range, and the clouds of the 3D
log as a rosbag2, up to 30 m (ours: `registration.cloud_range_m`), in voxels of the same size as
ours. Absolute times wander on shared machines: the figures are ratios of runs that follow each
other.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from benchmarks.cost.processes import SCRIPTS, Cost
from benchmarks.cost.processes import measure as measured
from benchmarks.data import recording
from benchmarks.making.replays import write_cloud_bag, write_clouds
from benchmarks.scoreboard.bench import Bench, build
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.core.settings import RegistrationConfig

REPEATS = 3
CLOUD_RANGE_M = 30.0  # of KISS-ICP on fr079_3d: no room of the building is longer

ROWS = (
    Row("wall", "fr079: wall time, times kiss_icp_pipeline", 2.3, 1.6, "less", ".2f"),
    Row("processor", "fr079: processor time, times kiss_icp_pipeline", 2.0, 1.5, "less", ".2f"),
    Row("seconds", "fr079: wall time of these", better="less", form=".1f", unit="s"),
    Row("memory", "fr079: memory of all processes", better="less", form=".0f", unit="MB"),
    Row("wall_3d", "fr079_3d: wall time, times kiss_icp_pipeline", 0.8, 0.6, "less", ".2f"),
    Row("processor_3d", "fr079_3d: processor time, times it", 0.5, 0.4, "less", ".2f"),
)


def measure(bench: Bench) -> Figures:
    """Both recordings, three times each."""
    settings = RegistrationConfig()
    with bench.scratch("pairs") as folder:
        clouds, in_space = folder / "points.mcap", folder / "clouds"
        write_clouds(recording("fr079"), clouds, settings.max_range_m)
        planar = _pairs("fr079", clouds, settings.max_range_m, settings.voxel_m, folder)
        bench.adopt("fr079", folder / "map")
        write_cloud_bag(recording("fr079_3d"), in_space, "/points")
        space = _pairs("fr079_3d", in_space, CLOUD_RANGE_M, settings.cloud_voxel_m, folder)
        bench.adopt("fr079_3d", folder / "map")
    return {
        "wall": Figure.of([ours.wall_s / theirs.wall_s for ours, theirs in planar]),
        "processor": Figure.of([ours.processor_s / theirs.processor_s for ours, theirs in planar]),
        "seconds": Figure.of([ours.wall_s for ours, _ in planar]),
        "memory": Figure.of([ours.together_mb for ours, _ in planar]),
        "wall_3d": Figure.of([ours.wall_s / theirs.wall_s for ours, theirs in space]),
        "processor_3d": Figure.of(
            [ours.processor_s / theirs.processor_s for ours, theirs in space]
        ),
    }


def _pairs(
    name: str, clouds: Path, range_m: float, voxel_m: float, folder: Path
) -> list[tuple[Cost, Cost]]:
    """What a build and KISS-ICP cost, in turn."""
    found = []
    for _ in range(REPEATS):
        ours = build(recording(name), folder / "map")
        theirs = kiss_icp(clouds, folder, range_m, voxel_m)
        found.append((ours, theirs))
        print(f"{name}: {told(ours)}; kiss_icp_pipeline {told(theirs)}", flush=True)
    return found


def told(cost: Cost) -> str:
    """A cost for reading."""
    return (
        f"{cost.wall_s:.1f} s, processor {cost.processor_s:.1f} s, "
        f"largest {cost.memory_mb:.0f} MB, together {cost.together_mb:.0f} MB"
    )


def kiss_icp(clouds: Path, folder: Path, range_m: float, voxel_m: float) -> Cost:
    """`kiss_icp_pipeline` on a recording of clouds on /points that are no sweeps in motion."""
    data = {"max_range": range_m, "min_range": 0.0, "deskew": False}
    command = [str(SCRIPTS / "kiss_icp_pipeline"), str(clouds), "--dataloader", "rosbag"]
    out = folder / "kiss"
    shutil.rmtree(out, ignore_errors=True)
    return measured(
        [*command, "--topic", "/points"],
        folder,
        kiss_icp_out_dir=str(out),
        kiss_icp_data=json.dumps(data),
        kiss_icp_mapping=json.dumps({"voxel_size": voxel_m}),
    )

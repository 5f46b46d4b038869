"""What specmap costs: against `kiss_icp_pipeline` in the same run, and as a log grows.

    SPECMAP_DATA=... python -m benchmarks.speed [--repeats 2] [--plays 1 2 4 8]
                     [--only pairs growth stages lidar corridors localize plan]

`pairs`: `specmap build` and `kiss_icp_pipeline` on the same scans, whole processes, in voxels of
the same size. KISS-ICP gets the returns of the planar log as PointCloud2, with our range, and the
clouds of the 3D log as a rosbag2, up to 30 m (ours: `registration.cloud_range_m`). Absolute times
wander on shared machines: the figures to read are the ratios of the fastest runs. `growth`: fr079
played several times over, processor time and memory against one play. `stages`: seconds of each
stage of one build. `lidar`: a simulated lidar of 64 rings by 1,024, clouds a second. `corridors`:
1.5 km of them, processor time a scan against that of fr079. `localize`: scans a second of processor
time. `plan`: the segmentation of a floor plan against two OpenCV passes over it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks import localizing, rooms
from benchmarks.data import log_file
from benchmarks.hard_logs.cases import TWO_PERCENT, long_building
from benchmarks.processes import SCRIPTS, Cost, measure
from benchmarks.replays import write_cloud_bag, write_clouds, write_plays
from specmap_cli.core.config import load_config
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.map_server import read_grid
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

FLOOR_PLAN = "lab_intel"
SAMPLE_PLAN = Path("sample_logs/office.yaml")
CLOUD_RANGE_M = 30.0  # of KISS-ICP on fr079_3d: no room of the building is longer
BUILD = [str(SCRIPTS / "specmap"), "build", "--overwrite", "-q"]
HEADING = f"{'':26} {'wall s':>8} {'cpu s':>8} {'largest MB':>10} {'together':>8}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    sections = {
        "pairs": pairs,
        "growth": growth,
        "stages": stages,
        "lidar": lidar,
        "corridors": long_corridors,
        "localize": localize,
        "plan": floor_plan,
    }
    parser.add_argument("--only", nargs="+", choices=list(sections), default=list(sections))
    parser.add_argument("--repeats", type=int, default=2, help="runs of each pair")
    parser.add_argument("--plays", type=int, nargs="+", default=[1, 2, 4, 8])
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        for section in arguments.only:
            sections[section](Path(name), arguments)
            print(flush=True)


def pairs(folder: Path, arguments: argparse.Namespace) -> None:
    """Whole builds against bare odometry."""
    settings, repeats = RegistrationConfig(), range(arguments.repeats)
    clouds = folder / "points.mcap"
    scans = write_clouds(log_file("fr079"), clouds, settings.max_range_m)
    planar = settings.max_range_m, settings.voxel_m
    print(f"fr079, {scans:,} scans, whole processes, fastest of {arguments.repeats}")
    ours = [_build(log_file("fr079"), folder) for _ in repeats]
    _pair(ours, [kiss_icp(clouds, folder, *planar) for _ in repeats])

    clouds, in_space = folder / "clouds", (CLOUD_RANGE_M, settings.cloud_voxel_m)
    count = write_cloud_bag(log_file("fr079_3d"), clouds, "/points")
    print(f"fr079_3d, {count:,} clouds, the same")
    ours = [_build(log_file("fr079_3d"), folder) for _ in repeats]
    _pair(ours, [kiss_icp(clouds, folder, *in_space) for _ in repeats])


def _build(log: Path, folder: Path) -> Cost:
    return measure([*BUILD, str(log.resolve()), "-o", "map"], folder)


def _pair(ours: Sequence[Cost], theirs: Sequence[Cost]) -> None:
    mine, other = _fastest(ours), _fastest(theirs)
    print(f"{HEADING}\n{_row('specmap build', mine)}\n{_row('kiss_icp_pipeline', other)}")
    print(
        f"build / KISS-ICP: wall {mine.wall_s / other.wall_s:.2f}, "
        f"cpu {mine.processor_s / other.processor_s:.2f}"
    )


def kiss_icp(clouds: Path, folder: Path, range_m: float, voxel_m: float) -> Cost:
    """`kiss_icp_pipeline` on a recording of clouds on /points that are no sweeps in motion."""
    data = {"max_range": range_m, "min_range": 0.0, "deskew": False}
    command = [str(SCRIPTS / "kiss_icp_pipeline"), str(clouds), "--dataloader", "rosbag"]
    return measure(
        [*command, "--topic", "/points"],
        folder,
        kiss_icp_out_dir=str(folder / "kiss"),
        kiss_icp_data=json.dumps(data),
        kiss_icp_mapping=json.dumps({"voxel_size": voxel_m}),
    )


def growth(folder: Path, arguments: argparse.Namespace) -> None:
    """The same building for longer: what costs more than so many times one play is waste."""
    print(f"fr079 played over and over\n{HEADING}   against one play: cpu, memory")
    first: Cost | None = None
    for plays in arguments.plays:
        log = folder / f"plays{plays}.mcap"
        scans = write_plays(log_file("fr079"), log, plays)
        cost = _build(log, folder)
        log.unlink()
        first = first or cost
        times, more = cost.processor_s / first.processor_s, cost.together_mb / first.together_mb
        title = f"{plays} x, {scans:,} scans"
        print(f"{_row(title, cost)}   {times:.2f}, {more:.2f}", flush=True)


def stages(folder: Path, _: argparse.Namespace) -> None:
    """Seconds of each stage, as run.json tells them; registration runs beside the others."""
    _build(log_file("fr079"), folder)
    seconds = json.loads((folder / "map" / "run.json").read_text(encoding="utf-8"))["seconds"]
    print("fr079, wall seconds of each stage")
    print(", ".join(f"{name} {value:.2f}" for name, value in seconds.items()))


def lidar(folder: Path, _: argparse.Namespace) -> None:
    """Sweeps of many points in the sample office: how many are built a second."""
    options = SimulationOptions(field_of_view_deg=360.0, rings=64, beams=1024, max_duration_s=60.0)
    tour = simulate(read_grid(SAMPLE_PLAN), options, folder / "lidar.mcap")
    cost = _build(tour.log, folder)
    print(f"64 rings by 1,024, {tour.scans} clouds\n{HEADING}\n{_row('specmap build', cost)}")
    print(f"{tour.scans / cost.wall_s:.0f} clouds a second of wall time")


def long_corridors(folder: Path, _: argparse.Namespace) -> None:
    """A scan in a long building against one in a small one."""
    corridors = long_building(TWO_PERCENT, iter, folder / "corridors.mcap")
    each_ms = []
    for name, log in (("fr079", log_file("fr079")), ("1.5 km of corridors", corridors.log)):
        cost = _build(log, folder)
        run = json.loads((folder / "map" / "run.json").read_text(encoding="utf-8"))
        each_ms.append(1000.0 * cost.processor_s / run["counts"]["scans"])
        print(f"{name:26} {each_ms[-1]:.2f} ms of processor time a scan")
    print(f"{'':26} {each_ms[1] / each_ms[0]:.2f} times as much")


def localize(_: Path, __: argparse.Namespace) -> None:
    """Scans a second, and the start."""
    localizing.table(localizing.LASERS)


def floor_plan(_: Path, __: argparse.Namespace) -> None:
    """A finished map divided into rooms."""
    row = rooms.measure(FLOOR_PLAN, "plain", load_config().segmentation)
    print(f"segmentation of {FLOOR_PLAN}: {row.seconds:.2f} s, {row.ratio:.1f} x two OpenCV passes")


def _fastest(costs: Sequence[Cost]) -> Cost:
    """The least wall and processor time of several runs, each by itself, and the most memory."""
    return Cost(
        wall_s=min(cost.wall_s for cost in costs),
        processor_s=min(cost.processor_s for cost in costs),
        memory_mb=max(cost.memory_mb for cost in costs),
        together_mb=max(cost.together_mb for cost in costs),
    )


def _row(title: str, cost: Cost) -> str:
    return (
        f"{title:26} {cost.wall_s:8.1f} {cost.processor_s:8.1f} "
        f"{cost.memory_mb:10.0f} {cost.together_mb:8.0f}"
    )


if __name__ == "__main__":
    main()

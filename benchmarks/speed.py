"""`specmap build` against `kiss_icp_pipeline` on the same scans, whole processes, in one run.

python -m benchmarks.speed [--repeats 2]

KISS-ICP gets the scans as PointCloud2, with the same range and voxel size. Absolute times wander on
shared machines, so that the figures to read are the ratio of the fastest runs, the peak memory, and
the peak memory on the same log played twice.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.data import data_folder
from specmap_cli.config import Config
from specmap_cli.geometry import Pose2
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter

SCRIPTS = Path(sys.executable).parent


def measure(command: list[str], folder: Path) -> tuple[float, float]:
    """Wall seconds and peak resident megabytes of a process; it must succeed."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    start = time.perf_counter()
    with open(os.devnull, "wb") as null:
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=null, stderr=subprocess.STDOUT
        )
        _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    if status != 0:
        raise SystemExit(f"failed with status {status}: {' '.join(command)}")
    return seconds, usage.ru_maxrss / 1024.0


def write_clouds(log: Path, out: Path, max_range: float) -> int:
    """The returns of every planar scan as PointCloud2 messages."""
    count = 0
    with open_log([log]) as source, LogWriter(out) as writer:
        for sweep in SweepStream(source, Config().log):
            hits = sweep.planar.hits(max_range)
            points = np.column_stack([hits, np.zeros(len(hits))]).astype(np.float32)
            writer.cloud("/points", "laser", sweep.stamp_ns, points)
            count += 1
    return count


def write_twice(log: Path, out: Path) -> None:
    """The same log played twice, the stamps of the second time shifted behind the first."""
    with open_log([log]) as source, LogWriter(out) as writer:
        start = source.contents.start_ns
        mounting = Pose2.from_matrix(SweepStream(source, Config().log).selection.base_from_laser)
        writer.static_transform(
            "base_link",
            "laser",
            (mounting.x, mounting.y, 0.0),
            (0.0, 0.0, float(np.sin(mounting.theta / 2)), float(np.cos(mounting.theta / 2))),
            0,
        )
        shift, last = 0, 0
        for _ in range(2):
            for sweep in SweepStream(source, Config().log):
                stamp, planar = sweep.stamp_ns + shift, sweep.planar
                writer.scan(
                    "/scan",
                    "laser",
                    stamp,
                    float(planar.bearings[0]),
                    float(planar.bearings[1] - planar.bearings[0]),
                    planar.ranges,
                    range_max=planar.range_max,
                )
                if sweep.odom_from_base is not None:
                    writer.odometry("/odom", "odom", "base_link", stamp, sweep.odom_from_base)
                last = sweep.stamp_ns
            shift = last + 10**9 - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=2)
    repeats = parser.parse_args().repeats
    log = data_folder() / "logs" / "fr079.mcap"
    registration = Config().registration
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clouds, settings, twice = folder / "points.mcap", folder / "kiss.yaml", folder / "2.mcap"
        scans = write_clouds(log, clouds, registration.max_range_m)
        write_twice(log, twice)
        settings.write_text(
            f"data:\n  deskew: false\n  max_range: {registration.max_range_m}\n  min_range: 0.0\n"
            f"mapping:\n  voxel_size: {registration.voxel_m}\n"
        )
        build = [str(SCRIPTS / "specmap"), "build", str(log.resolve()), "--overwrite", "-o"]
        kiss = [str(SCRIPTS / "kiss_icp_pipeline"), str(clouds), "--dataloader", "rosbag"]
        kiss += ["--topic", "/points", "--config", str(settings)]
        ours = [measure([*build, str(folder / "map")], folder) for _ in range(repeats)]
        theirs = [measure(kiss, folder) for _ in range(repeats)]
        _, memory_twice = measure(
            [str(SCRIPTS / "specmap"), "build", str(twice), "-o", str(folder / "map2")], folder
        )
    seconds, memory = min(s for s, _ in ours), max(m for _, m in ours)
    baseline, baseline_memory = min(s for s, _ in theirs), max(m for _, m in theirs)
    print(f"fr079, {scans:,} scans, whole process, fastest of {repeats}")
    print(f"specmap build       {seconds:7.1f} s  {memory:6.0f} MB")
    print(f"kiss_icp_pipeline   {baseline:7.1f} s  {baseline_memory:6.0f} MB")
    print(f"ratio               {seconds / baseline:7.2f}")
    print(f"played twice                   {memory_twice:6.0f} MB  ({memory_twice / memory:.2f} x)")


if __name__ == "__main__":
    main()
